"""The IMU, read once per tick: the errors of `imu_errors`, a random bias for the flight, and white noise.

A reading is a sample, not a mean: the body rates at its stamp, and the specific force of the physics' last step, whose
middle is 1 ms earlier.
"""

from dataclasses import dataclass

import numpy as np

from swift_ros.configuration import setting
from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.imu_errors import ImuMemory, ImuTruth


@dataclass(frozen=True)
class ImuSettings:
    """Section `imu` of simulation.yaml: standard deviations of the biases, drawn once per flight for each axis.

    Attributes:
        gyro_bias: rad/s.
        accel_bias: m/s^2.
    """

    gyro_bias: float = setting("rad/s after calibration, of MEMS gyros 0.001 to 0.1", 0.0, 1.0)
    accel_bias: float = setting("m/s^2, of MEMS accelerometers 0.1 to 1; g is 9.8 m/s^2", 0.0, 3.0)


class Imu:
    """Gyro and accelerometer.

    Args:
        settings: of the biases.
        gyro_noise: rad/s, standard deviation of white noise.
        accel_noise: m/s^2, standard deviation of white noise.
        rng: draws biases and noise.
        terms: the vehicle's sensor terms, of which those of the IMU are used.
        vibration_rng: draws the vibration.

    Attributes:
        distorts: whether there are terms of the IMU.
    """

    def __init__(
        self, settings: ImuSettings, gyro_noise: float, accel_noise: float, rng, terms=None, vibration_rng=None
    ):
        self._rng, self._vibration_rng = rng, vibration_rng
        self._noise = (gyro_noise, accel_noise)
        self._bias = (settings.gyro_bias * rng.standard_normal(3), settings.accel_bias * rng.standard_normal(3))
        self._terms = {name: entry for name, entry in (terms or {}).items() if name in imu_errors.TERMS}
        self._memory = ImuMemory()
        self.distorts = bool(self._terms)

    def measure(self, omega_body, specific_force_body) -> tuple[np.ndarray, np.ndarray]:
        """Return measured rates (3,) rad/s and specific force (3,) m/s^2 for the true ones, body frame."""
        truth = (np.asarray(omega_body), np.asarray(specific_force_body))
        gyro, accel = (
            value + bias + noise * self._rng.standard_normal(3)
            for value, bias, noise in zip(truth, self._bias, self._noise, strict=True)
        )
        return imu_errors.clip(gyro, accel, self._terms) if self.distorts else (gyro, accel)

    def measure_samples(self, truth: ImuTruth) -> tuple[np.ndarray, np.ndarray]:
        """Return the same as `measure`, given the true samples since the last reading."""
        gyro, accel, self._memory = imu_errors.distort(truth, self._terms, self._vibration_rng, self._memory)
        return self.measure(gyro[-1], accel[-1])
