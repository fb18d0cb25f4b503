"""How far the rays to a gate's corners lie from where a pose puts them, and how they move with the pose."""

import numpy as np

from swift_ros import geometry

# A gate seen from behind: its left is the viewer's right. Order along the passage <-> order as seen.
ORDER_FROM_BEHIND = np.array([1, 0, 3, 2])
AHEAD = 0.5  # cosine of the largest angle between a seen and an expected ray


def ray_residuals(rays_body, corners, position, rotation, p_body_camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (residuals (..., 4, 2) rad, slopes (..., 4, 2, 6), ahead (...)) of seen rays against expected ones.

    rays_body (..., 4, 3): unit rays seen; corners (..., 4, 3) m: what they are taken for, in the frame of `position`
    (..., 3) and `rotation` (..., 3, 3), the body's pose; p_body_camera (3,) m. A residual is seen minus expected in
    the plane across the seen ray; `slopes` is how the expected one moves with an error of the position and with a turn
    of the body, both along the axes of that frame. `ahead` is false where a corner is 60 degrees or more off.
    """
    arm = corners - position[..., None, :]
    arm_camera = arm @ rotation - p_body_camera
    distance = np.maximum(np.linalg.norm(arm_camera, axis=-1, keepdims=True), 0.05)
    expected = arm_camera / distance
    across = _plane_across(rays_body)
    along = np.sum(expected * rays_body, axis=-1)
    ahead = along > AHEAD
    offset = (across @ expected[..., None])[..., 0]
    residuals = -offset / np.where(ahead, along, 1.0)[..., None]
    squeeze = (across - offset[..., None] * expected[..., None, :]) / distance[..., None]
    to_frame = squeeze @ np.swapaxes(rotation, -1, -2)[..., None, :, :]
    return residuals, np.concatenate([-to_frame, to_frame @ geometry.skew(arm)], axis=-1), ahead.all(axis=-1)


def _plane_across(rays) -> np.ndarray:
    """Return two unit vectors (..., 2, 3) that with each unit ray (..., 3) make an orthogonal triple."""
    helper = np.where(np.abs(rays[..., 2:]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    first = geometry.normalize(geometry.cross(helper, rays))
    return np.stack([first, geometry.cross(rays, first)], axis=-2)


def corner_sigma_rad(rays_body, sigma_px: float, sigma_share: float, focal_px: float) -> np.ndarray:
    """Return the standard deviation (...) in rad of the corners of gates seen by rays (..., 4, 3): a part in pixels and
    a part that grows with the gate's apparent diagonal."""
    diagonals = [np.linalg.norm(rays_body[..., i, :] - rays_body[..., i + 2, :], axis=-1) for i in (0, 1)]
    return np.hypot(sigma_px / focal_px, 0.5 * sigma_share * (diagonals[0] + diagonals[1]))
