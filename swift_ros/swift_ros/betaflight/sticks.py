"""From body rates and thrust to stick positions, by inverting the firmware's curves.

Rates: the firmware maps a stick's deflection to a rate by one of five curve families (Betaflight 4.5 and 2025.12,
`rc.c`). Sticks are sent in whole us, so a stick has 1,001 positions; the inverse is the position with the closest
rate, for any family. Thrust: the vehicle file's motor map is inverted at the measured voltage. All functions take
NumPy or JAX arrays with any leading batch dimensions.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from array_api_compat import array_namespace

from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle, motor_command_for_speed, rotor_speed_for_thrust

AXES = ("roll", "pitch", "yaw")
# Above the centre the firmware rolls right, pitches the nose down and yaws right; in FLU, yaw is positive to the left.
STICK_SIGNS = (1.0, 1.0, -1.0)
FAMILIES = ("betaflight", "raceflight", "kiss", "actual", "quick")
STICK_MIN_US, STICK_MAX_US, HALF_TRAVEL_US = 1000, 2000, 500  # range of a stick, half of it
RATE_CEILING_DEG_S = 1998.0  # the firmware's limit of any setpoint


@dataclass(frozen=True)
class RateCurves:
    """The flight controller's rate profile and receiver settings, in the firmware's whole numbers.

    Attributes:
        family: one of FAMILIES.
        rc_rate, super_rate, expo: (3,) of roll, pitch, yaw, as MSP_RC_TUNING sends them.
        limit_deg_s: (3,) deg/s.
        centre_us: us.
        deadband_us: (3,) us around the centre.
    """

    family: str
    rc_rate: tuple[int, int, int]
    super_rate: tuple[int, int, int]
    expo: tuple[int, int, int]
    limit_deg_s: tuple[int, int, int] = (1998, 1998, 1998)
    centre_us: int = 1500
    deadband_us: tuple[int, int, int] = (0, 0, 0)

    def __post_init__(self):
        if self.family not in FAMILIES:
            raise UsageError(f"rates_type '{self.family}' is not one of {', '.join(FAMILIES)}")

    @cached_property
    def table(self) -> np.ndarray:
        """Rates (3, 1001) rad/s of the stick positions 1000..2000 us, increasing: FLU times STICK_SIGNS.

        Raises UsageError for a curve that decreases anywhere, which has no inverse.
        """
        sticks_us = np.arange(STICK_MIN_US, STICK_MAX_US + 1, dtype=float)
        rates = np.stack([_stick_to_rate(self, axis, sticks_us) for axis in range(3)])
        for name, row in zip(AXES, rates, strict=True):
            if np.any(np.diff(row) < 0):
                raise UsageError(f"the flight controller's {name} rate falls while the stick rises; lower its expo")
        return rates

    @cached_property
    def edges(self) -> np.ndarray:
        """Rates (3, 1000) rad/s halfway between neighbouring positions."""
        return 0.5 * (self.table[:, 1:] + self.table[:, :-1])


def rates_from_sticks(sticks_us, curves: RateCurves):
    """Return the firmware's omega_body (..., 3) rad/s, FLU, for roll, pitch and yaw sticks (..., 3) us."""
    xp = array_namespace(sticks_us)
    rates = [_stick_to_rate(curves, axis, sticks_us[..., axis]) * STICK_SIGNS[axis] for axis in range(3)]
    return xp.stack(rates, axis=-1)


def sticks_from_rates(omega_body, curves: RateCurves):
    """Return the roll, pitch and yaw sticks (..., 3), integers in us, with the rates closest to omega_body.

    A rate beyond the profile's range gives the end of the stick, a rate of zero the exact centre.

    Args:
        omega_body: (..., 3) rad/s, FLU.
        curves: rate profile.
    """
    xp = array_namespace(omega_body)
    sticks = [_rate_to_stick(xp, omega_body[..., i] * STICK_SIGNS[i], curves, i) for i in range(3)]
    return xp.stack(sticks, axis=-1)


def max_rates(curves: RateCurves) -> np.ndarray:
    """Return the largest rates (3,) rad/s that the profile reaches in both directions."""
    return np.minimum(-curves.table[:, 0], curves.table[:, -1])


def check_coverage(curves: RateCurves, limits) -> None:
    """Raise UsageError naming axis and numbers unless the profile covers the policy's limits (3,) rad/s."""
    short = [
        f"{name} reaches {np.degrees(reached):.0f} of {np.degrees(limit):.0f} deg/s"
        for name, reached, limit in zip(AXES, max_rates(curves), limits, strict=True)
        if reached < limit
    ]
    if short:
        what = ", ".join(short)
        raise UsageError(f"the flight controller's rates do not cover the policy's: {what}; raise its rate profile")


def _rate_to_stick(xp, rate, curves: RateCurves, axis: int):
    edges = xp.asarray(curves.edges[axis], dtype=rate.dtype)
    # Within a constant part of the curve (deadband), take its middle.
    below = xp.searchsorted(edges, rate, side="left")
    above = xp.searchsorted(edges, rate, side="right")
    return STICK_MIN_US + (below + above + 1) // 2


def _stick_to_rate(curves: RateCurves, axis: int, stick_us):
    xp = array_namespace(stick_us)
    offset = stick_us - curves.centre_us
    deadband = curves.deadband_us[axis]
    travel = xp.clip(xp.abs(offset) - deadband, 0.0, float(HALF_TRAVEL_US - deadband))
    deflection = travel / (HALF_TRAVEL_US - deadband)
    rate_deg_s = _curve(xp, curves, axis, deflection)
    limit = min(float(curves.limit_deg_s[axis]), RATE_CEILING_DEG_S)
    return xp.sign(offset) * xp.clip(rate_deg_s, 0.0, limit) * (np.pi / 180.0)


def _curve(xp, curves: RateCurves, axis: int, x):
    """Return the rate in deg/s at deflection x in 0..1; all curves are odd functions."""
    rc_rate, super_rate, expo = curves.rc_rate[axis], curves.super_rate[axis], curves.expo[axis] / 100.0
    match curves.family:
        case "betaflight":
            gain = rc_rate / 100.0
            gain += 14.54 * max(gain - 2.0, 0.0)
            curved = x * (1 - expo + expo * x**3)
            return 200.0 * gain * curved / _super_factor(xp, x * super_rate / 100.0)
        case "raceflight":
            curved = x * (1 + expo * (x * x - 1))
            return 10.0 * rc_rate * curved * (1 + x * super_rate / 100.0)
        case "kiss":
            curved = x * (1 - expo + expo * x**2)
            return 2.0 * rc_rate * curved / _super_factor(xp, x * super_rate / 100.0)
        case "actual":
            centre = 10.0 * rc_rate
            return centre * x + max(10.0 * super_rate - centre, 0.0) * x * (expo * x**5 + x * (1 - expo))
        case "quick":
            slope = 2.0 * rc_rate
            top = max(10.0 * super_rate, slope)
            curved = x * (1 - expo + expo * x**2)
            share = 1 - slope / top if top > 0 else 0.0
            return x * slope / _super_factor(xp, curved * share)


def _super_factor(xp, share):
    return xp.clip(1.0 - share, 0.01, 1.0)


def throttle_for_thrust(thrust, voltage, vehicle: Vehicle, idle):
    """Return the firmware's throttle for a collective thrust.

    Args:
        thrust: (...) m/s^2, mass-normalised.
        voltage: (...) V at the battery's terminals, with sag.
        vehicle: vehicle file.
        idle: motor command at zero throttle (Betaflight `motor_idle`, as a share); above it, the motor command is
            linear in the throttle (`mixer.c`).

    Returns:
        (...), 0 to 1; thrust out of range gives 0 or 1.
    """
    xp = array_namespace(thrust)
    speed = rotor_speed_for_thrust(thrust, vehicle.mass, vehicle.thrust_coefficient, len(vehicle.rotors))
    command = motor_command_for_speed(speed, voltage, vehicle.motor.map.coefficients)
    return xp.clip((command - idle) / (1.0 - idle), 0.0, 1.0)


def throttle_stick(throttle, min_check_us: int):
    """Return the throttle stick (...), integers in us, for the firmware's throttle (...) in 0..1.

    The firmware maps min_check..2000 us to its whole range. Zero throttle is min_check itself, at which the rate
    loop's I term and the mixer stay active; the firmware's "throttle low" is below it.
    """
    xp = array_namespace(throttle)
    stick = min_check_us + xp.clip(throttle, 0.0, 1.0) * (STICK_MAX_US - min_check_us)
    return xp.astype(xp.round(stick), xp.int32)
