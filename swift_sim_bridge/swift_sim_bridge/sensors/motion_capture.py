"""Motion capture: the pose of a body of markers, which is neither where the centre of mass is nor turned as the IMU."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.types import Odometry
from swift_sim_bridge.sensors.clock import Delay, Drift, History, Moving, pose_delay


@dataclass(frozen=True)
class MarkerOffset:
    """`marker_offset`: position (3,) of the markers' origin from the centre of mass, body frame, m, 0.002 to 0.04."""

    position: tuple[float, float, float]


@dataclass(frozen=True)
class FrameMisalignment:
    """`frame_misalignment`: rotation vector (3,) rad that turns the body frame into the markers', 0.003 to 0.035."""

    rotation: tuple[float, float, float]


@dataclass(frozen=True)
class MapTilt:
    """`map_tilt`: rotation (2,) rad about x and y that turns the level world into the one of the pose, whose floor was
    not level when it was set up, 0.002 to 0.02."""

    rotation: tuple[float, float]


TERMS = {
    "marker_offset": MarkerOffset,
    "frame_misalignment": FrameMisalignment,
    "map_tilt": MapTilt,
    "time_offset": Delay,
    "clock_drift": Drift,
}


def captured(moving: Moving, terms: dict) -> Moving:
    """Return the markers' own motion (world, and their frame for the rates): p + R r, R dR, the world turned."""
    p_world, q_world_body, v_world, omega_body = moving
    if offset := terms.get("marker_offset"):
        position = np.broadcast_to(np.array(offset.position), omega_body.shape)
        p_world = p_world + geometry.rotate(q_world_body, position)
        v_world = v_world + geometry.rotate(q_world_body, geometry.cross(omega_body, position))
    if misalignment := terms.get("frame_misalignment"):
        turn = geometry.quaternion_from_rotation_vector(np.array(misalignment.rotation))
        q_world_body = geometry.quaternion_multiply(q_world_body, np.broadcast_to(turn, q_world_body.shape))
        omega_body = geometry.rotate_inverse(np.broadcast_to(turn, q_world_body.shape), omega_body)
    moving = Moving(p_world, q_world_body, v_world, omega_body)
    return turned(moving, tilt.rotation) if (tilt := terms.get("map_tilt")) else moving


def turned(moving: Moving, rotation) -> Moving:
    """Return a motion as a world sees it that is turned by `rotation` (2,) rad about x and y."""
    turn = geometry.quaternion_from_rotation_vector(np.array([*rotation, 0.0]))
    turn = np.broadcast_to(turn, moving.q_world_body.shape)
    return moving._replace(
        p_world=geometry.rotate(turn, moving.p_world),
        v_world=geometry.rotate(turn, moving.v_world),
        q_world_body=geometry.quaternion_multiply(turn, moving.q_world_body),
    )


def with_noise(moving: Moving, position_m: float, attitude_rad: float, rng) -> Moving:
    """Return the pose with white noise of these standard deviations an axis, drawn for each sample."""
    shape = moving.p_world.shape
    p_world = moving.p_world + position_m * rng.standard_normal(shape)
    turn = geometry.quaternion_from_rotation_vector(attitude_rad * rng.standard_normal(shape))
    return moving._replace(p_world=p_world, q_world_body=geometry.quaternion_multiply(moving.q_world_body, turn))


def odometry(stamp_ns: int, moving: Moving) -> Odometry:
    """Return one moving body as a stamped record, its twist in its own frame."""
    v_body = geometry.rotate_inverse(moving.q_world_body, moving.v_world)
    return Odometry(stamp_ns, moving.p_world, moving.q_world_body, v_body, moving.omega_body)


class MotionCapture:
    """terms: the vehicle's sensor terms; noise: the vehicle's noise sheet (`position_m`, `attitude_rad` count)."""

    def __init__(self, terms: dict, noise: dict, rng):
        self._terms = {name: entry for name, entry in terms.items() if name in TERMS}
        self._noise = (noise.get("position_m", 0.0), noise.get("attitude_rad", 0.0))
        self._rng = rng
        self._exact = not self._terms and not any(self._noise)

    def measure(self, truth: Odometry, t: float, history: History) -> Odometry:
        """Return what is measured t s after the start, when `truth` holds and stands last in `history`."""
        if self._exact:
            return truth
        moving = captured(history.before(float(pose_delay(t, self._terms))), self._terms)
        return odometry(truth.stamp_ns, with_noise(moving, *self._noise, self._rng))
