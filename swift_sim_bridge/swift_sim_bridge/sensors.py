"""Sensors of the simulated vehicle: IMU, visual-inertial odometry, and the flight controller's attitude estimate.

Each is fed the truth once a tick and returns what it would measure. Their constants stand in `config/simulation.yaml`.
"""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.types import Odometry


@dataclass(frozen=True)
class ImuSettings:
    """Section `imu`: gyro_bias rad/s and accel_bias m/s^2, standard deviation an axis of one draw a flight."""

    gyro_bias: float
    accel_bias: float


@dataclass(frozen=True)
class AttitudeSettings:
    """Section `attitude_estimate`: tilt_deg, standard deviation of roll and of pitch; memory_s of its wandering."""

    tilt_deg: float
    memory_s: float


@dataclass(frozen=True)
class VioSettings:
    """Section `vio`, whose comments give source and unit of each key."""

    walk: float
    rate_share: float
    rate_memory_s: float
    rotation_ref: float
    scale: float
    velocity_share: float
    velocity_memory_s: float
    velocity_noise: float
    position_noise: float
    tilt_deg: float
    tilt_memory_s: float
    yaw_walk_deg: float
    rate_noise: float


class Wandering:
    """A random vector (n,) that starts at zero, wanders about it and forgets: Ornstein-Uhlenbeck, exact at any step."""

    def __init__(self, size: int, memory_s: float, rng: np.random.Generator):
        self.value = np.zeros(size)
        self._memory_s = memory_s
        self._rng = rng

    def step(self, dt: float, sigma: float) -> np.ndarray:
        """Return the value after dt s in which its standard deviation tends to `sigma`."""
        keep = np.exp(-dt / self._memory_s)
        self.value = keep * self.value + sigma * np.sqrt(1 - keep * keep) * self._rng.standard_normal(self.value.size)
        return self.value


class Imu:
    """Bias drawn once, white noise a sample. gyro_noise rad/s and accel_noise m/s^2: standard deviations."""

    def __init__(self, settings: ImuSettings, gyro_noise: float, accel_noise: float, rng: np.random.Generator):
        self._rng = rng
        self._noise = (gyro_noise, accel_noise)
        self._bias = (settings.gyro_bias * rng.standard_normal(3), settings.accel_bias * rng.standard_normal(3))

    def measure(self, omega_body, specific_force_body) -> tuple[np.ndarray, np.ndarray]:
        """Return measured rates (3,) rad/s and specific force (3,) m/s^2, body frame, of the true ones."""
        truth = (np.asarray(omega_body), np.asarray(specific_force_body))
        gyro, accel = (
            value + bias + noise * self._rng.standard_normal(3)
            for value, bias, noise in zip(truth, self._bias, self._noise, strict=True)
        )
        return gyro, accel


class AttitudeEstimate:
    """The flight controller's attitude: the truth with a slowly wandering tilt (its heading is not used)."""

    def __init__(self, settings: AttitudeSettings, rng: np.random.Generator):
        self._sigma = np.radians(settings.tilt_deg)
        self._tilt = Wandering(2, settings.memory_s, rng)

    def measure(self, q_world_body, dt: float) -> np.ndarray:
        """Return the estimate (4,) dt s after the last one."""
        tilt = self._tilt.step(dt, self._sigma)
        return _tilted(tilt, q_world_body)


def _tilted(tilt_world, q_world_body) -> np.ndarray:
    error = geometry.quaternion_from_rotation_vector(np.array([tilt_world[0], tilt_world[1], 0.0]))
    return geometry.quaternion_multiply(error, np.asarray(q_world_body))


class Vio:
    """Visual-inertial odometry: exact at the first measurement, drifting ever after, in a frame aligned there.

    The drift is a walk of the path flown, plus a rate that wanders with the speed; both grow with rotation. Heading
    walks with what was turned, the scale is off by a constant, and both bend the path as they bend a real one's.
    """

    def __init__(self, settings: VioSettings, rng: np.random.Generator):
        self._settings = settings
        self._rng = rng
        self._scale = 1.0 + settings.scale * rng.standard_normal()
        self._rate = Wandering(3, settings.rate_memory_s, rng)
        self._velocity = Wandering(3, settings.velocity_memory_s, rng)
        self._tilt = Wandering(2, settings.tilt_memory_s, rng)
        self._yaw = 0.0
        self._p_odom: np.ndarray | None = None
        self._last = (0, np.zeros(3))

    def measure(self, stamp_ns: int, p_world, q_world_body, v_world, omega_body) -> Odometry:
        """Return odometry in its own frame (map as it was at the first measurement), twist in the body frame."""
        p_world, v_world, omega_body = (np.asarray(value) for value in (p_world, v_world, omega_body))
        if self._p_odom is None:
            self._p_odom, self._last = p_world.copy(), (stamp_ns, p_world)
        self._drift(stamp_ns, p_world, v_world, omega_body)
        s, noise = self._settings, self._rng.standard_normal((3, 3))
        turn = geometry.quaternion_from_yaw(np.asarray(self._yaw))
        q_odom_body = geometry.quaternion_multiply(turn, _tilted(self._tilt.value, q_world_body))
        v_odom = self._scale * geometry.rotate(turn, v_world) + self._rate.value + self._velocity.value
        return Odometry(
            stamp_ns=stamp_ns,
            p_world=self._p_odom + s.position_noise * noise[0],
            q_world_body=q_odom_body,
            v_body=geometry.rotate_inverse(q_odom_body, v_odom + s.velocity_noise * noise[1]),
            omega_body=omega_body + s.rate_noise * noise[2],
        )

    def _drift(self, stamp_ns: int, p_world, v_world, omega_body) -> None:
        s, (last_ns, p_last) = self._settings, self._last
        dt = 1e-9 * (stamp_ns - last_ns)
        self._last = (stamp_ns, p_world)
        if dt <= 0:
            return
        moved, speed, turning = p_world - p_last, np.linalg.norm(v_world), np.linalg.norm(omega_body)
        growth = 1.0 + turning / s.rotation_ref
        rate = self._rate.step(dt, s.rate_share * speed * np.sqrt(growth))
        self._velocity.step(dt, s.velocity_share * speed)
        self._tilt.step(dt, np.radians(s.tilt_deg))
        turn = geometry.quaternion_from_yaw(np.asarray(self._yaw))
        walk = s.walk * np.sqrt(np.linalg.norm(moved) * growth) * self._rng.standard_normal(3)
        self._p_odom = self._p_odom + self._scale * geometry.rotate(turn, moved) + rate * dt + walk
        self._yaw += np.radians(s.yaw_walk_deg) * np.sqrt(turning * dt) * self._rng.standard_normal()
