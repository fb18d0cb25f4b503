"""Roll and pitch of a camera from the labelled gates in its image.

A vehicle knows its attitude from its IMU. A photograph does not come with one, and it need not be level: in a public
set from flights in a hall, 61 % of the gates lean by more than eight degrees. Gates are square and stand upright, so
that their corners show the direction of gravity: the roll well, the pitch hardly where a gate is seen from the front.
There the pitch stays near that of a level camera.
"""

import numpy as np
from scipy.optimize import least_squares

from swift_ros import geometry
from swift_ros.camera.model import Camera, unproject
from swift_ros.perception.gate_pose import R_SQUARE_GATE
from swift_ros.track import CORNER_SIGNS
from swift_sim_bridge.labels.labelled_images import R_WORLD_LEVEL_CAMERA, LabelledGate, LabelledImage, r_world_camera

PITCH_DEG, ROLL_DEG = 15.0, 30.0  # of cameras in flight about level, standard deviations
LABEL_SIGMA_SHARE = 0.03  # of the gate's angle: frames have wide and round inner edges, and few are exactly square
LEAST_ANGLE = 0.01  # rad; a smaller gate shows no direction
# Of a gate of side 1 that faces a level camera, about its centre; x right, y down, z forward.
CORNERS = 0.5 * CORNER_SIGNS @ R_SQUARE_GATE.T


def r_world_camera_by_gates(image: LabelledImage, camera: Camera) -> np.ndarray:
    """Return the attitude (3, 3) of an image's optical frame: the known one, else that of its gates, else level."""
    if image.q_world_camera is None:
        from_gates = r_world_camera_of_gates(image.gates, camera)
        if from_gates is not None:
            return from_gates
    return r_world_camera(image)


def r_world_camera_of_gates(gates: tuple[LabelledGate, ...], camera: Camera) -> np.ndarray | None:
    """Return the attitude (3, 3) of an optical frame at which its gates stand upright.

    The azimuth of the optical axis is that of the x axis. Gates with fewer than four labelled corners are left out.

    Args:
        gates: labelled in one image.
        camera: that took it.

    Returns:
        The attitude; None where no gate has four corners.
    """
    rays = [unproject(camera, gate.corners_px) for gate in gates if np.isfinite(gate.corners_px).all()]
    rays = [one for one in rays if np.isfinite(one).all() and _angle(one) > LEAST_ANGLE]
    if not rays:
        return None
    observed = np.array(rays)
    start = np.concatenate([[_roll(observed), 0.0], np.ravel([_start(one) for one in observed])])
    sigma = LABEL_SIGMA_SHARE * np.array([_angle(one) for one in observed])[:, None, None]

    def residuals(values):
        level = observed @ _r_level_camera(*values[:2]).T
        expected = _corners(values[2:].reshape(-1, 4))
        off = (geometry.normalize(expected) - level) / sigma
        return np.append(off, values[:2] / np.radians([ROLL_DEG, PITCH_DEG]))

    solution = least_squares(residuals, start, loss="soft_l1", f_scale=3.0)
    return R_WORLD_LEVEL_CAMERA @ _r_level_camera(*solution.x[:2])


def _r_level_camera(roll: float, pitch: float) -> np.ndarray:
    """Return the rotation (3, 3) from the optical frame to one of the same azimuth whose y axis points down."""
    about_z, about_x = (
        geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(np.array(vector)))
        for vector in ([0.0, 0.0, roll], [pitch, 0.0, 0.0])
    )
    return about_x @ about_z


def _corners(poses) -> np.ndarray:
    """Return the corners (n, 4, 3) of gates with poses (n, 4): azimuth, slope, logarithm of the distance, heading."""
    azimuth, slope, log_distance, heading = poses.T
    centre = np.exp(log_distance)[:, None] * np.stack([np.sin(azimuth), slope, np.cos(azimuth)], axis=-1)
    turned = CORNERS[:, 0] * np.cos(heading)[:, None], CORNERS[:, 0] * np.sin(heading)[:, None]
    offsets = np.stack([turned[0], np.broadcast_to(CORNERS[:, 1], turned[0].shape), turned[1]], axis=-1)
    return centre[:, None] + offsets


def _start(rays) -> list[float]:
    """Return the first guess of a gate's pose; it is turned to the side of the longer post."""
    centre = rays.mean(axis=0)
    left, right = np.linalg.norm(rays[0] - rays[3]), np.linalg.norm(rays[1] - rays[2])
    heading = 0.5 * np.sign(left - right)
    return [np.arctan2(centre[0], centre[2]), centre[1], -np.log(max(left, right)), heading]


def _angle(rays) -> float:
    """Return the longest side of a gate's rays (4, 3), rad."""
    return float(np.linalg.norm(rays - np.roll(rays, 1, axis=0), axis=-1).max())


def _roll(rays) -> float:
    """Return the turn about the optical axis that brings the posts of gates (n, 4, 3) upright on average, rad."""
    points = rays[..., :2] / np.maximum(rays[..., 2:], 0.1)
    posts = (points[:, [3, 2]] - points[:, [0, 1]]).sum(axis=(0, 1))
    return float(np.arctan2(posts[0], posts[1]))
