"""Calibration errors of an IMU, which depend on the present motion alone: bias, scale, misalignment, lever arm.

    gyro  = (I + S_g + M_g) omega + G f_imu + b_g
    accel = (I + S_a + M_a) f_imu + b_a
    f_imu = f + omega' x r + omega x (omega x r)

b, S, M and G are as in the specifications of inertial sensors (IEEE 952, 1293), with sizes of the micro-machined
sensors on small vehicles.
"""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
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
}


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
