"""The camera that follows the vehicle: behind it along its smoothed direction of flight, with a level horizon."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from swift_ros import geometry
from swift_sim_bridge.video.flight import Path3

STEP_S = 0.01  # s between the poses that are smoothed
# Standard deviations of the smoothing, s. The heading turns by half a circle within a second on the shipped track; the
# camera lags less than the heading, so that the vehicle stays in the picture.
HEADING_S, CAMERA_S, TARGET_S = 0.35, 0.20, 0.05
BEHIND_M, ABOVE_M = 2.1, 0.75  # of the camera, from the vehicle
AIM_ABOVE_M = 0.20  # the vehicle stands a little below the centre of the picture
NOSE_M_S = 2.0  # m/s; well below this speed the nose gives the heading, well above the velocity
WALL_M = 0.4  # m, that the camera keeps from walls, floor and ceiling


@dataclass(frozen=True)
class Cameras:
    """Poses of the chase camera.

    Attributes:
        p_world: optical centres (m, 3), m.
        rotations: R_world_camera (m, 3, 3) of the optical frames.
    """

    p_world: np.ndarray
    rotations: np.ndarray


def follow(path: Path3, times, room_low, room_high) -> Cameras:
    """Return the poses of the chase camera at times (m,) s, inside of a room with corners (3,) m."""
    count = int((path.t[-1] - path.t[0]) / STEP_S) + 2
    even = path.at(path.t[0] + STEP_S * np.arange(count))
    heading = gaussian_filter1d(_headings(even), HEADING_S / STEP_S, mode="nearest")
    centre, aim = (gaussian_filter1d(even.p_world, s / STEP_S, axis=0, mode="nearest") for s in (CAMERA_S, TARGET_S))
    behind = np.stack([np.cos(heading), np.sin(heading), np.zeros(count)], axis=-1)
    p = centre - BEHIND_M * behind + [0.0, 0.0, ABOVE_M]
    p, aim = (np.stack([np.interp(times, even.t, rows[:, i]) for i in range(3)], axis=-1) for rows in (p, aim))
    p = np.clip(p, np.asarray(room_low) + WALL_M, np.asarray(room_high) - WALL_M)
    return Cameras(p, looking(aim + [0.0, 0.0, AIM_ABOVE_M] - p))


def _headings(path: Path3) -> np.ndarray:
    """Return the direction of flight over the ground (n,) rad, without jumps; that of the nose at low speed."""
    yaw = geometry.yaw_of(path.q_world_body)
    ahead = path.v_world[:, :2] + NOSE_M_S * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))


def looking(direction) -> np.ndarray:
    """Return R_world_camera (m, 3, 3) of optical frames that look along directions (m, 3), with a level horizon."""
    forward = geometry.normalize(direction)
    right = geometry.normalize(np.cross(forward, [0.0, 0.0, 1.0]))
    return np.stack([right, np.cross(forward, right), forward], axis=-1)
