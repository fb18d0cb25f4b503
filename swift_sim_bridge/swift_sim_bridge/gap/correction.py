"""What sensors are supposed to do wrong, taken out of a recording by the simulator's own sensors."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from swift_ros import geometry
from swift_sim_bridge.gap.check import Recording
from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.clock import Moving, coasted, pose_delay
from swift_sim_bridge.sensors.imu_errors import ImuTruth
from swift_sim_bridge.sensors.motion_capture import turned

ITERATIONS = 4  # of a gyro's inverse: an error of a tenth is out to a ten-thousandth of itself
GYRO = ("gyro_bias", "gyro_scale", "gyro_misalignment", "gyro_g_sensitivity")


@dataclass(frozen=True)
class Corrected:
    """A recording without what its sensors did wrong: pose and velocity, gyro; the rest as recorded."""

    moving: Moving
    gyro_body: np.ndarray


def of_motion(terms: dict) -> dict:
    """Return the terms that `correct` takes out."""
    return {name: entry for name, entry in terms.items() if not name.startswith(("accel_", "imu_lever_arm", "vio_"))}


def of_gyro(terms: dict) -> dict:
    """Return those of them that are the gyro's."""
    return {name: terms[name] for name in GYRO if name in terms}


def correct(recording: Recording, terms: dict, gyro_body=None) -> Corrected:
    """Return what happened, if the sensors erred as `terms` say: the inverse of `sensors.motion_capture.captured` and
    of the gyro's part of `sensors.imu_errors.distort`. gyro_body (n, 3) rad/s: what this makes of the gyro, if known.
    """
    t, gyro = recording.t, _undistorted(recording, of_gyro(terms)) if gyro_body is None else gyro_body
    moving = Moving(recording.p_world, recording.q_world_body, recording.v_world, gyro)
    if tilt := terms.get("map_tilt"):
        moving = turned(moving, -np.array(tilt.rotation))
    p_world, q, v_world, _ = moving
    if misalignment := terms.get("frame_misalignment"):
        turn = geometry.quaternion_from_rotation_vector(-np.array(misalignment.rotation))
        q = geometry.quaternion_multiply(q, np.broadcast_to(turn, q.shape))
    if offset := terms.get("marker_offset"):
        position = np.broadcast_to(np.array(offset.position), gyro.shape)
        p_world = p_world - geometry.rotate(q, position)
        v_world = v_world - geometry.rotate(q, geometry.cross(gyro, position))
    moving = Moving(p_world, q, v_world, gyro)
    delay = pose_delay(t - t[0], terms)
    if np.any(delay):
        moving = _later(moving, t, delay)
    return Corrected(moving, gyro)


def _later(moving: Moving, t, delay) -> Moving:
    """Return pose and velocity (n, ...) as they were stamped `delay` (n,) s later, beside the same rates.

    By splines: a mean of neighbours is calmer than either, by which a delay would be the better the farther between
    samples it falls.
    """
    flips = np.cumsum(np.sum(moving.q_world_body[1:] * moving.q_world_body[:-1], axis=1, keepdims=True) < 0, axis=0)
    q = moving.q_world_body * np.concatenate([[[1.0]], np.where(flips % 2, -1.0, 1.0)])
    at = np.clip(t + delay, t[0], t[-1])
    p_world, q, v_world = (CubicSpline(t, values)(at) for values in (moving.p_world, q, moving.v_world))
    last = np.broadcast_to(moving.omega_body[-1], moving.omega_body.shape)
    beyond = np.maximum(t + delay - t[-1], 0.0)[:, None]
    return coasted(Moving(p_world, geometry.normalize(q), v_world, last), beyond)._replace(omega_body=moving.omega_body)


def _undistorted(recording: Recording, terms: dict) -> np.ndarray:
    """Return the rates (n, 3) rad/s that a gyro which errs as `terms` say would have read as recorded."""
    measured, still = recording.gyro_body, np.zeros_like(recording.gyro_body)
    force = recording.specific_force_body if recording.has("specific_force_body") else still
    gyro = measured
    for _ in range(ITERATIONS if terms else 0):
        truth = ImuTruth(recording.dt, gyro, still, force, still[:, :1])
        gyro = measured - (imu_errors.distort(truth, terms, None)[0] - gyro)
    return gyro


def accelerometer_errors(recording: Recording, terms: dict, gyro, force, turn) -> np.ndarray:
    """Return what the accelerometer adds (b, n, 3) to the replayed specific force."""
    own = {name: entry for name, entry in terms.items()
           if name.startswith("accel_") or name == "imu_lever_arm"}
    if not own:
        return np.zeros((1, *gyro.shape))
    speed = np.zeros((len(gyro), 1))
    return np.stack([
        imu_errors.distort(ImuTruth(recording.dt, gyro, alpha, truth, speed), own, None)[1] - truth
        for truth, alpha in zip(force, turn, strict=True)
    ])  # fmt: skip
