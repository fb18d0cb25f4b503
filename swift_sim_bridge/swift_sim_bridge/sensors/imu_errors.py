"""Errors of an IMU: the coefficients of each, and the functions that apply them to the true motion (`distort`).

    gyro  = clip((I + S_g + M_g) omega + G f_imu + b_g + v_g)
    accel = clip((I + S_a + M_a) f_imu + b_a + v_a)                  each then low-pass filtered
    f_imu = f + omega' x r + omega x (omega x r)

Every error is one entry of a vehicle file's `terms`, absent by default; b, S, M and G as in the specifications of
inertial sensors (IEEE 952, 1293), with sizes of the micro-machined sensors on small vehicles.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_sim_bridge.effects import IMU_CHANNELS, MOTION_CHANNELS, Effect, TermSpecification, vector_parameters


@dataclass(frozen=True)
class Bias:
    """Bias of the gyro or the accelerometer.

    Attributes:
        bias: (3,) rad/s (`gyro_bias`, 0.005 to 0.05) or m/s^2 (`accel_bias`, 0.05 to 0.5).
    """

    bias: tuple[float, float, float]


@dataclass(frozen=True)
class Scale:
    """Scale error of the gyro or the accelerometer.

    Attributes:
        scale: (3,) relative error of each axis, 0.003 to 0.03.
    """

    scale: tuple[float, float, float]


@dataclass(frozen=True)
class Misalignment:
    """Cross-axis sensitivity of the gyro or the accelerometer.

    Attributes:
        cross: (6,) share of another axis in each axis, 0.005 to 0.03: y in x, z in x, x in y, z in y, x in z, y in z.
    """

    cross: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class GSensitivity:
    """Sensitivity of the gyro to specific force.

    Attributes:
        gain: (3,) rad/s per m/s^2 along each axis, about 1e-3.
    """

    gain: tuple[float, float, float]


@dataclass(frozen=True)
class LeverArm:
    """Lever arm of the accelerometer.

    Attributes:
        position: (3,) m from the centre of mass, 0.005 to 0.04.
    """

    position: tuple[float, float, float]


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


IDLE_VECTOR = [0.0, 0.0, 0.0]
MISALIGNMENT = TermSpecification(  # of gyro and accelerometer
    Misalignment,
    idle={"cross": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]},
    example={"cross": [0.01, -0.005, 0.02, 0.01, -0.015, 0.008]},
    units={"cross": ""},
)
TERMS = {
    "gyro_bias": TermSpecification(
        Bias,
        idle={"bias": IDLE_VECTOR},
        example={"bias": [0.02, -0.015, 0.03]},
        effects=(
            Effect(
                id="gyro_bias",
                layer="imu",
                parameters=vector_parameters("bias", "rad/s", "gyro_bias", step=1e-3, bounds=(-1.0, 1.0)),
                equation="gyro = omega + b",
                sentence="the gyro is off by {values} rad/s",
                manoeuvre="hover for 60 s",
                channels=MOTION_CHANNELS,
            ),
        ),
    ),
    "gyro_scale": TermSpecification(
        Scale,
        idle={"scale": IDLE_VECTOR},
        example={"scale": [0.01, -0.02, 0.015]},
        effects=(
            Effect(
                id="gyro_scale",
                layer="imu",
                parameters=vector_parameters("scale", "", "gyro_scale", step=1e-3, bounds=(-0.3, 0.3)),
                equation="gyro = (1 + s) omega",
                sentence="the gyro reads {values} (shares) too much",
                manoeuvre="spins about each axis",
                channels=MOTION_CHANNELS,
            ),
        ),
    ),
    "gyro_misalignment": MISALIGNMENT,
    "gyro_g_sensitivity": TermSpecification(
        GSensitivity,
        idle={"gain": IDLE_VECTOR},
        example={"gain": [1e-3, -8e-4, 1.2e-3]},
        units={"gain": "rad/s/(m/s^2)"},
    ),
    "accel_bias": TermSpecification(
        Bias,
        idle={"bias": IDLE_VECTOR},
        example={"bias": [0.2, -0.1, 0.3]},
        effects=(
            Effect(
                id="accel_bias",
                layer="imu",
                parameters=vector_parameters("bias", "m/s^2", "accel_bias", step=0.02, bounds=(-5.0, 5.0)),
                equation="f_m = f + b",
                sentence="the accelerometer is off by {values} m/s^2",
                manoeuvre="rolls and pitches to 60 degrees",
                channels=IMU_CHANNELS,
            ),
        ),
    ),
    "accel_scale": TermSpecification(
        Scale,
        idle={"scale": IDLE_VECTOR},
        example={"scale": [0.01, -0.02, 0.015]},
        effects=(
            Effect(
                id="accel_scale",
                layer="imu",
                parameters=vector_parameters("scale", "", "accel_scale", step=1e-3, bounds=(-0.3, 0.3)),
                equation="f_m = (1 + s) f",
                sentence="the accelerometer reads {values} (shares) too much",
                manoeuvre="rolls and pitches to 60 degrees",
                channels=IMU_CHANNELS,
            ),
        ),
    ),
    "accel_misalignment": MISALIGNMENT,
    "imu_lever_arm": TermSpecification(
        LeverArm,
        idle={"position": IDLE_VECTOR},
        example={"position": [0.02, -0.01, 0.015]},
        effects=(
            Effect(
                id="imu_lever_arm",
                layer="imu",
                parameters=vector_parameters("position", "m", "imu_lever_arm", step=1e-3, bounds=(-0.3, 0.3)),
                equation="f_m = f + omega' x r + omega x (omega x r)",
                sentence="the IMU sits {values} m from the centre of mass",
                manoeuvre="yaw spins and flips",
                channels=IMU_CHANNELS,
            ),
        ),
    ),
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


def gain_matrix(terms: dict, sensor: str) -> np.ndarray:
    """Return the gain I + S + M (3, 3) of the sensor ("gyro" or "accel")."""
    gain = np.eye(3)
    if scale := terms.get(f"{sensor}_scale"):
        gain += np.diag(scale.scale)
    if misalignment := terms.get(f"{sensor}_misalignment"):
        gain[~np.eye(3, dtype=bool)] += misalignment.cross
    return gain


def bias(terms: dict, sensor: str) -> np.ndarray:
    """Return the bias (3,) of the sensor ("gyro" or "accel")."""
    found = terms.get(f"{sensor}_bias")
    return np.array(found.bias) if found else np.zeros(3)


def at_lever_arm(specific_force_body, omega_body, alpha_body, position) -> np.ndarray:
    """Return the specific force (..., 3) m/s^2 at `position` (3,) m from the centre of mass of a rigid body."""
    position = np.broadcast_to(np.asarray(position), omega_body.shape)
    centripetal = geometry.cross(omega_body, geometry.cross(omega_body, position))
    return specific_force_body + geometry.cross(alpha_body, position) + centripetal


def specific_force_at_imu(specific_force_body, omega_body, alpha_body, terms: dict) -> np.ndarray:
    """Return the specific force (..., 3) m/s^2 at the IMU; inputs (..., 3) as in `ImuTruth`."""
    if (arm := terms.get("imu_lever_arm")) and any(arm.position):
        return at_lever_arm(specific_force_body, omega_body, alpha_body, arm.position)
    return specific_force_body


def gyro_reading(omega_body, at_imu, terms: dict) -> np.ndarray:
    """Return the gyro's reading (..., 3) rad/s without vibration, clipping and filter.

    Args:
        omega_body: (..., 3) rad/s.
        at_imu: (..., 3) m/s^2, specific force at the IMU.
        terms: coefficients by name.
    """
    read = omega_body @ gain_matrix(terms, "gyro").T + bias(terms, "gyro")
    sensitive = terms.get("gyro_g_sensitivity")
    return read + np.array(sensitive.gain) * at_imu if sensitive else read


def accelerometer_reading(at_imu, terms: dict) -> np.ndarray:
    """Return the accelerometer's reading (..., 3) m/s^2 without vibration, clipping and filter."""
    return at_imu @ gain_matrix(terms, "accel").T + bias(terms, "accel")


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
        terms: coefficients by name; those that are not in `TERMS` are ignored.
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
