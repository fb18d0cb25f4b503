"""Groups corners to gates: sub-pixel peaks of the corner maps, connected by affinity fields to quadrilaterals.

A gate needs all four corners and all four edges; `incomplete_gates` finds the others. An edge is followed along the
great-circle arc between the rays of two corners: in the panorama this is the image of a straight edge.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

CORNERS = 4  # of a gate
AROUND = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)])  # steps to the pixels of 3 x 3
EDGE_SAMPLES = 10  # samples of the field along an edge
ALONG = np.linspace(0, 1, EDGE_SAMPLES + 1)[:, None, None]  # ends of the parts of an edge, from 0 to 1
# Largest horizontal distance between the ends of a vertical edge: share of its height, plus px. An attitude error makes
# vertical edges lean by the same angle; the share allows 8.5 degrees.
MAX_LEAN_SHARE, MAX_LEAN_PX = 0.15, 4.0
SQUARE_TOLERANCE = 0.2  # of a side; largest deviation from a square; larger joins more corners of different gates
CORNER_ERROR_PX = 1.5  # px; assumed error of a corner in the test for a square, in which it widens the tolerance
# px in the panorama; the outset of smaller gates falls with the square of their side, as measured in races through four
# lenses: 0.1 px at 12 px and 0.28 px at 22 px, of 0.38 px
FULL_OUTSET_SIDE_PX = 25.0
MIN_MAP_VALUE = 1e-6  # of a map from 0 to 1; smaller values are replaced before the logarithm


@dataclass(frozen=True)
class Peaks:
    """Corners of one class, in the order of decreasing confidence.

    Attributes:
        points: (n, 2) in the panorama, px.
        confidence: (n,) 0 to 1.
    """

    points: np.ndarray
    confidence: np.ndarray


@dataclass(frozen=True)
class GroupingSettings:
    """Settings of the grouping.

    Attributes:
        peak_threshold: smallest height of a corner's peak.
        edge_threshold: smallest mean agreement of a field with an edge, -1 to 1.
        most_peaks: largest number of corners of one class; the strongest are kept.
        stride: panorama pixels per map pixel.
        corner_outset_px: distance in the panorama by which the network places the corners of a large gate too far from
            its centre, px.
    """

    peak_threshold: float
    edge_threshold: float
    most_peaks: int
    stride: int
    corner_outset_px: float = 0.0


def find_peaks(heat, settings: GroupingSettings) -> list[Peaks]:
    """Return the peaks of each of the corner maps (4, h, w), highest first.

    A peak is a local maximum of its 3 x 3 neighbourhood. Its position is the vertex of a parabola through the logarithm
    of the map, which is exact for a Gaussian.
    """
    flat = np.flatnonzero(heat > settings.peak_threshold)  # few of all
    around = heat.take(flat + (AROUND @ [heat.shape[2], 1])[:, None], mode="clip")  # of 3 x 3 pixels, row by row
    highest = around[4] == around.max(axis=0)
    classes, rows, columns = np.unravel_index(flat[highest], heat.shape)
    around = around[:, highest]
    inner = (rows > 0) & (columns > 0) & (rows < heat.shape[1] - 1) & (columns < heat.shape[2] - 1)
    order = np.lexsort((-around[4], classes))
    order = order[inner[order]]
    classes, around, places = classes[order], around[:, order], np.stack([columns[order], rows[order]])
    logarithms = np.log(np.maximum(around, MIN_MAP_VALUE))
    vertices = _vertex(logarithms[[3, 1]], logarithms[4], logarithms[[5, 7]])
    points = settings.stride * (places + vertices).T + (settings.stride - 1) / 2
    confidence, ends = around[4].astype(float), np.searchsorted(classes, np.arange(len(heat) + 1)).tolist()
    ranges = [slice(start, min(end, start + settings.most_peaks)) for start, end in pairwise(ends)]
    return [Peaks(points[of_class], confidence[of_class]) for of_class in ranges]


def _vertex(before, at, after):
    """Return the positions (-0.5 to 0.5) of the vertices of the parabolas through three values."""
    curvature = np.minimum(before - 2 * at + after, -1e-9)
    return np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)


def edge_scores(peaks: list[Peaks], fields, panorama, settings: GroupingSettings) -> list[np.ndarray]:
    """Return for each edge k the scores (n_k, n_k+1) of the arcs from peaks of corner k to peaks of the next corner.

    The score is the mean of the scalar product of field and direction along the arc, at most 1. It is -1 for a vertical
    edge that leans.

    Args:
        peaks: of the four corner classes.
        fields: (8, h, w) unit vectors (right, down) of the edges TL-TR, TR-BR, BR-BL, BL-TL.
        panorama: view of the maps.
        settings: of the grouping.
    """
    counts = [len(p.points) for p in peaks]
    points, corner = np.concatenate([p.points for p in peaks]), np.repeat(np.arange(CORNERS), counts)
    starts, ends = np.nonzero((corner[:, None] + 1) % CORNERS == corner)  # of all four edges, one after the other
    rays, edge = panorama.rays(points), corner[starts]
    agreement = _along_arcs(rays[starts], rays[ends], fields, edge, panorama, settings)
    difference = np.abs(points[ends] - points[starts])
    leans = difference[:, 0] > MAX_LEAN_SHARE * difference[:, 1] + MAX_LEAN_PX
    agreement = np.where(leans & (edge % 2 == 1), -1.0, agreement)  # TR-BR and BL-TL are vertical in the panorama
    shapes = [(counts[k], counts[(k + 1) % CORNERS]) for k in range(CORNERS)]
    parts = np.split(agreement, np.cumsum([n * m for n, m in shapes])[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def _along_arcs(starts, ends, fields, edge, panorama, settings):
    """Return the mean agreement (n,) of the fields (8, h, w) of edges (n,) with the arcs between rays (n, 3)."""
    arcs = panorama.points((1 - ALONG) * starts + ALONG * ends)
    steps = arcs[1:] - arcs[:-1]
    positions = (0.5 * (arcs[1:] + arcs[:-1]) - (settings.stride - 1) / 2) / settings.stride
    last = np.array(fields.shape[:0:-1]) - 1
    columns, rows = np.moveaxis(np.clip(np.rint(positions).astype(int), 0, last), -1, 0)
    right, down = steps[..., 0], steps[..., 1]
    along = fields[2 * edge, rows, columns] * right + fields[2 * edge + 1, rows, columns] * down
    return np.mean(along / (np.hypot(right, down) + 1e-9), axis=0)


def connected_corners(scores: list[np.ndarray], settings: GroupingSettings) -> list[np.ndarray]:
    """Return for each class a mask (n,) of the peaks that an edge connects to a neighbouring corner.

    These corners are reliable even if their gate is incomplete.
    """
    good = [score > settings.edge_threshold for score in scores]
    return [np.any(good[k], axis=1) | np.any(good[k - 1], axis=0) for k in range(CORNERS)]


def quadrilaterals(peaks: list[Peaks], scores: list[np.ndarray], panorama, settings: GroupingSettings):
    """Return gates as indices (TL, TR, BR, BL) of their peaks, best first; no peak is used twice.

    All four edges must score above the threshold and the four corners must form an upright square (see `_squares`). Of
    gates with a common peak the one with the largest sum of scores is returned.
    """
    top, right, bottom, left = scores
    bl, tl = np.nonzero(left > settings.edge_threshold)
    tr, br = np.nonzero(right > settings.edge_threshold)
    upper, lower = top[tl[:, None], tr], bottom[br, bl[:, None]]
    good = (upper > settings.edge_threshold) & (lower > settings.edge_threshold)
    if not good.any():
        return []
    corners = peaks[0].points[tl], peaks[1].points[tr], peaks[2].points[br], peaks[3].points[bl]
    good &= _squares(*corners, panorama)
    total = np.where(good, upper + lower + left[bl, tl][:, None] + right[tr, br], -np.inf)
    gates = []
    while np.isfinite(total.max()):
        a, b = np.unravel_index(np.argmax(total), total.shape)
        gates.append((int(tl[a]), int(tr[b]), int(br[b]), int(bl[a])))
        total[(tl == tl[a]) | (bl == bl[a])] = -np.inf
        total[:, (tr == tr[b]) | (br == br[b])] = -np.inf
    return gates


def without_outset(points, settings: GroupingSettings) -> np.ndarray:
    """Return the corners (..., 4, 2) of gates in the panorama, px, moved to their centres by the network's outset."""
    arms = points - points.mean(axis=-2, keepdims=True)
    side = np.linalg.norm(points - points[..., [1, 2, 3, 0], :], axis=-1).mean(axis=-1)
    outset = settings.corner_outset_px * np.minimum(side / FULL_OUTSET_SIDE_PX, 1.0) ** 2
    return points - outset[..., None, None] * arms / np.linalg.norm(arms, axis=-1, keepdims=True)


def _squares(tl, tr, br, bl, panorama):
    """Return a mask (n, m): left posts tl, bl (n, 2) px and right posts tr, br (m, 2) px can form an upright square.

    As the direction of gravity is known, the elevation angles of a post's ends determine its distance in units of the
    square's side. The posts must be one side apart and have the same height, within SQUARE_TOLERANCE and the effect of
    corner errors of CORNER_ERROR_PX.
    """
    left = len(tl)
    top, bottom = np.concatenate([tl, tr]), np.concatenate([bl, br])
    azimuth = panorama.angles(0.5 * (top + bottom))[:, 0]
    high, low = np.tan(panorama.angles(np.stack([top, bottom]))[..., 1])
    distance = 1 / np.maximum(high - low, 1e-3)
    size = 1 + np.maximum(high**2, low**2)
    uncertainty = distance * size * CORNER_ERROR_PX / panorama.pixels_per_radian  # of the distance, relative
    height = distance * high
    near, far = distance[:left, None], distance[left:]
    share = np.hypot(uncertainty[:left, None], uncertainty[left:])
    across = 2 * np.sqrt(near * far) * np.abs(np.sin(0.5 * (azimuth[:left, None] - azimuth[left:])))
    along, error = np.abs(near - far), share * np.maximum(near, far)
    widest = np.hypot(across * (1 + share), along + error)
    narrowest = np.hypot(across * (1 - share), np.maximum(along - error, 0))
    highest = np.maximum(np.abs(height[:left, None]), np.abs(height[left:]))
    even = np.abs(height[:left, None] - height[left:]) < SQUARE_TOLERANCE + share * (1 + highest)
    return even & (widest > 1 - SQUARE_TOLERANCE) & (narrowest < 1 + SQUARE_TOLERANCE)
