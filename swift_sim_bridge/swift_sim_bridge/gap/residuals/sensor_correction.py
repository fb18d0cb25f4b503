"""Measurements of a recording without the errors of its sensors, by inversion of the simulator's sensor models."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.sensors import imu_calibration
from swift_sim_bridge.sensors.clock import Moving, coasted, pose_delay
from swift_sim_bridge.sensors.motion_capture import in_tilted_world

GYRO_ITERATIONS = 4  # fixed-point iterations of the gyro's inverse: an error of 10 % shrinks to its ten-thousandth part
OF_GYRO, OF_ACCELEROMETER, OF_VIO = ("gyro_",), ("accel_", "imu_lever_arm"), ("vio_",)  # prefixes of their terms


@dataclass(frozen=True)
class CorrectedMotion:
    """Pose, velocity and gyro of a recording without the errors of their sensors.

    Attributes:
        moving: position, attitude, velocity and body rates (n, ...).
        gyro_body: (n, 3) rad/s.
    """

    moving: Moving
    gyro_body: np.ndarray


def differing(terms: dict, others: dict) -> tuple[str, ...]:
    """Return the names of the terms in which two sets of terms differ."""
    return tuple(name for name in terms | others if terms.get(name) != others.get(name))


def terms_of(instrument: tuple[str, ...], names) -> list[str]:
    """Return those names of terms that belong to an instrument.

    Args:
        instrument: prefixes of its terms: OF_GYRO, OF_ACCELEROMETER or OF_VIO.
        names: names of terms.
    """
    return [name for name in names if name.startswith(instrument)]


def correct(recording: Recording, terms: dict, gyro_body=None) -> CorrectedMotion:
    """Return the motion of a recording if its sensors have the errors of these terms.

    It is the inverse of `sensors.motion_capture.captured` and of the gyro's part of `sensors.imu_errors.distort`.

    Args:
        recording: the recording.
        terms: sensor terms.
        gyro_body: (n, 3) rad/s, the corrected gyro if it is known.
    """
    gyro = _undistorted(recording, terms) if gyro_body is None else gyro_body
    moving = _undelayed(recording, gyro, pose_delay(recording.t - recording.t[0], terms))
    if (tilt := terms.get("map_tilt")) and any(tilt.rotation):
        moving = in_tilted_world(moving, -np.array(tilt.rotation))
    p_world, q, v_world, _ = moving
    if (misalignment := terms.get("frame_misalignment")) and any(misalignment.rotation):
        turn = geometry.quaternion_from_rotation_vector(-np.array(misalignment.rotation))
        q = geometry.quaternion_multiply(q, np.broadcast_to(turn, q.shape))
    if (offset := terms.get("marker_offset")) and any(offset.position):
        position = np.broadcast_to(np.array(offset.position), gyro.shape)
        p_world = p_world - geometry.rotate(q, position)
        v_world = v_world - geometry.rotate(q, geometry.cross(gyro, position))
    return CorrectedMotion(Moving(p_world, q, v_world, gyro), gyro)


def _undelayed(recording: Recording, gyro, delay) -> Moving:
    """Return pose and velocity (n, ...) that were stamped `delay` (n,) s later, with the rates (n, 3) rad/s."""
    if not np.any(delay):
        return Moving(recording.p_world, recording.q_world_body, recording.v_world, gyro)
    t, late = recording.t, recording.t + delay
    p_world, q, v_world = np.split(recording.pose_spline(np.clip(late, t[0], t[-1])), [3, 7], axis=1)
    last = np.broadcast_to(gyro[-1], gyro.shape)
    beyond = np.maximum(late - t[-1], 0.0)[:, None]
    return coasted(Moving(p_world, geometry.normalize(q), v_world, last), beyond)._replace(omega_body=gyro)


def _undistorted(recording: Recording, terms: dict) -> np.ndarray:
    """Return the true rates (n, 3) rad/s for which a gyro with these terms measures the recorded ones."""
    measured = recording.gyro_body
    force = recording.specific_force_body if recording.has("specific_force_body") else np.zeros_like(measured)
    gyro = measured
    for _ in range(GYRO_ITERATIONS if terms_of(OF_GYRO, terms) else 0):
        gyro = measured - (imu_calibration.gyro_reading(gyro, force, terms) - gyro)
    return gyro


def accelerometer_errors(terms: dict, gyro, force, turn) -> np.ndarray:
    """Return the error of the accelerometer.

    Args:
        terms: sensor terms.
        gyro: (n, 3) rad/s.
        force: (b, n, 3) m/s^2, specific force at the centre of mass.
        turn: (b, n, 3) rad/s^2, angular acceleration.

    Returns:
        (b, n, 3) m/s^2, or (1, n, 3) where it does not depend on force and turn.
    """
    if not terms_of(OF_ACCELEROMETER, terms):
        return np.zeros((1, *gyro.shape))
    bias, gain_error = imu_calibration.bias(terms, "accel"), imu_calibration.gain_matrix(terms, "accel") - np.eye(3)
    at_imu = imu_calibration.specific_force_at_imu(force, np.broadcast_to(gyro, force.shape), turn, terms)
    if at_imu is force and not gain_error.any():
        return np.broadcast_to(bias, (1, *gyro.shape))
    return at_imu - force + at_imu @ gain_error.T + bias
