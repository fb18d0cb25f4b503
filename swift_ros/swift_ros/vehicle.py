"""The vehicle file: `config/drone.yaml`, or anyone else's quadrotor. SI units, FLU from the centre of mass."""

import difflib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import array_namespace

GRAVITY = 9.80665
SENSORS = (
    "position_m",
    "velocity_m_s",
    "attitude_rad",
    "gyro_rad_s",
    "accel_m_s2",
    "vibration_m_s2",
    "rotor_relative",
    "vbat_v",
    "ibat_a",
)


@dataclass(frozen=True)
class Rotor:
    """position: (3,) m from the centre of mass; spin: +1 counter-clockwise seen from above, -1 clockwise."""

    position: tuple[float, float, float]
    spin: int

    def __post_init__(self):
        if self.spin not in (1, -1):
            raise ValueError("'spin' must be 1 or -1")


@dataclass(frozen=True)
class MotorMap:
    """Steady rotor speed = c0 + c1 U + c2 sqrt(u) + c3 u + c4 U sqrt(u), U in V, command u in 0..1 (Methods, eq. 6)."""

    coefficients: tuple[float, float, float, float, float]
    form: str = ""


@dataclass(frozen=True)
class Motor:
    """time_constant_up, time_constant_down: s of the first-order lag while speeding up and slowing down."""

    time_constant_up: float
    time_constant_down: float
    map: MotorMap

    def __post_init__(self):
        for name in ("time_constant_up", "time_constant_down"):
            if not getattr(self, name) > 0:
                raise ValueError(f"'motor.{name}' must be positive, in s")


@dataclass(frozen=True)
class Battery:
    """Pack: U = open_circuit_full - open_circuit_slope * charge/capacity - resistance * I - U_rc (V, A s, ohm, s).

    A richer pack adds: open_circuit_curve, V at evenly spaced shares used, from full to empty, in place of the line;
    rc2_resistance, rc2_time: a second branch; energy: J, by which the share used is then counted; temperature_slope:
    1/K of the resistance, given at 25 deg C, with temperature: deg C at the start, and heat_capacity: J/K by which
    losses warm the pack. What is absent is not simulated.
    """

    reference_voltage: float
    open_circuit_full: float
    open_circuit_slope: float
    capacity: float
    resistance: float
    rc_resistance: float
    rc_time: float
    efficiency: float
    avionics_w: float
    cells: int = 0
    model: str = ""
    open_circuit_curve: tuple[float, ...] = ()
    rc2_resistance: float = 0.0
    rc2_time: float = 0.0
    energy: float = 0.0
    temperature: float = 25.0
    temperature_slope: float = 0.0
    heat_capacity: float = 0.0

    def __post_init__(self):
        if len(self.open_circuit_curve) == 1:
            raise ValueError("'open_circuit_curve' must have two values or more, from full to empty")
        if (self.rc2_resistance > 0) != (self.rc2_time > 0):
            raise ValueError("'rc2_resistance' and 'rc2_time' must be given together, both positive")


@dataclass(frozen=True)
class Rates:
    """max: (3,) rad/s, the vehicle's body-rate limits, which the firmware's rate profile must cover."""

    max: tuple[float, float, float]


@dataclass(frozen=True)
class Vehicle:
    """A quadrotor; keys and units as in docs/vehicle-file.md. folder: of its file, for paths in it."""

    name: str
    mass: float
    inertia: Any
    rotors: tuple[Rotor, ...]
    rotor_radius: float
    thrust_coefficient: float
    torque_coefficient: float
    rotor_speed_range: tuple[float, float]
    motor: Motor
    battery: Battery
    rates: Rates
    controller: dict[str, Any]
    hull_radius: float = 0.18
    hull_height: float = 0.1
    terms: dict[str, Any] = field(default_factory=dict)
    sensors: dict[str, Any] = field(default_factory=dict)
    recording: str = ""
    folder: str = field(default="", compare=False)

    def __post_init__(self):
        if not self.mass > 0:
            raise ValueError("'mass' must be positive, in kg")
        if np.shape(self.inertia) not in ((3,), (3, 3)) or not np.all(np.linalg.eigvalsh(self.inertia_matrix) > 0):
            raise ValueError("'inertia' must be three positive values or a positive definite 3x3 matrix, in kg m^2")
        if self.thrust_to_weight <= 1:
            raise ValueError(f"this vehicle cannot hover: thrust-to-weight is {self.thrust_to_weight:.2f}")
        for key in (key for key in self.sensors if key not in SENSORS):
            near = difflib.get_close_matches(key, SENSORS, n=1, cutoff=0.0)[0]
            raise ValueError(f"'sensors' has the unknown key '{key}'; the nearest known one is '{near}'")
        for key, noise in self.sensors.items():
            if isinstance(noise, bool) or not isinstance(noise, int | float) or not noise >= 0:
                raise ValueError(f"'sensors.{key}' must be a number, 0 or more, not {noise!r}")

    @cached_property
    def inertia_matrix(self) -> np.ndarray:
        """J (3, 3), kg m^2, about the centre of mass."""
        inertia = np.asarray(self.inertia, dtype=float)
        return np.diag(inertia) if inertia.ndim == 1 else inertia

    @property
    def max_thrust(self) -> float:
        """N, all rotors at the top of their speed range."""
        return len(self.rotors) * self.thrust_coefficient * self.rotor_speed_range[1] ** 2

    @property
    def thrust_to_weight(self) -> float:
        return self.max_thrust / (self.mass * GRAVITY)

    @property
    def hover_speed(self) -> float:
        """rad/s of all rotors in hover."""
        return float(np.sqrt(self.mass * GRAVITY / (len(self.rotors) * self.thrust_coefficient)))

    @property
    def full_speed(self) -> float:
        """rad/s that the motor map reaches at full command and the pack's reference voltage."""
        c0, c1, c2, c3, c4 = self.motor.map.coefficients
        volts = self.battery.reference_voltage
        return float(np.clip(c0 + c1 * volts + c2 + c3 + c4 * volts, *self.rotor_speed_range))


def rotor_speed_for_thrust(thrust, mass: float, thrust_coefficient: float, rotors: int = 4):
    """Return the rotor speed at which all rotors together give a collective thrust.

    Args:
        thrust: (...) m/s^2, mass-normalised; negative values count as zero.
        mass: kg.
        thrust_coefficient: N/(rad/s)^2 of one rotor.
        rotors: number of rotors.

    Returns:
        (...) rad/s of each rotor.
    """
    xp = array_namespace(thrust)
    return xp.sqrt(xp.clip(thrust, 0.0, None) * (mass / (rotors * thrust_coefficient)))


def motor_command_for_speed(speed, voltage, coefficients):
    """Return the motor command whose steady rotor speed is `speed`: the inverse of `MotorMap`.

    The map is quadratic in sqrt(u): speed = c0 + c1 U + (c2 + c4 U) sqrt(u) + c3 u.

    Args:
        speed: (...) rad/s; NumPy or JAX array.
        voltage: (...) V at the battery's terminals.
        coefficients: (c0, c1, c2, c3, c4) of the motor map.

    Returns:
        u (...) >= 0. Not clipped at 1: a value above 1 means that the battery cannot give this speed. Below the speed
        at u = 0 the result is 0.
    """
    xp = array_namespace(speed)
    c0, c1, c2, c3, c4 = coefficients
    slope = c2 + c4 * voltage
    above_zero_command = xp.clip(speed - c0 - c1 * voltage, 0.0, None)
    # This form of the root stays exact for c3 -> 0; where the map bends down (c3 < 0) it ends at the map's maximum.
    discriminant = xp.clip(slope * slope + 4.0 * c3 * above_zero_command, 0.0, None)
    root = 2.0 * above_zero_command / (slope + xp.sqrt(discriminant))
    return root * root
