"""From the network's maps to gates: sub-pixel corner peaks, joined along affinity fields into quadrilaterals.

A gate needs all four corners and all four edges; what is partly hidden is not invented. Edges are followed along the
great-circle arc between two corners' rays, which in the panorama is the image of the straight edge.
"""

from dataclasses import dataclass

import cv2
import numpy as np

CORNERS = 4
EDGE_SAMPLES = 10
LEAN_SHARE, LEAN_PX = 0.15, 4.0  # of its height, and px: how far an edge that is vertical may lean in the panorama

SQUARE_SLACK = 0.2  # of a side
CORNER_PX = 1.5  # what a corner may be off by


@dataclass(frozen=True)
class Peaks:
    """Corners of one class: points (n, 2) px of the panorama; confidence (n,) in 0..1, falling."""

    points: np.ndarray
    confidence: np.ndarray


@dataclass(frozen=True)
class GroupingSettings:
    """peak_threshold: least height of a corner's peak; edge_threshold: least mean agreement of a field with an edge,
    -1..1; most_peaks: strongest corners of a class that are kept; stride: panorama pixels per map pixel."""

    peak_threshold: float
    edge_threshold: float
    most_peaks: int
    stride: int


def find_peaks(heat, settings: GroupingSettings) -> list[Peaks]:
    """Return the peaks of each of the corner maps (4, h, w), highest first.

    A peak is a local maximum of its 3 x 3 neighbours; its place is that of a parabola through the map's logarithm,
    which is exact for a Gaussian.
    """
    return [_peaks_of_class(np.ascontiguousarray(layer), settings) for layer in heat]


def _peaks_of_class(layer, settings):
    highest = cv2.dilate(layer, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero((layer >= highest) & (layer > settings.peak_threshold))
    inner = (rows > 0) & (columns > 0) & (rows < layer.shape[0] - 1) & (columns < layer.shape[1] - 1)
    rows, columns = rows[inner], columns[inner]
    order = np.argsort(-layer[rows, columns], kind="stable")[: settings.most_peaks]
    rows, columns = rows[order], columns[order]
    x = columns + _vertex(layer[rows, columns - 1], layer[rows, columns], layer[rows, columns + 1])
    y = rows + _vertex(layer[rows - 1, columns], layer[rows, columns], layer[rows + 1, columns])
    points = settings.stride * np.stack([x, y], axis=-1) + (settings.stride - 1) / 2
    return Peaks(points, layer[rows, columns].astype(float))


def _vertex(before, at, after):
    """Return where (-0.5..0.5) the parabola through three logarithms has its top."""
    before, at, after = (np.log(np.maximum(v, 1e-6)) for v in (before, at, after))
    curvature = np.minimum(before - 2 * at + after, -1e-9)
    return np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)


def edge_scores(peaks: list[Peaks], fields, panorama, settings: GroupingSettings) -> list[np.ndarray]:
    """Return for each edge k the agreement (n_k, n_k+1) of its field with the arc from corner k's peaks to the next's.

    fields (8, h, w): unit vectors (across, down) of the edges TL-TR, TR-BR, BR-BL, BL-TL. The score is the mean over
    the arc of field times direction, 1 at best; it is -1 where an upright edge would lean.
    """
    rays = [panorama.rays(p.points) for p in peaks]
    scores = []
    for k in range(CORNERS):
        following = (k + 1) % CORNERS
        agreement = _along_arcs(rays[k], rays[following], fields[2 * k : 2 * k + 2], panorama, settings)
        if k % 2:  # TR-BR and BL-TL are vertical in the panorama
            apart = peaks[following].points[None] - peaks[k].points[:, None]
            lean = np.abs(apart[..., 0]) > LEAN_SHARE * np.abs(apart[..., 1]) + LEAN_PX
            agreement = np.where(lean, -1.0, agreement)
        scores.append(agreement)
    return scores


def _along_arcs(starts, ends, field, panorama, settings):
    """Return the mean agreement (n, m) of a field (2, h, w) with the arcs between rays (n, 3) and (m, 3)."""
    if not len(starts) or not len(ends):
        return np.zeros((len(starts), len(ends)))
    share = np.linspace(0, 1, EDGE_SAMPLES + 1)[:, None, None, None]
    arcs = panorama.points((1 - share) * starts[:, None] + share * ends[None])
    steps = np.diff(arcs, axis=0)
    places = (0.5 * (arcs[1:] + arcs[:-1]) - (settings.stride - 1) / 2) / settings.stride
    columns = np.clip(np.rint(places[..., 0]).astype(int), 0, field.shape[2] - 1)
    rows = np.clip(np.rint(places[..., 1]).astype(int), 0, field.shape[1] - 1)
    length = np.hypot(steps[..., 0], steps[..., 1]) + 1e-9
    return np.mean((field[0, rows, columns] * steps[..., 0] + field[1, rows, columns] * steps[..., 1]) / length, axis=0)


def joined(scores: list[np.ndarray], settings: GroupingSettings) -> list[np.ndarray]:
    """Return for each class which of its peaks (n,) an edge joins to a neighbouring corner: corners one may trust even
    of a gate that is not whole."""
    good = [score > settings.edge_threshold for score in scores]
    return [good[k].any(axis=1) | good[k - 1].any(axis=0) for k in range(CORNERS)]


def quadrilaterals(peaks: list[Peaks], scores: list[np.ndarray], panorama, settings: GroupingSettings):
    """Return gates as indices (TL, TR, BR, BL) of their peaks, best first; no peak is used twice.

    All four edges must score above the threshold and the four corners must be an upright square's (see `_squares`); of
    rivals the greatest sum of scores wins.
    """
    top, right, bottom, left = scores
    bl, tl = np.nonzero(left > settings.edge_threshold)
    tr, br = np.nonzero(right > settings.edge_threshold)
    upper, lower = top[tl[:, None], tr], bottom[br, bl[:, None]]
    good = (upper > settings.edge_threshold) & (lower > settings.edge_threshold)
    if not good.any():
        return []
    corners = [peaks[k].points[index] for k, index in enumerate((tl, tr, br, bl))]
    good &= _squares(*corners, panorama)
    total = np.where(good, upper + lower + left[bl, tl][:, None] + right[tr, br], -np.inf)
    gates = []
    while np.isfinite(total.max()):
        a, b = np.unravel_index(np.argmax(total), total.shape)
        gates.append((int(tl[a]), int(tr[b]), int(br[b]), int(bl[a])))
        total[(tl == tl[a]) | (bl == bl[a])] = -np.inf
        total[:, (tr == tr[b]) | (br == br[b])] = -np.inf
    return gates


def _squares(tl, tr, br, bl, panorama):
    """Return (n, m) bool: left posts tl, bl (n, 2) px and right posts tr, br (m, 2) px may bound an upright square.

    With gravity known the angle that a post spans tells its distance in units of the square's side, so that the four
    corners are placed: the posts must stand one side apart and end at the same height, within SQUARE_SLACK and what
    corners CORNER_PX off may feign.
    """
    middle, density = (panorama.side - 1) / 2, panorama.pixels_per_radian
    azimuth = [(middle - 0.5 * (a[:, 0] + b[:, 0])) / density for a, b in ((tl, bl), (tr, br))]
    high, low = ([np.tan((middle - p[:, 1]) / density) for p in posts] for posts in ((tl, tr), (bl, br)))
    distance = [1 / np.maximum(a - b, 1e-3) for a, b in zip(high, low, strict=True)]
    doubt = [  # share of the distance
        d * (1 + np.maximum(a**2, b**2)) * CORNER_PX / density for d, a, b in zip(distance, high, low, strict=True)
    ]
    near, far = distance[0][:, None], distance[1][None]
    share = np.hypot(doubt[0][:, None], doubt[1][None])
    across = 2 * np.sqrt(near * far) * np.abs(np.sin(0.5 * (azimuth[0][:, None] - azimuth[1][None])))
    along, feigned = np.abs(near - far), share * np.maximum(near, far)
    widest = np.hypot(across * (1 + share), along + feigned)
    narrowest = np.hypot(across * (1 - share), np.maximum(along - feigned, 0))
    height = [(d * h) for d, h in zip(distance, high, strict=True)]
    uneven = np.abs(height[0][:, None] - height[1][None])
    even = uneven < SQUARE_SLACK + share * (1 + np.maximum(np.abs(height[0][:, None]), np.abs(height[1][None])))
    return even & (widest > 1 - SQUARE_SLACK) & (narrowest < 1 + SQUARE_SLACK)
