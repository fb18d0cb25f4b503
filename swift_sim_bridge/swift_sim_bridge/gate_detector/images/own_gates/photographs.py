"""Gates in labelled photographs, as frontal pictures."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from swift_ros.camera import model as lens
from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.images.own_gates.picture import PictureGate
from swift_sim_bridge.labels import folder as labels

LEAST_SIDE_PX = 60  # shortest side of an opening in the photograph; a smaller gate would be blurred when it is near
MAX_SIDE_PX = 420  # of an opening in its picture, as of drawn gates
INSIDE_PX = 1.0  # the frame is this far from the edge of the photograph
AHEAD = 0.05  # least cosine from the optical axis; a plane through the camera has no picture beyond it


def read(path: Path, bar: float, fov_deg: float | None = None) -> list[PictureGate]:
    """Return the frontal pictures of the gates in a folder of labelled images.

    Args:
        path: folder with `labels.json`.
        bar: width of the frame in sides of the opening.
        fov_deg: horizontal field of view of a pinhole lens that is assumed instead of `camera.yaml`, degrees.

    Raises:
        UsageError: a file is missing or wrong, or no gate is large and whole enough.
    """
    folder = labels.read(path, fov_deg)
    found = []
    for image in folder.images:
        gates = [gate for gate in image.gates if gate.is_whole and _shortest_side(gate.corners_px) >= LEAST_SIDE_PX]
        picture = folder.colours(image) if gates else None
        found += [frontal(picture, folder.camera(image), gate.corners_px, bar) for gate in gates]
    found = [gate for gate in found if gate]
    if not found:
        raise UsageError(
            f"{path / labels.LABELS} has no gate with four visible corners, sides of at least {LEAST_SIDE_PX} px and "
            "its whole frame in the image; label nearer gates, or give this folder to --images alone"
        )
    return found


def frontal(picture, camera, corners_px, bar: float) -> PictureGate | None:
    """Return the frontal picture of a gate with a square opening; None where its frame leaves the photograph.

    Args:
        picture: (H, W, 3) uint8, blue first.
        camera: that took it.
        corners_px: (4, 2), corners of the opening TL, TR, BR, BL.
        bar: width of the frame in sides of the opening.
    """
    side = int(np.clip(np.ceil(_longest_side(corners_px)), LEAST_SIDE_PX, MAX_SIDE_PX))
    margin = max(int(round(bar * side)), 1)
    whole = side + 2 * margin
    rays = lens.unproject(camera, np.asarray(corners_px, float))
    if rays[:, 2].min() < AHEAD:
        return None
    opening = np.float32([(0, 0), (side, 0), (side, side), (0, side)]) + np.float32(margin - 0.5)
    matrix = cv2.getPerspectiveTransform(opening, (rays[:, :2] / rays[:, 2:]).astype(np.float32))
    columns, rows = np.meshgrid(np.arange(whole), np.arange(whole))
    ahead = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ matrix.T
    pixels, theta = lens.project(camera, ahead)
    inside = (lens.inside_px(camera, pixels) > INSIDE_PX) & (ahead[..., 2] > 0) & (theta < camera.half_angle)
    if not inside.all():
        return None
    second: Any = None  # not needed with a map of pairs (x, y), which cv2's annotations do not know
    sample = cv2.remap(picture, pixels.astype(np.float32), second, cv2.INTER_LINEAR)
    opacity = np.full((whole, whole, 1), 255, np.uint8)
    opacity[margin : margin + side, margin : margin + side] = 0
    return PictureGate(np.concatenate([sample, opacity], axis=-1), (margin, margin, margin + side, margin + side))


def _sides(corners_px) -> np.ndarray:
    return np.linalg.norm(corners_px - np.roll(corners_px, -1, axis=0), axis=-1)


def _shortest_side(corners_px) -> float:
    return float(_sides(corners_px).min())


def _longest_side(corners_px) -> float:
    return float(_sides(corners_px).max())
