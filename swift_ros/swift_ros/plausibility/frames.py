"""Where the frames of gates are: four bars around an opening, as boxes in the map. No ROS.

A frame may be pitched and rolled and has sizes of its own. Two boxes are apart when some axis separates them
(Gottschalk et al. 1996): the normals of both, or the cross products of their edges.
"""

import itertools
from typing import NamedTuple

import numpy as np

ONE, BLOCKED, STRUCK, FREE = "one", "blocked", "struck", "free"
TOLERANCE_M = 0.01  # m; gates may touch
SAME_M, SAME_COSINE = 0.1, 0.999  # two entries of a file that differ by less are one gate, flown twice
SHARED_M, SHARED_COSINE = 0.05, 0.999  # two bars whose middle lines are nearer than this, and parallel, are one post


class Box(NamedTuple):
    """A box.

    Attributes:
        centre: (3,) m.
        axes: (3, 3), columns are the directions of the edges.
        half: (3,) m, half lengths of the edges.
    """

    centre: np.ndarray
    axes: np.ndarray
    half: np.ndarray


def bars(track, gate: int) -> list[Box]:
    """Return the four bars of a gate's frame: left, right, top, bottom as seen before the passage."""
    inner, outer = 0.5 * track.inner_sides[gate], 0.5 * track.outer_sides[gate]
    middle, thick = 0.5 * (inner + outer), 0.5 * (outer - inner)
    upright, level = np.array([track.half_depth, thick, outer]), np.array([track.half_depth, outer, thick])
    parts = (([0, middle, 0], upright), ([0, -middle, 0], upright), ([0, 0, middle], level), ([0, 0, -middle], level))
    rotation = track.rotations[gate]
    return [Box(track.positions[gate] + rotation @ np.array(place), rotation, half) for place, half in parts]


def opening(track, gate: int) -> Box:
    """Return the box within a gate's frame."""
    inner = 0.5 * track.inner_sides[gate]
    return Box(track.positions[gate], track.rotations[gate], np.array([track.half_depth, inner, inner]))


def corners(track, gate: int, lowest_bar: bool = True) -> np.ndarray:
    """Return the corners (8, 3) m of the box around a gate's frame; without its lowest bar, down to the opening."""
    inner, outer = 0.5 * track.inner_sides[gate], 0.5 * track.outer_sides[gate]
    high = np.array([track.half_depth, outer, outer])
    low = -high
    upwards = track.rotations[gate][2]  # height of the axes of the gate
    if not lowest_bar:
        axis = 1 + int(np.argmax(np.abs(upwards[1:])))
        low[axis], high[axis] = (-inner, outer) if upwards[axis] > 0 else (-outer, inner)
    return (
        track.positions[gate]
        + np.array(list(itertools.product(*zip(low, high, strict=True)))) @ track.rotations[gate].T
    )


def distance(track, gate: int, point: np.ndarray) -> float:
    """Return the distance in m of a point (3,) from a gate's frame; 0 within it."""
    return min(_distance(bar, point) for bar in bars(track, gate))


def _distance(box: Box, point: np.ndarray) -> float:
    beyond = np.maximum(np.abs(box.axes.T @ (point - box.centre)) - box.half, 0.0)
    return float(np.linalg.norm(beyond))


def collision(track, first: int, second: int) -> str:
    """Return how two gates stand: ONE frame, BLOCKED, STRUCK (frames overlap and share no single post), or FREE."""
    if _is_one(track, first, second):
        return ONE
    reach = 0.5 * np.hypot(np.sqrt(2.0) * track.outer_sides, track.depth)
    if np.linalg.norm(track.positions[first] - track.positions[second]) > reach[first] + reach[second]:
        return FREE
    ours, others = bars(track, first), bars(track, second)
    for gate, posts in ((first, others), (second, ours)):
        if any(overlap(opening(track, gate), post) for post in posts):
            return BLOCKED
    if sum(_is_shared(a, b) for a in ours for b in others) == 1:
        return FREE
    return STRUCK if any(overlap(a, b) for a in ours for b in others) else FREE


def _is_one(track, first: int, second: int) -> bool:
    """Return whether two entries are one frame: the same corners, in any order, and the same bars."""
    along = float(track.rotations[first, :, 0] @ track.rotations[second, :, 0])
    apart = np.linalg.norm(track.corners[first][:, None] - track.corners[second], axis=2)
    wider = abs(track.outer_sides[first] - track.outer_sides[second])
    return bool(abs(along) > SAME_COSINE and apart.min(axis=1).max() < SAME_M and wider < SAME_M)


def overlap(a: Box, b: Box) -> bool:
    """Return whether two boxes overlap by more than TOLERANCE_M."""
    edges = np.cross(a.axes.T[:, None], b.axes.T[None]).reshape(-1, 3)
    lengths = np.linalg.norm(edges, axis=1)
    edges = edges[lengths > 1e-6] / lengths[lengths > 1e-6, None]
    axes = np.concatenate([a.axes.T, b.axes.T, edges])
    apart = np.abs(axes @ (a.centre - b.centre))
    reach = np.abs(axes @ a.axes) @ a.half + np.abs(axes @ b.axes) @ b.half
    return bool(np.all(apart < reach - TOLERANCE_M))


def _is_shared(a: Box, b: Box) -> bool:
    """Return whether two bars are one post: parallel, side by side along their longest edge, at one place."""
    along, other = a.axes[:, np.argmax(a.half)], b.axes[:, np.argmax(b.half)]
    apart = a.centre - b.centre
    across = float(np.linalg.norm(apart - (apart @ along) * along))
    reach = float(np.max(a.half) + np.max(b.half))
    return bool(abs(along @ other) > SHARED_COSINE and across < SHARED_M and abs(apart @ along) < 0.5 * reach)
