"""Which corners of a composite a detector must find."""

import numpy as np

from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector.corner_states import BORDER_PX, HIDDEN, IGNORED, VISIBLE

RING = np.array([(0.0, 0.0), *((np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4)])
OPAQUE = 0.5  # opacity from which a panel hides
CONTRAST_PLACES = np.linspace(0.06, 0.4, 8)  # along an edge from its corner, in lengths of the edge
LEAST_CHANGE = 0.1  # of the brightness by a frame below which a person does not see it
CONTRAST_PX = 1.4  # from the edge to each side, where frame and opening are compared


def covered(view, corners, panels) -> np.ndarray:
    """Return the states (n, 4) of corners (n, 4, 3) m of the world behind panels."""
    pixels, _ = view.project(corners)
    rays = view.directions(pixels[..., None, :] + BORDER_PX * RING)
    hit = np.zeros(rays.shape[:-1], bool)
    for panel in panels:
        hit |= panel.opacity(rays) > OPAQUE
    return np.where(hit.all(axis=-1), HIDDEN, np.where(hit.any(axis=-1), IGNORED, VISIBLE))


def together(one, other) -> np.ndarray:
    """Return the states of corners that have two: what hides a corner hides it from all."""
    return np.where((one == HIDDEN) | (other == HIDDEN), HIDDEN, np.where(one == VISIBLE, other, one))


def bordered(camera, pixels, theta, state) -> np.ndarray:
    """Return states (n, 4) of corners at pixels (n, 4, 2) and angles, with those outside of the image hidden."""
    border = BORDER_PX / camera.fx
    within = np.minimum((camera.half_angle - theta) / border, lens.inside_px(camera, pixels) / BORDER_PX)
    state = np.where((np.abs(within) < 1.0) & (state == VISIBLE), IGNORED, state)
    return np.where(within < -1.0, HIDDEN, state)


def beside_edges(view, corners):
    """Return pixels (2, n, 4, 2, k, 2) in the opening and on the frame, beside the two edges that meet in each corner.

    Args:
        view: of the image.
        corners: (n, 4, 3) m, in the world.
    """
    neighbours = np.stack([np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)], axis=2)
    towards = neighbours - corners[:, :, None]
    inwards = towards[:, :, ::-1] / np.linalg.norm(towards[:, :, ::-1], axis=-1, keepdims=True)
    metres = CONTRAST_PX / view.focal_px * np.linalg.norm(corners, axis=-1)[..., None, None, None]
    along = corners[:, :, None, None] + CONTRAST_PLACES[:, None] * towards[..., None, :]
    offset = metres * inwards[..., None, :]
    return np.stack([view.project(along + sign * offset)[0] for sign in (1, -1)])


def contrasts(levels, beside) -> np.ndarray:
    """Return the contrasts (n, 4) between frame and opening near corners, of the weaker edge, grey levels.

    Args:
        levels: (H, W) float32.
        beside: see `beside_edges`.
    """
    opening, frame = levels_at(levels, beside)
    return np.abs(opening - frame).mean(axis=-1).min(axis=-1, initial=np.inf)


def changes(before, after) -> np.ndarray:
    """Return by how much a frame differs from what it covers (n, 4), of the weaker edge, in mean brightnesses.

    Args:
        before, after: (n, 4, 2, k), brightness at places of the frame before and after it is painted.
    """
    mean = 0.5 * (np.abs(before).mean(axis=-1) + np.abs(after).mean(axis=-1))
    return (np.abs(after - before).mean(axis=-1) / np.maximum(mean, 1e-4)).min(axis=-1)


def levels_at(levels, pixels):
    """Return the values (...) of an image (H, W) at the pixels nearest to pixels (..., 2)."""
    height, width = levels.shape
    x, y = np.moveaxis(np.clip(np.rint(pixels), 0, (width - 1, height - 1)).astype(int), -1, 0)
    return levels[y, x]
