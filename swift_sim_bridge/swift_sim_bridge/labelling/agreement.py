"""Checks of projected gates against the image: what the detector finds, and where the edges are."""

import numpy as np

from swift_ros.camera import model as lens
from swift_sim_bridge.labels.labelled_images import VISIBLE, LabelledGate

NEAR_PX, NEAR_SHARE = 2.5, 0.04  # px, and share of the gate's side: largest error of a label that is kept
SEARCH = 4.0  # times the tolerance: distance from a projected edge within which edges are looked for
LEAST_CORNERS = 2  # of a gate that the detector must find: with one, a gate elsewhere could be taken for it
SAMPLES = 24  # along an edge
ENDS = 0.15  # share of an edge at each end that is not used: there the other edges are
LEAST_STEP = 4.0  # grey levels: a weaker mean step is not an edge, three times the noise of the mean
STRONG = 0.9  # share of the strongest step nearby: the opening's edge is about as strong as the outer one


def tolerance_px(gate: LabelledGate) -> float:
    """Return the distance (px) within which a corner or an edge of a gate agrees."""
    return max(NEAR_PX, NEAR_SHARE * gate.side_px)


def compared_with_corners(gate: LabelledGate, corners) -> bool | None:
    """Return whether detected corners in sight of a gate's are near them; None with fewer than two in sight.

    Args:
        gate: as projected.
        corners: of the detector, (points (n, 2), confidence (n,)) for TL, TR, BR, BL.
    """
    near = tolerance_px(gate)
    visible = np.nonzero(gate.visibility == VISIBLE)[0]
    off = np.array([np.linalg.norm(corners[k][0] - gate.corners_px[k], axis=-1).min(initial=np.inf) for k in visible])
    in_sight = off <= SEARCH * near
    return bool((off[in_sight] <= near).all()) if in_sight.sum() >= LEAST_CORNERS else None


def agrees_with_edges(gate: LabelledGate, pixels, camera) -> bool:
    """Return whether the image has edges where those of a whole gate are projected."""
    near = tolerance_px(gate)
    for k in range(4):
        steps, offsets = _steps_across(gate.corners_px[[k, (k + 1) % 4]], pixels, camera, SEARCH * near)
        here = steps[np.abs(offsets) <= near].max(initial=0.0)
        if here < LEAST_STEP or here < STRONG * steps.max(initial=0.0):
            return False
    return True


def _steps_across(ends, pixels, camera, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean steps of grey level (n,) across an edge (2, 2) px, and their offsets (n,) px to its right."""
    rays = lens.unproject(camera, ends)
    share = np.linspace(ENDS, 1.0 - ENDS, SAMPLES)[:, None]
    points = lens.project(camera, rays[0] + share * (rays[1] - rays[0]))[0]  # bowed as the lens bows it
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    offsets = np.arange(-np.ceil(reach), np.ceil(reach) + 1)
    at = np.rint(points[:, None] + offsets[:, None] * across[:, None]).astype(int)
    inside = ((at >= 0) & (at < (pixels.shape[1], pixels.shape[0]))).all(axis=(1, 2))
    if inside.sum() < SAMPLES // 2:
        return np.zeros(0), np.zeros(0)
    grey = pixels[at[inside, :, 1], at[inside, :, 0]].astype(float).mean(axis=0)
    return np.abs(grey[2:] - grey[:-2]), offsets[1:-1]
