"""Which corners of a composite a detector must find."""

import numpy as np

from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector.corner_states import BORDER_PX, HIDDEN, IGNORED, VISIBLE

RING = np.array([(0.0, 0.0), *((np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4)])
OPAQUE = 0.5  # opacity from which a panel hides
CONTRAST_PLACES = np.linspace(0.06, 0.4, 8)  # along an edge from its corner, in lengths of the edge
CONTRAST_PX = 2.0  # from the edge to each side, where frame and opening are compared


def covered(view, corners, panels) -> np.ndarray:
    """Return the states (n, 4) of corners (n, 4, 3) m of the world behind panels."""
    pixels, _ = view.project(corners)
    rays = view.directions(pixels[..., None, :] + BORDER_PX * RING)
    hit = np.zeros(rays.shape[:-1], bool)
    for panel in panels:
        hit |= panel.opacity(rays) > OPAQUE
    return np.where(hit.all(axis=-1), HIDDEN, np.where(hit.any(axis=-1), IGNORED, VISIBLE))


def bordered(camera, pixels, theta, state) -> np.ndarray:
    """Return states (n, 4) of corners at pixels (n, 4, 2) and angles, with those outside of the image hidden."""
    border = BORDER_PX / camera.fx
    within = np.minimum((camera.half_angle - theta) / border, lens.inside_px(camera, pixels) / BORDER_PX)
    state = np.where((np.abs(within) < 1.0) & (state == VISIBLE), IGNORED, state)
    return np.where(within < -1.0, HIDDEN, state)


def contrasts(view, levels, corners, shift) -> np.ndarray:
    """Return the contrasts (n, 4) between frame and opening near corners (n, 4, 3), grey levels.

    It is the smaller one of the two edges that meet in the corner.

    Args:
        view: of the image.
        levels: (H, W) float32, the image without noise.
        corners: m, in the world.
        shift: (n, 4, 2) px, from the corners' places by the view to those in the image.
    """
    if not len(corners):
        return np.zeros((0, 4))
    found = []
    for k in range(4):
        sides = []
        for other in ((k + 1) % 4, (k - 1) % 4):
            towards = corners[:, other] - corners[:, k]
            inwards = corners[:, (k - 1 if other == (k + 1) % 4 else k + 1) % 4] - corners[:, k]
            inwards = inwards / np.linalg.norm(inwards, axis=-1, keepdims=True)
            offset = CONTRAST_PX / view.focal_px * np.linalg.norm(corners[:, k], axis=-1)[:, None] * inwards
            along = corners[:, k, None] + CONTRAST_PLACES[:, None] * towards[:, None]
            inside, outside = (
                _levels_at(levels, view.project(along + sign * offset[:, None])[0] + shift[:, k, None])
                for sign in (1, -1)
            )
            sides.append(np.abs(inside - outside).mean(axis=-1))
        found.append(np.minimum(*sides))
    return np.stack(found, axis=-1)


def _levels_at(levels, pixels):
    """Return the grey levels (...) of the nearest pixels."""
    height, width = levels.shape
    x, y = np.moveaxis(np.clip(np.rint(pixels), 0, (width - 1, height - 1)).astype(int), -1, 0)
    return levels[y, x]
