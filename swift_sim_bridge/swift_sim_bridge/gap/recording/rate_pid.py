"""Reconstruction of the commands that a rate loop of type `rate_pid` received, by inversion of the loop.

    torque = J (kp e + ki sum(e) dt - kd d) + omega x J omega,   e = commanded rate - gyro,   d = low-passed d(gyro)/dt

The thrusts follow from the torque and the hubs' positions. All numbers are those of the vehicle file, because the
firmware computes with them, whatever the real vehicle is.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from swift_ros.vehicle import Vehicle

LIMIT_MARGIN = 1e-6  # of a motor command: closer to its limits the command is clipped and the demand is unknown
KEYS = ("rate_hz", "rate_kp", "rate_ki", "rate_kd", "d_cutoff_hz", "idle")


@dataclass(frozen=True)
class RatePid:
    """A rate loop with its mixer and its model of the vehicle.

    Attributes:
        rate_hz: passes per second.
        kp: (3,) 1/s.
        ki: (3,) 1/s^2.
        kd: (3,).
        d_cutoff_hz: cutoff of the derivative's low-pass.
        idle: lowest motor command.
        inertia: (3, 3) kg m^2.
        mixer: (4, r), from the rotors' thrusts to their sum and torque.
        lift: thrust coefficient, N s^2.
        shape: (3,), steady rotor speed = shape[0] + shape[1] sqrt(u) + shape[2] u, rad/s.
        mass: kg.
        top: collective thrust with all motor commands at 1, m/s^2.
    """

    rate_hz: float
    kp: np.ndarray
    ki: np.ndarray
    kd: np.ndarray
    d_cutoff_hz: float
    idle: float
    inertia: np.ndarray
    mixer: np.ndarray
    lift: float
    shape: np.ndarray
    mass: float
    top: float

    @property
    def step_s(self) -> float:
        """The period of the loop."""
        return 1.0 / self.rate_hz


def rate_pid_from_vehicle(vehicle: Vehicle) -> RatePid | None:
    """Return the rate loop of a vehicle file, None where it is of another type or lacks a parameter."""
    section = vehicle.controller
    if section.get("type") != "rate_pid" or not all(key in section for key in KEYS):
        return None
    position, spin = (np.array([getattr(rotor, key) for rotor in vehicle.rotors]) for key in ("position", "spin"))
    lift, volts, c = vehicle.thrust_coefficient, vehicle.battery.reference_voltage, vehicle.motor.map.coefficients
    mixer = np.stack([np.ones(len(spin)), position[:, 1], -position[:, 0], -spin * vehicle.torque_coefficient / lift])
    shape = np.array([c[0] + c[1] * volts, c[2] + c[4] * volts, c[3]])
    top = len(spin) * lift * float(np.clip(shape.sum(), *vehicle.rotor_speed_range)) ** 2 / vehicle.mass
    kp, ki, kd = (
        np.broadcast_to(np.asarray(section[key], dtype=float), 3) for key in ("rate_kp", "rate_ki", "rate_kd")
    )
    return RatePid(
        rate_hz=section["rate_hz"],
        kp=kp,
        ki=ki,
        kd=kd,
        d_cutoff_hz=section["d_cutoff_hz"],
        idle=section["idle"],
        inertia=vehicle.inertia_matrix,
        mixer=mixer,
        lift=lift,
        shape=shape,
        mass=vehicle.mass,
        top=top,
    )


def received_commands(loop: RatePid, gyro_body, motor_command, sent) -> tuple[np.ndarray, np.ndarray]:
    """Return the commands that the loop received at each of its passes.

    Args:
        loop: the rate loop.
        gyro_body: (n, 3) rad/s.
        motor_command: (n, r), 0..1.
        sent: (n, 4), the command sent last. It continues the loop's integral where the motor commands are clipped, and
            its relation to the result determines the integral's first value.

    Returns:
        Rates (rad/s) and throttle (share of `loop.top`), (n, 4), and where (n,) the motor commands determine them.
    """
    free = np.all((motor_command > loop.idle + LIMIT_MARGIN) & (motor_command < 1.0 - LIMIT_MARGIN), axis=1)
    speed = loop.shape @ np.stack([np.ones_like(motor_command), np.sqrt(motor_command), motor_command], axis=-2)
    wrench = loop.lift * speed**2 @ loop.mixer.T
    torque = wrench[:, 1:] - np.cross(gyro_body, gyro_body @ loop.inertia.T)
    demand = torque @ np.linalg.inv(loop.inertia).T + loop.kd * _derivative(loop, gyro_body)
    rates = gyro_body + np.stack(
        [_error(loop, i, demand[:, i], sent[:, i] - gyro_body[:, i], free) for i in range(3)], axis=-1
    )
    for i in range(3):
        rates[:, i] -= _initial_integral_response(loop, i, rates[:, i] - sent[:, i], sent[:, i], free)
    return np.column_stack([rates, wrench[:, 0] / (loop.mass * loop.top)]), free


def _initial_integral_response(loop: RatePid, axis: int, error, sent, free) -> np.ndarray:
    """Return the effect (n,) of the unknown initial integral on the reconstructed rate.

    It decays, unlike gain and offset of the command, so that least squares separates them.
    """
    zero = np.zeros_like(error)
    decaying = _error(loop, axis, zero, zero, free, 1.0)
    columns = np.stack([decaying, np.ones_like(sent), sent], axis=-1)[free]
    return np.linalg.lstsq(columns, error[free], rcond=None)[0][0] * decaying


def _derivative(loop: RatePid, gyro_body) -> np.ndarray:
    """Return the low-passed derivative (n, 3) rad/s^2 of the gyro, as the loop computes it."""
    keep = loop.step_s / (loop.step_s + 1.0 / (2.0 * np.pi * loop.d_cutoff_hz))
    raw = np.diff(gyro_body, axis=0, prepend=gyro_body[:1]) / loop.step_s
    return signal.lfilter([keep], [1.0, keep - 1.0], raw, axis=0)


def _error(loop: RatePid, axis: int, demand, commanded, free, integral: float = 0.0) -> np.ndarray:
    """Return the control error (n,) rad/s of one axis from its demanded angular acceleration.

    Args:
        loop: the rate loop.
        axis: 0, 1 or 2.
        demand: (n,) rad/s^2.
        commanded: (n,) rad/s, error where the demand is not known.
        free: (n,) bool, where the demand is known.
        integral: initial integral of the error, rad.
    """
    kp, ki, dt, found = loop.kp[axis], loop.ki[axis], loop.step_s, np.empty(len(demand))
    rows = zip(demand.tolist(), commanded.tolist(), free.tolist(), strict=True)
    for i, (acceleration, fallback, known) in enumerate(rows):
        error = (acceleration - ki * integral) / (kp + ki * dt) if known else fallback
        integral += dt * error
        found[i] = error
    return found
