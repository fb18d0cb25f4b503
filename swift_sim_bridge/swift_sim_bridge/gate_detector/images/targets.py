"""What the gate detector's network is to answer for an image with labels.

The image is turned upright into a panorama, and its labels are drawn as maps. They lie in the panorama, which is the
network's input. A corner is VISIBLE, HIDDEN (outside the image, its circle or the panorama, or behind an object: no
peak is expected), or IGNORED in training and scores: within a few pixels of being hidden, or of a gate that is too
small, too oblique or too far away.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from swift_ros import geometry
from swift_ros.configuration import within
from swift_ros.perception.upright import UprightView
from swift_sim_bridge.gate_detector.corner_states import HIDDEN, IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.model import STRIDE

# In pixels of the network's output; each is STRIDE pixels of the panorama. A wider Gaussian or field has more pixels to
# learn from and locates a corner or an edge less exactly.
HEAT_SIGMA_PX = 2.0 / STRIDE  # least standard deviation of a corner's Gaussian
MOST_HEAT_SIGMA_PX = 5.0 / STRIDE  # a wider Gaussian has no peak that could be located
HEAT_REACH = 4.0  # standard deviations of a corner's Gaussian; it is below 0.001 beyond
IGNORED_PX = 4  # radius around a corner that does not count, at least
EDGE_WIDTH_PX = 3  # of an affinity field
ARC_STEPS = 12  # straight pieces that approximate the curved image of an edge
MAX_PIECE = 80.0 / 135.0  # rad; a longer piece leaves the panorama on one side and enters on the other
NEAR = 8.0  # standard deviations of a label, of what is near a corner: hidden corners are guessed, others estimated


@dataclass(frozen=True)
class GateLimits:
    """Which gates count in training and scores; corners of the others are ignored.

    Attributes:
        least_side_px: shortest side in the published image.
        most_oblique_deg: angle between the line of sight and the gate's normal.
        most_distant: m.
    """

    least_side_px: float = within(1.0, 1000.0)
    most_oblique_deg: float = within(1.0, 90.0)
    most_distant: float = within(0.5, 200.0)

    def hold(self, side_px, oblique_deg, distance) -> np.ndarray:
        """Return which gates (n,) count, by arrays (n,) of these quantities."""
        large = (side_px >= self.least_side_px) & (oblique_deg < self.most_oblique_deg)
        return large & (distance <= self.most_distant)


@dataclass(frozen=True)
class GateLabels:
    """The labels of the gates of an image; corners in the order TL, TR, BR, BL as seen from the camera.

    Attributes:
        rays_camera: (n, 4, 3), of any length, to the corners in the optical frame.
        state: (n, 4), HIDDEN, VISIBLE or IGNORED.
        counts: (n,) bool, the gate is within the limits.
        side_px: (n,), shortest side in the published image.
        oblique_deg: (n,), angle between the line of sight and the gate's normal.
        distance: (n,) m; where it is not known, only the order of the gates by it.
        error_share: standard deviation of a label, share of the gate's side; 0 where labels are exact. Only then does a
            peak at a hidden corner count as wrong: otherwise the corner may be where the image still shows it.
        complete: all gates of the image are labelled; otherwise the image counts near the labelled gates only.
    """

    rays_camera: np.ndarray
    state: np.ndarray
    counts: np.ndarray
    side_px: np.ndarray
    oblique_deg: np.ndarray
    distance: np.ndarray
    error_share: float = 0.0
    complete: bool = True


@dataclass(frozen=True)
class Example:
    """One labelled image, turned upright.

    Attributes:
        view: the UprightView that turned it.
        panorama: (side, side) uint8, the network's input.
        r_world_camera: (3, 3), attitude by which it was turned, with its error.
        labels: of the gates.
        points, state: (n, 4, 2) px and (n, 4), corners in the panorama.
        target, mask: see `rasterize`.
    """

    view: UprightView
    panorama: np.ndarray
    r_world_camera: np.ndarray
    labels: GateLabels
    points: np.ndarray
    state: np.ndarray
    target: np.ndarray
    mask: np.ndarray


def example_of(view: UprightView, image, labels: GateLabels, r_world_camera) -> Example:
    """Return the example of an image (H, W) uint8, turned upright by an attitude (3, 3)."""
    points, state = panorama_labels(view, labels, r_world_camera)
    target, mask = rasterize(view, labels, points, state, r_world_camera)
    return Example(view, view.warp(image, r_world_camera), r_world_camera, labels, points, state, target, mask)


def estimated_attitude(q_world_camera, error_deg: float, rng) -> np.ndarray:
    """Return an attitude (4,) with a random error of a standard deviation (degrees, an axis), as a matrix (3, 3)."""
    error = np.radians(error_deg) * rng.standard_normal(3)
    turn = geometry.quaternion_from_rotation_vector(error)
    return geometry.rotation_matrix(geometry.quaternion_multiply(turn, q_world_camera))


def panorama_labels(view: UprightView, labels: GateLabels, r_world_camera):
    """Return the corners (n, 4, 2) in the panorama, px, and their states (n, 4).

    Corners outside the panorama are HIDDEN; those of gates that do not count are IGNORED.

    Args:
        view: the UprightView that turns images.
        labels: of the image.
        r_world_camera: (3, 3), attitude by which the image is turned.
    """
    points = view.from_rays(labels.rays_camera, r_world_camera)
    state = np.where(labels.counts[:, None] | (labels.state == HIDDEN), labels.state, IGNORED)
    side = view.panorama.side
    return points, np.where(((points > 2) & (points < side - 3)).all(axis=-1), state, HIDDEN)


def large_in_panorama(view: UprightView, rays_camera, r_world_camera, least_px: float) -> np.ndarray:
    """Return which gates (n,) with corners along rays (n, 4, 3) have sides of at least `least_px` in the panorama.

    In the image of a wide lens and in its panorama a gate has about the same size. In a large photograph the sides that
    count are some times larger than those that the network sees.
    """
    points = view.from_rays(rays_camera, r_world_camera)
    return np.linalg.norm(points - np.roll(points, -1, axis=1), axis=-1).min(axis=1) >= least_px


def _stamp(heat, point, sigma_px):
    """Add a Gaussian of height one at a point (output px) to a corner map, as the maximum of both."""
    h, w = heat.shape
    reach = int(np.ceil(HEAT_REACH * sigma_px))
    x0, y0 = np.floor(point).astype(int) - reach
    x = np.arange(max(x0, 0), min(x0 + 2 * reach + 2, w))
    y = np.arange(max(y0, 0), min(y0 + 2 * reach + 2, h))
    if len(x) and len(y):
        bump = np.exp(-((x - point[0]) ** 2 + (y[:, None] - point[1]) ** 2) / (2 * sigma_px**2))
        patch = heat[y[0] : y[-1] + 1, x[0] : x[-1] + 1]
        np.maximum(patch, bump, out=patch)


class _Arcs:
    """The images of the straight edges between corners, in pixels of the network's output."""

    def __init__(self, view: UprightView, labels: GateLabels, r_world_camera):
        self._view, self._rays, self._r_world_camera = view, labels.rays_camera, r_world_camera
        self._longest = MAX_PIECE * view.panorama.pixels_per_radian / STRIDE

    def pieces(self, gate: int, k: int):
        """Yield the two ends of each straight piece of the edge that begins at corner k."""
        start, end = self._rays[gate, [k, (k + 1) % 4]]
        share = np.linspace(0, 1, ARC_STEPS + 1)[:, None]
        points = self._view.from_rays(start + share * (end - start), self._r_world_camera)
        arc = (points - (STRIDE - 1) / 2) / STRIDE
        for a, b in zip(arc[:-1], arc[1:], strict=True):
            if 1e-6 < np.hypot(*(b - a)) < self._longest:
                yield a, b


def _draw_line(image, piece, value, width: int):
    ends = [tuple(int(round(v)) for v in end * 16) for end in piece]
    cv2.line(image, *ends, value, width, cv2.LINE_8, 4)


def _draw_disc(image, point, radius: float, value: float):
    cv2.circle(image, tuple(int(v) for v in np.clip(point, -99, 999)), int(radius), value, -1)


def _sides_px(points) -> np.ndarray:
    """Return the mean sides (n,) of gates with corners (n, 4, 2), in pixels of the network's output."""
    return np.linalg.norm(points - np.roll(points, -1, axis=1), axis=-1).mean(axis=1) / STRIDE


def rasterize(view: UprightView, labels: GateLabels, points, state, r_world_camera):
    """Return the target of the network's output, and where it counts.

    Args:
        view: the UprightView that turned the image.
        labels: of the image.
        points, state: corners in the panorama, see `panorama_labels`.
        r_world_camera: (3, 3), attitude by which the image was turned.

    Returns:
        target: (s, s, 12) float32, s = panorama side / STRIDE: maps of TL, TR, BR, BL, then the fields of the edges
            TL-TR, TR-BR, BR-BL, BL-TL as unit vectors (right, down).
        mask: (s, s, 2) float32, 0 where corner maps and where fields are ignored, else 1.
    """
    side = view.panorama.side // STRIDE
    heat = np.zeros((4, side, side), np.float32)
    fields = [np.zeros((side, side, 2), np.float32) for _ in range(4)]
    shrunk, arcs = (points - (STRIDE - 1) / 2) / STRIDE, _Arcs(view, labels, r_world_camera)
    error_px, exact = labels.error_share * _sides_px(points), labels.error_share == 0.0
    sigma_px = np.clip(error_px, HEAT_SIGMA_PX, MOST_HEAT_SIGMA_PX)
    around_px = np.maximum(IGNORED_PX, NEAR * error_px)
    mask = _where_it_counts(labels, shrunk, arcs, around_px, side)
    for gate in np.argsort(-labels.distance):
        for k in range(4):
            if state[gate, k] == VISIBLE:
                _stamp(heat[k], shrunk[gate, k], sigma_px[gate])
            elif state[gate, k] == IGNORED or not exact:
                _draw_disc(mask[0], shrunk[gate, k], around_px[gate], 0.0)
            pair = state[gate, [k, (k + 1) % 4]]
            if exact and (pair == HIDDEN).all():
                continue
            width = max(EDGE_WIDTH_PX + 4, int(2 * NEAR * error_px[gate]) if IGNORED in pair else 0)
            for a, b in arcs.pieces(gate, k):
                if (pair == VISIBLE).all():
                    _draw_line(fields[k], (a, b), ((b - a) / np.hypot(*(b - a))).tolist(), EDGE_WIDTH_PX)
                else:
                    _draw_line(mask[1], (a, b), 0.0, width)
    target = np.concatenate([np.moveaxis(heat, 0, -1), *fields], axis=-1)
    return target, np.stack(mask, axis=-1)


def _where_it_counts(labels: GateLabels, shrunk, arcs: _Arcs, around_px, side: int) -> list[np.ndarray]:
    """Return the masks (side, side) of corner maps and of fields before corners and edges are ignored.

    Where not all gates are labelled these are the surroundings of the labelled corners and edges. The opening is left
    out: another gate may be seen through it.
    """
    if labels.complete:
        return [np.ones((side, side), np.float32) for _ in range(2)]
    near = np.zeros((side, side), np.float32)
    for gate in np.nonzero(labels.counts)[0]:
        for k in np.nonzero(labels.state[gate] != IGNORED)[0]:
            _draw_disc(near, shrunk[gate, k], around_px[gate], 1.0)
            if labels.state[gate, (k + 1) % 4] != IGNORED:
                for piece in arcs.pieces(gate, k):
                    _draw_line(near, piece, 1.0, int(2 * around_px[gate]))
    return [near, near.copy()]
