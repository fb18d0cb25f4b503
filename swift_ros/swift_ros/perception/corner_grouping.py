"""Groups corners to gates: sub-pixel peaks of the corner maps, connected by affinity fields to quadrilaterals.

A gate needs all four corners and all four edges; `incomplete_gates` finds the others. An edge is followed along the
great-circle arc between the rays of two corners: in the panorama this is the image of a straight edge.
"""

from dataclasses import dataclass

import numpy as np

CORNERS = 4  # of a gate
AROUND = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)])  # steps to the pixels of 3 x 3
EDGE_SAMPLES = 10  # samples of the field along an edge
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
    classes, rows, columns = np.unravel_index(np.flatnonzero(heat > settings.peak_threshold), heat.shape)  # few of all
    inner = (rows > 0) & (columns > 0) & (rows < heat.shape[1] - 1) & (columns < heat.shape[2] - 1)
    classes, rows, columns = classes[inner], rows[inner], columns[inner]
    around = heat[classes, rows + AROUND[:, :1], columns + AROUND[:, 1:]]
    highest = (heat[classes, rows, columns] >= around).all(axis=0)
    classes, rows, columns, around = classes[highest], rows[highest], columns[highest], around[:, highest]
    above, before, at, after, below = around[[1, 3, 4, 5, 7]]  # of 3 x 3 pixels, row by row
    x, y = columns + _vertex(before, at, after), rows + _vertex(above, at, below)
    points = settings.stride * np.stack([x, y], axis=-1) + (settings.stride - 1) / 2
    peaks = []
    for k in range(len(heat)):
        of_class = np.flatnonzero(classes == k)
        order = of_class[np.argsort(-at[of_class], kind="stable")[: settings.most_peaks]]
        peaks.append(Peaks(points[order], at[order].astype(float)))
    return peaks


def _vertex(before, at, after):
    """Return the position (-0.5 to 0.5) of the vertex of the parabola through three logarithms."""
    before, at, after = (np.log(np.maximum(v, MIN_MAP_VALUE)) for v in (before, at, after))
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
    rays = [panorama.rays(p.points) for p in peaks]
    scores = []
    for k in range(CORNERS):
        following = (k + 1) % CORNERS
        agreement = _along_arcs(rays[k], rays[following], fields[2 * k : 2 * k + 2], panorama, settings)
        if k % 2:  # TR-BR and BL-TL are vertical in the panorama
            difference = peaks[following].points[None] - peaks[k].points[:, None]
            leans = np.abs(difference[..., 0]) > MAX_LEAN_SHARE * np.abs(difference[..., 1]) + MAX_LEAN_PX
            agreement = np.where(leans, -1.0, agreement)
        scores.append(agreement)
    return scores


def _along_arcs(starts, ends, field, panorama, settings):
    """Return the mean agreement (n, m) of a field (2, h, w) with the arcs between rays (n, 3) and (m, 3)."""
    if not len(starts) or not len(ends):
        return np.zeros((len(starts), len(ends)))
    share = np.linspace(0, 1, EDGE_SAMPLES + 1)[:, None, None, None]
    arcs = panorama.points((1 - share) * starts[:, None] + share * ends[None])
    steps = np.diff(arcs, axis=0)
    positions = (0.5 * (arcs[1:] + arcs[:-1]) - (settings.stride - 1) / 2) / settings.stride
    columns = np.clip(np.rint(positions[..., 0]).astype(int), 0, field.shape[2] - 1)
    rows = np.clip(np.rint(positions[..., 1]).astype(int), 0, field.shape[1] - 1)
    length = np.hypot(steps[..., 0], steps[..., 1]) + 1e-9
    return np.mean((field[0, rows, columns] * steps[..., 0] + field[1, rows, columns] * steps[..., 1]) / length, axis=0)


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
    """Return the corners (4, 2) of a gate in the panorama, px, moved towards its centre by the network's outset."""
    arms = points - points.mean(axis=0)
    side = np.linalg.norm(points - np.roll(points, -1, axis=0), axis=-1).mean()
    outset = settings.corner_outset_px * min(side / FULL_OUTSET_SIDE_PX, 1.0) ** 2
    return points - outset * arms / np.linalg.norm(arms, axis=-1, keepdims=True)


def _squares(tl, tr, br, bl, panorama):
    """Return a mask (n, m): left posts tl, bl (n, 2) px and right posts tr, br (m, 2) px can form an upright square.

    As the direction of gravity is known, the elevation angles of a post's ends determine its distance in units of the
    square's side. The posts must be one side apart and have the same height, within SQUARE_TOLERANCE and the effect of
    corner errors of CORNER_ERROR_PX.
    """
    density = panorama.pixels_per_radian
    azimuth = [panorama.angles(0.5 * (a + b))[:, 0] for a, b in ((tl, bl), (tr, br))]
    high, low = ([np.tan(panorama.angles(p)[:, 1]) for p in posts] for posts in ((tl, tr), (bl, br)))
    distance = [1 / np.maximum(a - b, 1e-3) for a, b in zip(high, low, strict=True)]
    uncertainty = [  # of the distance, relative
        d * (1 + np.maximum(a**2, b**2)) * CORNER_ERROR_PX / density
        for d, a, b in zip(distance, high, low, strict=True)
    ]
    near, far = distance[0][:, None], distance[1][None]
    share = np.hypot(uncertainty[0][:, None], uncertainty[1][None])
    across = 2 * np.sqrt(near * far) * np.abs(np.sin(0.5 * (azimuth[0][:, None] - azimuth[1][None])))
    along, error = np.abs(near - far), share * np.maximum(near, far)
    widest = np.hypot(across * (1 + share), along + error)
    narrowest = np.hypot(across * (1 - share), np.maximum(along - error, 0))
    height = [(d * h) for d, h in zip(distance, high, strict=True)]
    height_difference = np.abs(height[0][:, None] - height[1][None])
    even = height_difference < SQUARE_TOLERANCE + share * (
        1 + np.maximum(np.abs(height[0][:, None]), np.abs(height[1][None]))
    )
    return even & (widest > 1 - SQUARE_TOLERANCE) & (narrowest < 1 + SQUARE_TOLERANCE)
