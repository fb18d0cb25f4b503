"""Labelled images: the corners of the gates in an image, and what is known about its camera.

A pixel centre has integer coordinates, as in OpenCV and in COCO keypoints. Corners are the inner corners of a gate's
opening, ordered top-left, top-right, bottom-right, bottom-left as seen with gravity pointing down, at any roll of the
camera: in the image they run clockwise.
"""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry

CORNERS = ("top_left", "top_right", "bottom_right", "bottom_left")
NOT_LABELLED, OCCLUDED, VISIBLE = 0, 1, 2  # visibility of a corner, as in COCO
PERSON, FLIGHT, IMPORTED = "person", "flight", "import"  # where labels come from
MAX_OUTSIDE = 1.0  # of the image's size: how far outside of it an occluded corner may be
MAX_VISIBLE_OUTSIDE_PX = 2.0  # a visible corner at the border may be clicked slightly outside
LEAST_AREA_PX = 4.0  # of a gate with four corners, px^2; a smaller one has no shape
# Optical axis horizontal, up of the image is up of the world; its azimuth does not matter.
R_WORLD_LEVEL_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class LabelledGate:
    """One gate.

    Attributes:
        corners_px: (4, 2); NaN where not labelled.
        visibility: (4,), NOT_LABELLED, OCCLUDED (behind something, or outside of the image) or VISIBLE.
    """

    corners_px: np.ndarray
    visibility: np.ndarray

    @property
    def is_whole(self) -> bool:
        """All four corners are visible."""
        return bool((self.visibility == VISIBLE).all())

    @property
    def side_px(self) -> float:
        """Mean length of the labelled sides, px; NaN where no two neighbouring corners are labelled."""
        sides = np.linalg.norm(self.corners_px - np.roll(self.corners_px, -1, axis=0), axis=-1)
        known = sides[np.isfinite(sides)]
        return float(known.mean()) if known.size else float("nan")


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """One image with its gates.

    Attributes:
        file_name: relative to the folder, with "/".
        width, height: px.
        gates: labelled gates; none in an image that shows no gate.
        all_gates: every gate in the image is labelled; otherwise a detection elsewhere may be right.
        q_world_camera: attitude (4,) of the optical frame (x right, y down, z forward); None where it is not known.
        stamp_s: time in the recording, s; None for a still.
        sequence: name of the recording; images of one sequence look alike, and no split may separate them. "" for a
            still.
        source: who labelled it: PERSON, FLIGHT or IMPORTED; "" where the file does not say.
    """

    file_name: str
    width: int
    height: int
    gates: tuple[LabelledGate, ...] = ()
    all_gates: bool = True
    q_world_camera: np.ndarray | None = None
    stamp_s: float | None = None
    sequence: str = ""
    source: str = ""


def r_world_camera(image: LabelledImage) -> np.ndarray:
    """Return the attitude (3, 3) of an image's optical frame; that of a level camera where it is not known."""
    if image.q_world_camera is None:
        return R_WORLD_LEVEL_CAMERA
    return geometry.rotation_matrix(geometry.normalize(image.q_world_camera))


def q_world_body(attitude, camera) -> np.ndarray:
    """Return the attitude (4,) of the body that carries a camera: what `GateDetector.detect` takes.

    Args:
        attitude: of the optical frame (3, 3).
        camera: with its mount.
    """
    q_world_camera = geometry.quaternion_from_matrix(attitude)
    return geometry.quaternion_multiply(q_world_camera, geometry.quaternion_conjugate(camera.q_body_camera))


def problem_of(gate: LabelledGate, width: int, height: int) -> str:
    """Return what is wrong with a gate in an image of a size (px), as the end of a sentence; "" if nothing is."""
    corners, visibility = gate.corners_px, gate.visibility
    labelled = visibility != NOT_LABELLED
    if not labelled.any():
        return "has no labelled corner"
    if not np.isfinite(corners[labelled]).all():
        return "has a corner that is not a number"
    size = np.array([width, height])
    outside = np.maximum(-0.5 - corners, corners - (size - 0.5))
    too_far = np.where((visibility == VISIBLE)[:, None], MAX_VISIBLE_OUTSIDE_PX, MAX_OUTSIDE * size)
    for k in np.nonzero(labelled & (outside > too_far).any(axis=1))[0]:
        u, v = corners[k]
        kind = "visible " if visibility[k] == VISIBLE else ""
        return f"has its {kind}corner {CORNERS[k]} outside of the image, at ({u:.0f}, {v:.0f}) of {width} x {height} px"
    if labelled.sum() < 3:
        return ""
    if labelled.all() and _crosses(corners):
        return "has sides that cross each other; the corners run top-left, top-right, bottom-right, bottom-left"
    area = _area(corners[labelled])
    if area < 0:
        return "has its corners anticlockwise; they run top-left, top-right, bottom-right, bottom-left"
    return "has its corners on a line or in a point" if labelled.all() and area < LEAST_AREA_PX else ""


def _area(corners) -> float:
    """Return the area (px^2) of a polygon (n, 2), positive where it runs clockwise in the image."""
    after = np.roll(corners, -1, axis=0)
    return float(0.5 * np.sum(corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]))


def _crosses(corners) -> bool:
    """Return whether two opposite sides of a quadrilateral (4, 2) cross."""
    a, b, c, d = corners
    return _segments_cross(a, b, c, d) or _segments_cross(b, c, d, a)


def _segments_cross(a, b, c, d) -> bool:
    def side(p, q, r):
        return np.sign((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return bool(side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0)
