"""From stick positions to setpoints: the firmware's rate curves and throttle range (Betaflight 4.5, rc.c).

Sticks are in us, rates in deg/s. The firmware's axes are FLU: roll right, nose down and turn left are positive, so
only the yaw stick is reversed.
"""

import math
from dataclasses import dataclass, replace

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.configuration import cli_settings
from swift_sim_bridge.flight_controller.configuration.controller_section import ControllerKeys, DumpedController

RATES_TYPES = ("betaflight", "raceflight", "kiss", "actual", "quick")  # in the order of their numbers in MSP_RC_TUNING
ROLL, PITCH, YAW = range(3)
STICK_SIGNS = (1.0, 1.0, -1.0)
HALF_TRAVEL_US = 500.0  # of a stick
THROTTLE_MAX_US = 2000  # full throttle
SETPOINT_LIMIT_DEG_S = 1998  # the firmware's largest rate limit
STEEP_RC_RATE, STEEP_GAIN = 2.0, 14.54  # above an rc_rate of 2, the gain grows 15.54 times as fast (rc.c)


@dataclass(frozen=True)
class RateProfile:
    """The active rate profile in the firmware's whole numbers, for roll, pitch, yaw.

    Attributes:
        type: index of RATES_TYPES.
        rc_rate: (3,).
        super_rate: (3,).
        expo: (3,).
        limit: (3,) deg/s.
        deadband_us: (3,) us around the centre.
        throttle_mid: centre of the throttle curve, percent.
        throttle_expo: curvature of the throttle curve, percent.
        quick_expo: whether the expo of QUICK rates acts on the rate instead of the super rate.
    """

    type: int
    rc_rate: tuple[int, int, int]
    super_rate: tuple[int, int, int]
    expo: tuple[int, int, int]
    limit: tuple[int, int, int] = (SETPOINT_LIMIT_DEG_S,) * 3
    deadband_us: tuple[int, int, int] = (0, 0, 0)
    throttle_mid: int = 50
    throttle_expo: int = 0
    quick_expo: bool = False


def rate_profile(controller: ControllerKeys | DumpedController) -> RateProfile:
    """Return the rate profile of a vehicle file.

    The keys of a vehicle file are the numbers that the configurator shows; a dump has the firmware's whole numbers.
    Raises UsageError for an unknown curve family or a number outside the range of its byte.
    """
    if isinstance(controller, DumpedController):
        return _profile_from_settings(controller.settings)
    if controller.rates_type not in RATES_TYPES:
        raise UsageError(f"controller: rates_type '{controller.rates_type}' is not one of {', '.join(RATES_TYPES)}")
    # The configurator shows deg/s for bytes in units of 10 deg/s, and plain numbers for bytes in hundredths.
    rc_scale = 0.1 if controller.rates_type in ("raceflight", "actual") else 100.0
    super_scale = {"actual": 0.1, "quick": 0.1, "raceflight": 1.0}.get(controller.rates_type, 100.0)
    return RateProfile(
        type=RATES_TYPES.index(controller.rates_type),
        rc_rate=_bytes("rc_rate", controller.rc_rate, rc_scale),
        super_rate=_bytes("super_rate", controller.super_rate, super_scale),
        expo=_bytes("expo", controller.expo, 100.0),
    )


def _profile_from_settings(settings: dict) -> RateProfile:
    """Return the rate profile of the settings of a CLI dump."""
    rc_rate, super_rate, expo, limit = (
        tuple(settings[f"{axis}_{what}"] for axis in cli_settings.AXES)
        for what in ("rc_rate", "srate", "expo", "rate_limit")
    )
    return RateProfile(
        type=RATES_TYPES.index(settings["rates_type"].lower()),
        rc_rate=rc_rate,
        super_rate=super_rate,
        expo=expo,
        limit=limit,
        deadband_us=(settings["deadband"], settings["deadband"], settings["yaw_deadband"]),
        throttle_mid=settings["thr_mid"],
        throttle_expo=settings["thr_expo"],
        quick_expo=settings["quickrates_rc_expo"] == "ON",
    )


def _bytes(name: str, values, scale: float) -> tuple[int, int, int]:
    numbers = tuple(round(value * scale) for value in values)
    if not all(0 <= number <= 255 for number in numbers):
        raise UsageError(f"controller: {name} {list(values)} does not fit the firmware's byte; lower it")
    return numbers


def rate_deg_s(profile: RateProfile, axis: int, deflection: float) -> float:
    """Return the setpoint in deg/s of an axis for a deflection in -1..1, clipped to the profile's limit."""
    rc_rate, super_rate, expo = profile.rc_rate[axis], profile.super_rate[axis], profile.expo[axis] / 100.0
    curve = _quick_by_rate if profile.quick_expo and CURVES[profile.type] is _quick else CURVES[profile.type]
    rate = curve(deflection, rc_rate, super_rate, expo)
    return max(-profile.limit[axis], min(profile.limit[axis], rate))


def full_rate_deg_s(profile: RateProfile, axis: int) -> float:
    """Return the setpoint in deg/s of an axis at full stick, without the limit (`getMaxRcRate`)."""
    return rate_deg_s(replace(profile, limit=(math.inf,) * 3), axis, 1.0)


def deflection_of(stick_us: float, axis: int, mid_us: int, deadband_us: int = 0) -> float:
    """Return the deflection in -1..1, FLU, of a stick."""
    if not deadband_us:
        return STICK_SIGNS[axis] * max(-1.0, min(1.0, (stick_us - mid_us) / HALF_TRAVEL_US))
    beyond_us = max(min(abs(stick_us - mid_us), HALF_TRAVEL_US) - deadband_us, 0.0)
    share = beyond_us / (HALF_TRAVEL_US - deadband_us)
    return STICK_SIGNS[axis] * (share if stick_us >= mid_us else -share)


def throttle_share(throttle_us: float, min_check_us: int, profile: RateProfile | None = None) -> float:
    """Return the throttle in 0..1 of a stick, in the firmware's whole thousandths.

    min_check..2000 us is the whole range, along the throttle curve of the rate profile (`updateRcCommands`,
    `rcLookupThrottle`).
    """
    stick_us = int(max(min_check_us, min(THROTTLE_MAX_US, throttle_us)))
    thousandths = (stick_us - min_check_us) * 1000 // (THROTTLE_MAX_US - min_check_us)
    if profile is None or not profile.throttle_expo:
        return thousandths / 1000.0
    step, rest = divmod(thousandths, 100)
    below, above = (_throttle_point(profile, i) for i in (step, step + 1))
    return (below + int(rest * (above - below) / 100)) / 1000.0


def _throttle_point(profile: RateProfile, step: int) -> int:
    """Return a point of the throttle curve in thousandths, with integer arithmetic (`initRcProcessing`)."""
    mid, expo = profile.throttle_mid, profile.throttle_expo
    off = 10 * step - mid
    half = 100 - mid if off > 0 else mid if off < 0 else 1
    curved = off * (100 - expo + expo * off * off // (half * half))
    return 10 * mid + int(curved / 10)


def _super_factor(share: float) -> float:
    return 1.0 / max(0.01, min(1.0, 1.0 - share))


def _betaflight(x, rc_rate, super_rate, expo):
    curved = x * abs(x) ** 3 * expo + x * (1.0 - expo)
    gain = rc_rate / 100.0
    gain += STEEP_GAIN * max(0.0, gain - STEEP_RC_RATE)
    return 200.0 * gain * curved * _super_factor(abs(x) * super_rate / 100.0)


def _raceflight(x, rc_rate, super_rate, expo):
    curved = (1.0 + expo * (x * x - 1.0)) * x
    return 10.0 * rc_rate * curved * (1.0 + abs(x) * super_rate * 0.01)


def _kiss(x, rc_rate, super_rate, expo):
    curved = (x**3 * expo + x * (1.0 - expo)) * rc_rate / 1000.0
    return 2000.0 * curved * _super_factor(abs(x) * super_rate / 100.0)


def _actual(x, rc_rate, super_rate, expo):
    centre = 10.0 * rc_rate
    travel = max(0.0, 10.0 * super_rate - centre)
    return x * centre + travel * abs(x) * (x**5 * expo + x * (1.0 - expo))


def _quick(x, rc_rate, super_rate, expo):
    centre = 2.0 * rc_rate
    if centre == 0:
        return 0.0
    top = max(10.0 * super_rate, centre)
    curved = abs(x) ** 3 * expo + abs(x) * (1.0 - expo)
    return x * centre * _super_factor(curved * (top / centre - 1.0) / (top / centre))


def _quick_by_rate(x, rc_rate, super_rate, expo):
    centre = 2.0 * rc_rate
    if centre == 0:
        return 0.0
    top = max(10.0 * super_rate, centre)
    curved = x**3 * expo + x * (1.0 - expo)
    return curved * centre * _super_factor(abs(x) * (top / centre - 1.0) / (top / centre))


CURVES = (_betaflight, _raceflight, _kiss, _actual, _quick)
