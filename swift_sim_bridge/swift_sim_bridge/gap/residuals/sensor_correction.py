"""What sensors are supposed to do wrong, taken out of a recording by the simulator's own sensors."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.clock import Moving, coasted, pose_delay
from swift_sim_bridge.sensors.motion_capture import in_tilted_world

ITERATIONS = 4  # of a gyro's inverse: an error of a tenth is out to a ten-thousandth of itself
OF_GYRO, OF_ACCELEROMETER, OF_VIO = ("gyro_",), ("accel_", "imu_lever_arm"), ("vio_",)  # how their terms begin


@dataclass(frozen=True)
class CorrectedMotion:
    """A recording without what its sensors did wrong: pose and velocity, gyro; the rest as recorded."""

    moving: Moving
    gyro_body: np.ndarray


def differing(terms: dict, others: dict) -> tuple[str, ...]:
    """Return the names of the terms in which two sets of them differ."""
    return tuple(name for name in terms | others if terms.get(name) != others.get(name))


def terms_of(instrument: tuple[str, ...], names) -> list[str]:
    """Return those names of terms that are an instrument's."""
    return [name for name in names if name.startswith(instrument)]


def correct(recording: Recording, terms: dict, gyro_body=None) -> CorrectedMotion:
    """Return what happened, if the sensors erred as `terms` say: the inverse of `sensors.motion_capture.captured` and
    of the gyro's part of `sensors.imu_errors.distort`. gyro_body (n, 3) rad/s: what this makes of the gyro, if known.
    """
    gyro = _undistorted(recording, terms) if gyro_body is None else gyro_body
    moving = _undelayed(recording, gyro, pose_delay(recording.t - recording.t[0], terms))
    if tilt := terms.get("map_tilt"):
        moving = in_tilted_world(moving, -np.array(tilt.rotation))
    p_world, q, v_world, _ = moving
    if misalignment := terms.get("frame_misalignment"):
        turn = geometry.quaternion_from_rotation_vector(-np.array(misalignment.rotation))
        q = geometry.quaternion_multiply(q, np.broadcast_to(turn, q.shape))
    if offset := terms.get("marker_offset"):
        position = np.broadcast_to(np.array(offset.position), gyro.shape)
        p_world = p_world - geometry.rotate(q, position)
        v_world = v_world - geometry.rotate(q, geometry.cross(gyro, position))
    return CorrectedMotion(Moving(p_world, q, v_world, gyro), gyro)


def _undelayed(recording: Recording, gyro, delay) -> Moving:
    """Return pose and velocity (n, ...) as they were stamped `delay` (n,) s later, beside the rates (n, 3)."""
    if not np.any(delay):
        return Moving(recording.p_world, recording.q_world_body, recording.v_world, gyro)
    t, late = recording.t, recording.t + delay
    p_world, q, v_world = np.split(recording.pose_spline(np.clip(late, t[0], t[-1])), [3, 7], axis=1)
    last = np.broadcast_to(gyro[-1], gyro.shape)
    beyond = np.maximum(late - t[-1], 0.0)[:, None]
    return coasted(Moving(p_world, geometry.normalize(q), v_world, last), beyond)._replace(omega_body=gyro)


def _undistorted(recording: Recording, terms: dict) -> np.ndarray:
    """Return the rates (n, 3) rad/s that a gyro which errs as `terms` say would have read as recorded."""
    measured = recording.gyro_body
    force = recording.specific_force_body if recording.has("specific_force_body") else np.zeros_like(measured)
    gyro = measured
    for _ in range(ITERATIONS if terms_of(OF_GYRO, terms) else 0):
        gyro = measured - (imu_errors.gyro_reading(gyro, force, terms) - gyro)
    return gyro


def accelerometer_errors(terms: dict, gyro, force, turn) -> np.ndarray:
    """Return what the accelerometer adds (b, n, 3) m/s^2 to the replayed specific force; b is one where it adds the
    same to all."""
    if not terms_of(OF_ACCELEROMETER, terms):
        return np.zeros((1, *gyro.shape))
    bias, bent = imu_errors.bias(terms, "accel"), imu_errors.sensitivity(terms, "accel") - np.eye(3)
    at_imu = imu_errors.felt(force, np.broadcast_to(gyro, force.shape), turn, terms)
    if at_imu is force and not bent.any():
        return np.broadcast_to(bias, (1, *gyro.shape))
    return at_imu - force + at_imu @ bent.T + bias
