"""Errors of an IMU, applied to the true motion (`distort`): those of its calibration, vibration, range and bandwidth.

    gyro  = clip(calibrated omega + v_g),   accel = clip(calibrated f_imu + v_a),   each then low-pass filtered

The calibration is that of `imu_calibration`. Every error is one entry of a vehicle file's `terms`, absent by default.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.effects import TermSpecification
from swift_sim_bridge.sensors import imu_calibration
from swift_sim_bridge.sensors.imu_calibration import accelerometer_reading, gyro_reading, specific_force_at_imu


@dataclass(frozen=True)
class Vibration:
    """Vibration of the propellers in the IMU.

    Attributes:
        accel: standard deviation of each sample and axis, m/s^2 per rad/s of the rotors' root mean square speed, 2e-3
            to 2e-2.
        gyro: the same for the gyro, rad/s per rad/s, about 1e-4.
        unbalance: m, mass times eccentricity of each propeller over the vehicle's mass, up to 1e-6: a force that turns
            with the rotor and is measured as unbalance * speed^2 on x and y.
    """

    accel: float = 0.0
    gyro: float = 0.0
    unbalance: float = 0.0


@dataclass(frozen=True)
class Clipping:
    """Measurement ranges.

    Attributes:
        gyro: rad/s (2000 deg/s: 34.9).
        accel: m/s^2 (16 g: 156.9).
    """

    gyro: float = np.inf
    accel: float = np.inf

    def __post_init__(self):
        if not (self.gyro > 0 and self.accel > 0):
            raise ValueError("'gyro' and 'accel' are ranges and must be positive")


@dataclass(frozen=True)
class Bandwidth:
    """Cut-off frequencies (-3 dB) of the sensor's second-order Butterworth low-pass.

    Attributes:
        gyro_hz: Hz, 50 to 250.
        accel_hz: Hz, 50 to 250.
    """

    gyro_hz: float = np.inf
    accel_hz: float = np.inf

    def __post_init__(self):
        if not (self.gyro_hz > 0 and self.accel_hz > 0):
            raise ValueError("'gyro_hz' and 'accel_hz' must be positive")


TERMS = {
    **imu_calibration.TERMS,
    "imu_vibration": TermSpecification(
        Vibration,
        idle={},
        example={"accel": 5e-3, "gyro": 1e-4, "unbalance": 1e-6},
        units={"accel": "m/s^2/(rad/s)", "gyro": "rad/s/(rad/s)", "unbalance": "m"},
    ),
    "imu_clipping": TermSpecification(
        Clipping, idle={}, example={"gyro": 34.9, "accel": 156.9}, units={"gyro": "rad/s", "accel": "m/s^2"}
    ),
    "imu_bandwidth": TermSpecification(
        Bandwidth, idle={}, example={"gyro_hz": 100.0, "accel_hz": 90.0}, units={"gyro_hz": "Hz", "accel_hz": "Hz"}
    ),
}


class ImuTruth(NamedTuple):
    """True motion of the centre of mass in n samples.

    Attributes:
        dt: s between samples.
        omega_body: (n, 3) rad/s.
        alpha_body: (n, 3) rad/s^2.
        specific_force_body: (n, 3) m/s^2.
        rotor_speed: (n, r) rad/s.
    """

    dt: float
    omega_body: np.ndarray
    alpha_body: np.ndarray
    specific_force_body: np.ndarray
    rotor_speed: np.ndarray


class ImuMemory(NamedTuple):
    """State of `distort` between calls; None at the start.

    Attributes:
        phase: (r,) rad of the rotors.
        gyro: state of the gyro's low-pass.
        accel: state of the accelerometer's low-pass.
    """

    phase: Any = None
    gyro: Any = None
    accel: Any = None


def angular_acceleration(omega_body, dt: float, before=None) -> np.ndarray:
    """Return the mean angular acceleration (n, 3) rad/s^2 over the sample interval before each sample.

    Args:
        omega_body: (n, 3) rad/s.
        dt: s between samples.
        before: (3,) rad/s one sample earlier; without it the first acceleration is zero.
    """
    earlier = omega_body[:1] if before is None else np.reshape(before, (1, 3))
    return np.diff(omega_body, axis=0, prepend=earlier) / dt


def vibration(rotor_speed, dt: float, coefficients: Vibration, rng, phase=None):
    """Return the vibration in gyro (n, 3) rad/s and accelerometer (n, 3) m/s^2, and the rotors' phases (r,) rad.

    Args:
        rotor_speed: (n, r) rad/s.
        dt: s between samples.
        coefficients: of the vibration.
        rng: draws it.
        phase: (r,) rad at the start; zero where None.
    """
    phase = np.zeros(rotor_speed.shape[-1]) if phase is None else phase
    phases = phase + np.cumsum(rotor_speed * dt, axis=0)
    rms = np.sqrt(np.mean(rotor_speed**2, axis=-1, keepdims=True))
    gyro = coefficients.gyro * rms * rng.standard_normal((len(rms), 3))
    accel = coefficients.accel * rms * rng.standard_normal((len(rms), 3))
    pull = coefficients.unbalance * rotor_speed**2
    accel[:, 0] += np.sum(pull * np.cos(phases), axis=-1)
    accel[:, 1] += np.sum(pull * np.sin(phases), axis=-1)
    return gyro, accel, np.mod(phases[-1], 2 * np.pi)


def butterworth(hz: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator (3,) of a second-order low-pass of samples dt s apart, -3 dB at `hz`.

    Bilinear transform, prewarped so that this frequency is exact. Raises UsageError at half the sample rate or above.
    """
    if hz >= 0.5 / dt:
        raise UsageError(
            f"imu_bandwidth of {hz:g} Hz cannot be simulated every {1e3 * dt:g} ms; it must be below "
            f"{0.5 / dt:g} Hz, or absent"
        )
    k = np.tan(np.pi * hz * dt)
    scale = 1 / (1 + np.sqrt(2) * k + k * k)
    denominator = np.array([1.0, 2 * (k * k - 1) * scale, (1 - np.sqrt(2) * k + k * k) * scale])
    return k * k * scale * np.array([1.0, 2.0, 1.0]), denominator


def band_limit(values, hz: float, dt: float, memory=None):
    """Return values (n, k) low-pass filtered at `hz`, and the state of the filter, which starts settled."""
    if np.isinf(hz):
        return values, None
    from scipy import signal  # imported here, because it takes half a second

    numerator, denominator = butterworth(hz, dt)
    if memory is None:
        memory = signal.lfilter_zi(numerator, denominator)[:, None] * values[:1]
    return signal.lfilter(numerator, denominator, values, axis=0, zi=memory)


def clip(gyro, accel, terms: dict):
    """Return both readings (..., 3), limited to the ranges of `imu_clipping`."""
    ranges = terms.get("imu_clipping", Clipping())
    return np.clip(gyro, -ranges.gyro, ranges.gyro), np.clip(accel, -ranges.accel, ranges.accel)


def distort(truth: ImuTruth, terms: dict, rng, memory: ImuMemory = ImuMemory()):  # noqa: B008 - a constant
    """Return gyro (n, 3) rad/s and accelerometer (n, 3) m/s^2 without white noise, and the state for the next call.

    Args:
        truth: true motion.
        terms: coefficients by name; those of other sensors are ignored.
        rng: draws the vibration.
        memory: state after the last call.
    """
    at_imu, phase = specific_force_at_imu(truth.specific_force_body, truth.omega_body, truth.alpha_body, terms), None
    gyro, accel = gyro_reading(truth.omega_body, at_imu, terms), accelerometer_reading(at_imu, terms)
    if coefficients := terms.get("imu_vibration"):
        gyro_vibration, accel_vibration, phase = vibration(truth.rotor_speed, truth.dt, coefficients, rng, memory.phase)
        gyro, accel = gyro + gyro_vibration, accel + accel_vibration
    gyro, accel = clip(gyro, accel, terms)
    band = terms.get("imu_bandwidth", Bandwidth())
    gyro, gyro_memory = band_limit(gyro, band.gyro_hz, truth.dt, memory.gyro)
    accel, accel_memory = band_limit(accel, band.accel_hz, truth.dt, memory.accel)
    return gyro, accel, ImuMemory(phase, gyro_memory, accel_memory)
