"""Which commands a rate loop of type `rate_pid` heard: the loop run backwards from what it set the motors to. Pure.

    torque = J (kp e + ki sum(e) dt - kd d) + omega x J omega,   e = commanded rate - gyro,   d = low-passed d(gyro)/dt

and thrusts by the hubs' positions, all by the numbers of the vehicle file: a firmware knows nothing of what differs.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from swift_ros.vehicle import Vehicle

EDGE = 1e-6  # of a motor command: nearer to its limits it tells no more what was asked
KEYS = ("rate_hz", "rate_kp", "rate_ki", "rate_kd", "d_cutoff_hz", "idle")


@dataclass(frozen=True)
class RatePid:
    """rate_hz; kp 1/s, ki 1/s^2, kd (3,); d_cutoff_hz; idle; inertia (3, 3); mixer (4, r): the rotors' thrusts to their
    sum and torque; lift N s^2; shape (3,): steady speed = shape0 + shape1 sqrt(u) + shape2 u; mass kg; top m/s^2: all
    rotors at u = 1."""

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
        return 1.0 / self.rate_hz


def rate_pid_from_vehicle(vehicle: Vehicle) -> RatePid | None:
    """Return the rate loop of a vehicle file, None where it is of another type or lacks a number."""
    own = vehicle.controller
    if own.get("type") != "rate_pid" or not all(key in own for key in KEYS):
        return None
    position, spin = (np.array([getattr(rotor, key) for rotor in vehicle.rotors]) for key in ("position", "spin"))
    lift, volts, c = vehicle.thrust_coefficient, vehicle.battery.reference_voltage, vehicle.motor.map.coefficients
    mixer = np.stack([np.ones(len(spin)), position[:, 1], -position[:, 0], -spin * vehicle.torque_coefficient / lift])
    shape = np.array([c[0] + c[1] * volts, c[2] + c[4] * volts, c[3]])
    top = len(spin) * lift * float(np.clip(shape.sum(), *vehicle.rotor_speed_range)) ** 2 / vehicle.mass
    gains = (np.broadcast_to(np.asarray(own[key], dtype=float), 3) for key in ("rate_kp", "rate_ki", "rate_kd"))
    return RatePid(
        own["rate_hz"],
        *gains,
        own["d_cutoff_hz"],
        own["idle"],
        vehicle.inertia_matrix,
        mixer,
        lift,
        shape,
        vehicle.mass,
        top,
    )


def heard(loop: RatePid, gyro_body, motor_command, sent) -> tuple[np.ndarray, np.ndarray]:
    """Return rates (rad/s) and throttle (share of `top`) that the loop heard (n, 4) at each of its passes, and whether
    the motors tell them (n,). sent (n, 4): what was commanded, by which the loop's sum goes on where they do not, and
    by which its first value is told."""
    free = np.all((motor_command > loop.idle + EDGE) & (motor_command < 1.0 - EDGE), axis=1)
    speed = loop.shape @ np.stack([np.ones_like(motor_command), np.sqrt(motor_command), motor_command], axis=-2)
    wrench = loop.lift * speed**2 @ loop.mixer.T
    torque = wrench[:, 1:] - np.cross(gyro_body, gyro_body @ loop.inertia.T)
    asked = torque @ np.linalg.inv(loop.inertia).T + loop.kd * _derivative(loop, gyro_body)
    rates = gyro_body + np.stack(
        [_error(loop, i, asked[:, i], sent[:, i] - gyro_body[:, i], free) for i in range(3)], axis=-1
    )
    for i in range(3):
        rates[:, i] -= _of_first_sum(loop, i, rates[:, i] - sent[:, i], sent[:, i], free)
    return np.column_stack([rates, wrench[:, 0] / (loop.mass * loop.top)]), free


def _of_first_sum(loop: RatePid, axis: int, apart, sent, free) -> np.ndarray:
    """Return what the loop's unknown first sum does to what is heard (n,): it dies away, unlike gain and offset."""
    nothing = np.zeros_like(apart)
    dying = _error(loop, axis, nothing, nothing, free, 1.0)
    columns = np.stack([dying, np.ones_like(sent), sent], axis=-1)[free]
    return np.linalg.lstsq(columns, apart[free], rcond=None)[0][0] * dying


def _derivative(loop: RatePid, gyro_body) -> np.ndarray:
    keep = loop.step_s / (loop.step_s + 1.0 / (2.0 * np.pi * loop.d_cutoff_hz))
    raw = np.diff(gyro_body, axis=0, prepend=gyro_body[:1]) / loop.step_s
    return signal.lfilter([keep], [1.0, keep - 1.0], raw, axis=0)


def _error(loop: RatePid, axis: int, asked, commanded, free, total: float = 0.0) -> np.ndarray:
    """Return the error (n,) of one axis that asks for this angular acceleration beside its own sum, `total` rad at
    first."""
    kp, ki, dt, found = loop.kp[axis], loop.ki[axis], loop.step_s, np.empty(len(asked))
    for i, (turning, fallback, told) in enumerate(zip(asked.tolist(), commanded.tolist(), free.tolist(), strict=True)):
        error = (turning - ki * total) / (kp + ki * dt) if told else fallback
        total += dt * error
        found[i] = error
    return found
