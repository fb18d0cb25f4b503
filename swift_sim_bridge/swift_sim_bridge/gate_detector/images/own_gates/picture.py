"""Frontal pictures of gates with transparency."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from swift_ros.errors import UsageError

OPEN = 128  # opacity, of 255, below which a pixel of a gate is open


@dataclass(frozen=True, eq=False)
class PictureGate:
    """The frontal picture of a gate.

    Attributes:
        picture: (h, w, 4) uint8, blue, green, red, opacity.
        opening: (x0, y0, x1, y1) px, end exclusive.
    """

    picture: np.ndarray
    opening: tuple[int, int, int, int]


def read(path: Path) -> PictureGate:
    """Return the gate of a PNG file; its opening is the largest transparent area that does not touch the edge.

    Raises:
        UsageError: it is damaged, is not transparent, or has no opening.
    """
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if found is None:
        raise UsageError(f"{path} is not a readable picture; restore it or remove it from its folder")
    if found.ndim != 3 or found.shape[2] != 4 or found.dtype != np.uint8:
        raise UsageError(f"{path} has no transparency; erase the opening of the gate and save 8-bit PNG with alpha")
    height, width = found.shape[:2]
    count, _, boxes, _ = cv2.connectedComponentsWithStats((found[..., 3] < OPEN).astype(np.uint8))
    inner = [
        box
        for box in boxes[1:count]
        if box[0] > 0 and box[1] > 0 and box[0] + box[2] < width and box[1] + box[3] < height and min(box[2:4]) > 7
    ]
    if not inner:
        raise UsageError(f"{path} has no transparent opening inside the frame; erase the opening and save it again")
    x, y, wide, tall, _ = (int(v) for v in max(inner, key=lambda box: box[4]))
    return PictureGate(found, (x, y, x + wide, y + tall))
