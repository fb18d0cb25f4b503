"""Gates of which two or three corners are seen: the others are outside of the image, hidden or not found.

Two corners need the edge between them, three corners two edges. Corners of whole gates are not used again, and corners
near the border of the image are not used at all: there the network extrapolates.
"""

import numpy as np

from swift_ros.perception.corner_grouping import CORNERS, GroupingSettings, Peaks, without_outset

# px in the panorama. In two races through a pinhole lens 18 of 52 incomplete gates with a corner nearer to the border,
# and 18 of the 441 others, were off by 1 to 4 degrees.
MIN_BORDER_PX = 6.0


def incomplete_gates(scores, usable, settings: GroupingSettings) -> list[dict[int, int]]:
    """Return gates as the indices of their peaks by corner, 0 (TL) to 3 (BL).

    Edges are taken in the order of falling scores. An edge is left out where a better one leads from or to one of its
    corners, or where both ends already belong to gates with a common corner.

    Args:
        scores: of the edges, see `edge_scores`.
        usable: mask (n,) of the peaks of each class that may be used.
        settings: of the grouping.
    """
    gates: dict[tuple[int, int], dict[int, int]] = {}  # by corner and index
    left: set[tuple[int, int]] = set()  # corners from which an edge leads
    reached: set[tuple[int, int]] = set()  # corners to which an edge leads
    for _, k, i, j in sorted(_edges(scores, usable, settings)):
        start, end = (k, i), ((k + 1) % CORNERS, j)
        first, second = gates.get(start, dict([start])), gates.get(end, dict([end]))
        if start in left or end in reached or (first is not second and first.keys() & second.keys()):
            continue
        left.add(start)
        reached.add(end)
        gate = first | second
        gates |= dict.fromkeys(gate.items(), gate)
    return [gate for gate in {id(gate): gate for gate in gates.values()}.values() if len(gate) < CORNERS]


def _edges(scores, usable, settings: GroupingSettings):
    """Yield (negative score, first corner, indices of its peak and of that of the next corner) of good edges."""
    for k, score in enumerate(scores):
        good = (score > settings.edge_threshold) & usable[k][:, None] & usable[(k + 1) % CORNERS]
        for i, j in np.argwhere(good).tolist():
            yield -float(score[i, j]), k, i, j


def seen_corners(gates: list[dict[int, int]], peaks: list[Peaks], settings: GroupingSettings):
    """Return the corners (n, 4, 2) of gates in the panorama, px, and their confidence (n, 4): NaN and 0 where not seen.

    The outset of the network is removed as that of a whole gate, whose unseen corners complete a parallelogram or, on a
    single edge, a square.
    """
    points, confidence = np.full((len(gates), CORNERS, 2), np.nan), np.zeros((len(gates), CORNERS))
    for n, gate in enumerate(gates):
        for k, i in gate.items():
            points[n, k], confidence[n, k] = peaks[k].points[i], peaks[k].confidence[i]
    seen, whole = confidence > 0.0, points.copy()
    for n in np.flatnonzero(~seen.all(axis=1)):
        whole[n] = _completed(points[n], seen[n])
    return np.where(seen[..., None], without_outset(whole, settings), np.nan), confidence


def _completed(points, seen):
    """Return the corners (4, 2) of a parallelogram through three seen corners or of a square on two."""
    whole = points.copy()
    if seen.sum() == 2:
        first = next(k for k in range(CORNERS) if seen[k] and seen[(k + 1) % CORNERS])
        right, down = points[(first + 1) % CORNERS] - points[first]
        whole[(first + 2) % CORNERS] = points[(first + 1) % CORNERS] + [-down, right]
    unseen = int(np.flatnonzero(np.isnan(whole[:, 0]))[0])
    before, opposite, after = (whole[(unseen + shift) % CORNERS] for shift in (-1, 2, 1))
    whole[unseen] = before + after - opposite
    return whole
