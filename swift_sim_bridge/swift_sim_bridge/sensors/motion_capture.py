"""Motion capture: the pose of a body of markers, displaced from the centre of mass and rotated against the IMU."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.types import Odometry
from swift_sim_bridge.effects import (
    IMU_CHANNELS,
    MOTION_CHANNELS,
    Effect,
    TermSpecification,
    scalar_parameter,
    vector_parameters,
)
from swift_sim_bridge.sensors.clock import Delay, Drift, History, Moving, pose_delay


@dataclass(frozen=True)
class MarkerOffset:
    """Offset of the markers.

    Attributes:
        position: (3,) m of the markers' origin from the centre of mass, body frame, 0.002 to 0.04.
    """

    position: tuple[float, float, float]


@dataclass(frozen=True)
class FrameMisalignment:
    """Rotation of the markers' frame.

    Attributes:
        rotation: rotation vector (3,) rad from the body frame to the markers' frame, 0.003 to 0.035.
    """

    rotation: tuple[float, float, float]


@dataclass(frozen=True)
class MapTilt:
    """Tilt of the motion capture's world, whose floor was not level at its calibration.

    Attributes:
        rotation: (2,) rad about x and y from the level world to the world of the pose, 0.002 to 0.02.
    """

    rotation: tuple[float, float]


TERMS = {
    "marker_offset": TermSpecification(
        MarkerOffset,
        idle={"position": [0.0, 0.0, 0.0]},
        example={"position": [0.03, -0.01, 0.02]},
        effects=(
            Effect(
                id="marker_offset",
                layer="imu",
                parameters=vector_parameters("position", "m", "marker_offset", step=2e-3, bounds=(-0.3, 0.3)),
                equation="p_m = p + R r",
                sentence="the markers' origin is {values} m from the centre of mass",
                manoeuvre="fast rolls, pitches and yaws",
                channels=IMU_CHANNELS,
            ),
        ),
    ),
    "frame_misalignment": TermSpecification(
        FrameMisalignment,
        idle={"rotation": [0.0, 0.0, 0.0]},
        example={"rotation": [0.02, -0.01, 0.03]},
        effects=(
            Effect(
                id="frame_misalignment",
                layer="imu",
                parameters=vector_parameters("rotation", "rad", "frame_misalignment", step=1e-3, bounds=(-0.5, 0.5)),
                equation="R_m = R dR",
                sentence="the markers' frame is turned by {values} rad against the IMU's",
                manoeuvre="all attitudes, slowly",
                channels=IMU_CHANNELS,
            ),
        ),
    ),
    "map_tilt": TermSpecification(
        MapTilt,
        idle={"rotation": [0.0, 0.0]},
        example={"rotation": [0.01, -0.015]},
        effects=(
            Effect(
                id="map_tilt",
                layer="imu",
                parameters=vector_parameters("rotation", "rad", "map_tilt", step=1e-3, bounds=(-0.2, 0.2), count=2),
                equation="p_m = R_t p, R_m = R_t R",
                sentence="the pose's world is turned by {values} rad about x and y: it is not level",
                manoeuvre="turn by 180 degrees in hover: a bias turns as well, the world does not",
                channels=IMU_CHANNELS,
            ),
        ),
    ),
    "time_offset": TermSpecification(
        Delay,
        idle={"delay": 0.0},
        example={"delay": 0.012},
        effects=(
            Effect(
                id="time_offset",
                layer="imu",
                parameters=(scalar_parameter("delay", "s", "time_offset", step=5e-4, low=-0.3, high=0.3),),
                equation="pose(t) = truth(t - d)",
                sentence="the pose is {delay:~.4g} s {delay:late|early} against the IMU",
                manoeuvre="fast yaw to and fro",
                channels=MOTION_CHANNELS,
                retimes=True,
            ),
        ),
    ),
    "clock_drift": TermSpecification(
        Drift,
        idle={"ppm": 0.0},
        example={"ppm": 80.0},
        effects=(
            Effect(
                id="clock_drift",
                layer="imu",
                parameters=(scalar_parameter("ppm", "ppm", "clock_drift", step=20.0, low=-5e3, high=5e3),),
                equation="pose(t) = truth(t - e t)",
                sentence="the pose's clock runs {ppm:~.3g} ppm {ppm:fast|slow}",
                manoeuvre="a long flight",
                channels=MOTION_CHANNELS,
                retimes=True,
            ),
        ),
    ),
}


def captured(moving: Moving, terms: dict) -> Moving:
    """Return the motion of the markers: position p + R r, attitude R dR, rates in their frame, in the tilted world."""
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
    return in_tilted_world(moving, tilt.rotation) if (tilt := terms.get("map_tilt")) else moving


def in_tilted_world(moving: Moving, rotation) -> Moving:
    """Return a motion in a world that is rotated by `rotation` (2,) rad about x and y."""
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
    """Return the motion as stamped odometry, the twist in the body frame."""
    v_body = geometry.rotate_inverse(moving.q_world_body, moving.v_world)
    return Odometry(stamp_ns, moving.p_world, moving.q_world_body, v_body, moving.omega_body)


class MotionCapture:
    """Motion capture with the errors of a vehicle file.

    Args:
        terms: the vehicle's sensor terms, of which those of `TERMS` are used.
        noise: the vehicle's noise sheet, of which `position_m` and `attitude_rad` are used.
        rng: draws the noise.
    """

    def __init__(self, terms: dict, noise: dict, rng):
        self._terms = {name: entry for name, entry in terms.items() if name in TERMS}
        self._noise = (noise.get("position_m", 0.0), noise.get("attitude_rad", 0.0))
        self._rng = rng
        self._exact = not self._terms and not any(self._noise)

    def measure(self, truth: Odometry, t: float, history: History) -> Odometry:
        """Return the measurement t s after the start, when `truth` is the true motion and the newest of `history`."""
        if self._exact:
            return truth
        moving = captured(history.before(float(pose_delay(t, self._terms))), self._terms)
        return odometry(truth.stamp_ns, with_noise(moving, *self._noise, self._rng))
