"""The vehicle file: `config/drone.yaml`, or the file of another quadrotor.

SI units; positions in the body frame (FLU) from the centre of mass. docs/vehicle-file.md explains each key.
"""

import difflib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from swift_ros.plausibility import of_propulsion, of_vehicle
from swift_ros.plausibility.finding import Finding
from swift_ros.text import MAX_EXCERPT, described, excerpt

GRAVITY = 9.80665  # m/s^2, standard gravity
# Keys of the section `sensors`: standard deviations, with the unit at the end; rotor_relative is a share of the speed.
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
    """One rotor.

    Attributes:
        position: (3,) m from the centre of mass.
        spin: +1 for counter-clockwise, seen from above; -1 for clockwise.
    """

    position: tuple[float, float, float]
    spin: int

    def __post_init__(self):
        if self.spin not in (1, -1):
            raise ValueError("'spin' must be 1 or -1")


@dataclass(frozen=True)
class MotorMap:
    """Steady rotor speed = c0 + c1 U + c2 sqrt(u) + c3 u + c4 U sqrt(u), rad/s (Methods, eq. 6).

    U is the voltage in V and u the motor command, 0 to 1. `motor_command_for_speed` is the inverse.

    Attributes:
        coefficients: (c0, c1, c2, c3, c4).
        form: free text for the reader.
    """

    coefficients: tuple[float, float, float, float, float]
    form: str = ""


@dataclass(frozen=True)
class Motor:
    """A motor with its propeller.

    Attributes:
        time_constant_up: s of the first-order lag while the rotor accelerates.
        time_constant_down: s of the first-order lag while the rotor decelerates.
        map: steady rotor speed.
    """

    time_constant_up: float
    time_constant_down: float
    map: MotorMap

    def __post_init__(self):
        for name in ("time_constant_up", "time_constant_down"):
            if not getattr(self, name) > 0:
                raise ValueError(f"'motor.{name}' must be positive, in s")


@dataclass(frozen=True)
class Battery:
    """Battery: U = open_circuit_full - open_circuit_slope * charge/capacity - resistance * I - U_rc.

    Keys with a default are optional; what is absent is not simulated.

    Attributes:
        reference_voltage: V at which the rotor speed of full command is computed.
        open_circuit_full: V of the full battery without load.
        open_circuit_slope: V by which it drops over a whole discharge.
        capacity: A s.
        resistance: ohm.
        rc_resistance, rc_time: ohm and s of the first RC branch.
        efficiency: mechanical power of the rotors over electrical power.
        avionics_w: W of everything except the motors.
        cells: number of cells in series.
        model: free text for the reader.
        open_circuit_curve: V at evenly spaced shares of charge used, from full to empty; replaces the line.
        rc2_resistance, rc2_time: ohm and s of the second RC branch.
        energy: J of the full battery; the share used is then counted in energy.
        temperature: deg C at the start.
        temperature_slope: 1/K, relative change of the resistance from 25 deg C.
        heat_capacity: J/K by which losses warm the battery.
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
    """Limits of the body rates.

    Attributes:
        max: (3,) rad/s; the firmware's rate profile must cover them.
    """

    max: tuple[float, float, float]


@dataclass(frozen=True)
class Vehicle:
    """A quadrotor; docs/vehicle-file.md explains each key.

    Attributes:
        name: name of the vehicle.
        mass: kg.
        inertia: kg m^2 about the centre of mass, three diagonal values or a 3x3 matrix.
        rotors: rotors in motor order.
        rotor_radius: m.
        thrust_coefficient: N/(rad/s)^2 of one rotor.
        torque_coefficient: N m/(rad/s)^2 of one rotor.
        rotor_speed_range: rad/s, lowest and highest rotor speed.
        motor: motor with propeller.
        battery: battery.
        rates: limits of the body rates.
        controller: the flight controller, see `swift_sim_bridge.flight_controller.configuration`.
        hull_radius, hull_height: m, cylinder that must not touch anything.
        terms: coefficients of optional physical effects.
        sensors: standard deviations of measurement noise by the keys SENSORS.
        recording: free text for the reader.
        folder: folder of the vehicle file, to which its paths are relative.
    """

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
        if excerpt(self.name) != self.name:  # it stands in the sentences of errors
            raise ValueError(f"'name' must be a text of at most {MAX_EXCERPT} printable letters")
        if not self.mass > 0:
            raise ValueError("'mass' must be positive, in kg")
        if not _is_inertia(self.inertia) or not np.all(np.linalg.eigvalsh(self.inertia_matrix) > 0):
            raise ValueError("'inertia' must be three positive values or a positive definite 3x3 matrix, in kg m^2")
        low, high = self.rotor_speed_range
        if not 0 <= low < high:
            raise ValueError(
                f"'rotor_speed_range' must rise from its lowest to its highest speed, both 0 or more, not from {low:g} "
                f"to {high:g} rad/s" + ("; exchange them" if low > high >= 0 else "")
            )
        if not self.thrust_coefficient > 0:
            raise ValueError("'thrust_coefficient' must be positive, in N/(rad/s)^2")
        if self.thrust_to_weight <= 1:
            raise ValueError(of_propulsion.too_heavy(self))
        for key in (key for key in self.sensors if key not in SENSORS):
            near = difflib.get_close_matches(key, SENSORS, n=1, cutoff=0.0)[0]
            raise ValueError(f"'sensors' has the unknown key '{excerpt(str(key))}'; the nearest known one is '{near}'")
        for key, noise in self.sensors.items():
            if isinstance(noise, bool) or not isinstance(noise, int | float) or not noise >= 0:
                raise ValueError(f"'sensors.{key}' must be a number, 0 or more, not {described(noise)}")

    def findings(self) -> list[Finding]:
        """Return what is impossible or odd about this vehicle."""
        return of_vehicle.findings(self)

    @cached_property
    def inertia_matrix(self) -> np.ndarray:
        """Inertia (3, 3), kg m^2, about the centre of mass."""
        inertia = np.asarray(self.inertia, dtype=float)
        return np.diag(inertia) if inertia.ndim == 1 else inertia

    @property
    def max_thrust(self) -> float:
        """Thrust in N of all rotors at their highest speed."""
        return len(self.rotors) * self.thrust_coefficient * self.rotor_speed_range[1] ** 2

    @property
    def thrust_to_weight(self) -> float:
        """Maximum thrust over weight."""
        return self.max_thrust / (self.mass * GRAVITY)

    @property
    def hover_speed(self) -> float:
        """Rotor speed in hover, rad/s."""
        return float(np.sqrt(self.mass * GRAVITY / (len(self.rotors) * self.thrust_coefficient)))

    @property
    def full_speed(self) -> float:
        """Rotor speed in rad/s at full command and the battery's reference voltage."""
        return float(np.clip(self.motor_speed(1.0), *self.rotor_speed_range))

    def motor_speed(self, command: float) -> float:
        """Return the rotor speed in rad/s by the motor map at a command and the battery's reference voltage."""
        c0, c1, c2, c3, c4 = self.motor.map.coefficients
        volts, root = self.battery.reference_voltage, command**0.5
        return c0 + c1 * volts + c2 * root + c3 * command + c4 * volts * root


def _is_inertia(value) -> bool:
    """Return whether a value of a file is three finite numbers or a 3x3 matrix of them."""
    try:
        inertia = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return False
    return inertia.shape in ((3,), (3, 3)) and bool(np.isfinite(inertia).all())


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
    # Not zero: the slope of the root is infinite there, and a training descends on it.
    return xp.sqrt(xp.clip(thrust, 1e-12, None) * (mass / (rotors * thrust_coefficient)))


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
