"""The IMU as it is read once a tick: the errors of `imu_errors`, a bias drawn for the flight, and white noise.

A reading is a sample, not a mean: the rates at its stamp, the specific force of the physics' last step, 1 ms before.
"""

from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.imu_errors import ImuMemory, ImuTruth


@dataclass(frozen=True)
class ImuSettings:
    """Section `imu`: gyro_bias rad/s and accel_bias m/s^2, standard deviation an axis of one draw a flight."""

    gyro_bias: float
    accel_bias: float


class Imu:
    """Bias drawn once, white noise a sample. gyro_noise rad/s and accel_noise m/s^2: standard deviations.

    terms: the vehicle's sensor terms, of which the IMU's count; `distorts` says whether there are any; shaking: draws
    the vibration.
    """

    def __init__(self, settings: ImuSettings, gyro_noise: float, accel_noise: float, rng, terms=None, shaking=None):
        self._rng, self._shaking = rng, shaking
        self._noise = (gyro_noise, accel_noise)
        self._bias = (settings.gyro_bias * rng.standard_normal(3), settings.accel_bias * rng.standard_normal(3))
        self._terms = {name: entry for name, entry in (terms or {}).items() if name in imu_errors.TERMS}
        self._memory = ImuMemory()
        self.distorts = bool(self._terms)

    def measure(self, omega_body, specific_force_body) -> tuple[np.ndarray, np.ndarray]:
        """Return measured rates (3,) rad/s and specific force (3,) m/s^2, body frame, of the true ones."""
        truth = (np.asarray(omega_body), np.asarray(specific_force_body))
        gyro, accel = (
            value + bias + noise * self._rng.standard_normal(3)
            for value, bias, noise in zip(truth, self._bias, self._noise, strict=True)
        )
        return imu_errors.clip(gyro, accel, self._terms) if self.distorts else (gyro, accel)

    def measure_samples(self, truth: ImuTruth) -> tuple[np.ndarray, np.ndarray]:
        """Return what `measure` does of the last of the samples since the last reading."""
        gyro, accel, self._memory = imu_errors.distort(truth, self._terms, self._shaking, self._memory)
        return self.measure(gyro[-1], accel[-1])
