"""Residuals of the rays to a gate's corners for a pose of the vehicle, and their derivatives."""

import numpy as np

from swift_ros import geometry

# Order of the corners of a gate seen from behind, where left and right are exchanged.
ORDER_FROM_BEHIND = np.array([1, 0, 3, 2])
X_CROSS, Z_CROSS = geometry.skew(np.eye(3)[[0, 2]])  # matrices of the cross products of the axes with a vector
MIN_COSINE = 0.5  # of the angle between an observed and an expected ray (60 degrees); beyond, they are not compared
MIN_DISTANCE = 0.05  # m; smallest distance of a corner from the camera in the derivatives, which are inverse to it


def ray_residuals(rays_body, corners, position, rotation, p_body_camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare observed rays with those expected from a pose.

    A residual is the observed minus the expected ray, in the plane normal to the observed ray. A corner that was not
    seen has residuals and derivatives of zero.

    Args:
        rays_body: observed unit rays (..., 4, 3), NaN for a corner that was not seen.
        corners: associated corners (..., 4, 3) in the world frame, m.
        position: of the body (..., 3) in the world frame, m.
        rotation: of the body (..., 3, 3), body to world.
        p_body_camera: optical centre (3,) in the body frame, m.

    Returns:
        Residuals (..., 4, 2), rad; derivatives (..., 4, 2, 6) of the expected rays with respect to position and
        rotation of the body, both along world axes; mask (...), False where a corner is 60 degrees or more off.
    """
    unseen = np.isnan(rays_body[..., 0])
    arm = corners - position[..., None, :]
    sight = arm - (rotation @ p_body_camera)[..., None, :]
    residuals, slopes, ahead = axes_residuals(ray_axes(rays_body), rotation, arm, sight)
    residuals = np.where(unseen[..., None], 0.0, residuals)
    return residuals, np.where(unseen[..., None, None], 0.0, slopes), (ahead | unseen).all(axis=-1)


def axes_residuals(axes_body, rotation, arm, sight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals and derivatives as `ray_residuals` does, without its treatment of corners that were not seen.

    Args:
        axes_body: `ray_axes` (..., 4, 3, 3) of the observed rays, which are the same at every pose.
        rotation: of the body (..., 3, 3), body to world.
        arm: corners (..., 4, 3) from the body's origin along world axes, m.
        sight: corners (..., 4, 3) from the optical centre along world axes, m.

    Returns:
        Residuals (..., 4, 2), rad; derivatives (..., 4, 2, 6); mask (..., 4), False of a corner 60 degrees or more off.
    """
    rows = axes_body.reshape(*axes_body.shape[:-3], 12, 3) @ np.swapaxes(rotation, -1, -2)  # of all corners at once
    axes = rows.reshape(*rows.shape[:-2], 4, 3, 3)
    distance = np.maximum(np.sqrt(np.vecdot(sight, sight)), MIN_DISTANCE)[..., None]
    expected = sight / distance
    components = np.matvec(axes, expected)
    offset, along = components[..., :2], components[..., 2]
    ahead = along > MIN_COSINE
    residuals = -offset / np.where(ahead, along, 1.0)[..., None]
    slopes = (offset[..., None] * expected[..., None, :] - axes[..., :2, :]) / distance[..., None]
    return residuals, np.concatenate([slopes, slopes @ geometry.skew(-arm)], axis=-1), ahead


def ray_axes(rays) -> np.ndarray:
    """Return orthogonal unit vectors (..., 3, 3), as rows, for each unit ray (..., 3); the last one is the ray."""
    first = geometry.normalize(np.where(np.abs(rays[..., 2:]) < 0.9, rays @ Z_CROSS.T, rays @ X_CROSS.T))
    return np.stack([first, geometry.cross(rays, first), rays], axis=-2)


def plane_normal_to(rays) -> np.ndarray:
    """Return two unit vectors (..., 2, 3) that are orthogonal to each unit ray (..., 3) and to one another."""
    return ray_axes(rays)[..., :2, :]


def corner_sigma_rad(rays_body, sigma_deg, sigma_share: float) -> np.ndarray:
    """Return the standard deviations (...) of the corners of gates, rad.

    Args:
        rays_body: unit rays (..., 4, 3) to the corners, NaN for one that was not seen.
        sigma_deg: constant part, of all gates or of each (...), degrees.
        sigma_share: part proportional to the angle of the gate's diagonal.
    """
    diagonal = np.linalg.norm(rays_body[..., :2, :] - rays_body[..., 2:, :], axis=-1).mean(axis=-1)
    sides = np.linalg.norm(rays_body - rays_body[..., [3, 0, 1, 2], :], axis=-1)
    # of an incomplete gate, as if it were seen from the front
    diagonal = np.where(np.isnan(diagonal), np.sqrt(2.0) * np.fmax.reduce(sides, axis=-1), diagonal)
    return np.hypot(np.radians(sigma_deg), sigma_share * diagonal)
