"""Pictures that the user gives: photographs as backgrounds, and own gates."""

import functools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from swift_ros.errors import UsageError
from swift_ros.files.images import image_files

MAX_PX = 960  # longer side of a photograph in memory
OPEN = 128  # opacity, of 255, below which a pixel of an own gate is open


@dataclass(frozen=True)
class OwnGate:
    """The frontal picture of a gate.

    Attributes:
        picture: (h, w, 4) uint8, blue, green, red, opacity.
        opening: (x0, y0, x1, y1) px, end exclusive.
    """

    picture: np.ndarray
    opening: tuple[int, int, int, int]


@dataclass(frozen=True)
class Pictures:
    """What composites take from pictures.

    Attributes:
        photographs: files, read when they are drawn.
        own_gates: frontal pictures of gates.
    """

    photographs: tuple[Path, ...] = ()
    own_gates: tuple[OwnGate, ...] = ()


def read(photographs: Path | None = None, own_gates: Path | None = None) -> Pictures:
    """Return the pictures in folders.

    Args:
        photographs: folder, with all folders below it, of images without gates.
        own_gates: folder of PNG files, each a frontal picture of a gate; opening and surroundings are transparent.

    Raises:
        UsageError: a folder has no picture, or one cannot be used.
    """
    files = image_files(photographs) if photographs else []
    for file in files:
        _readable(file, cv2.IMREAD_REDUCED_GRAYSCALE_8)
    gates = [own_gate(file) for file in image_files(own_gates, suffixes=(".png",))] if own_gates else []
    return Pictures(tuple(files), tuple(gates))


def photograph(path: Path) -> np.ndarray:
    """Return a photograph (h, w, 3) uint8, blue first, of at most MAX_PX. Raises UsageError if it is damaged."""
    return cv2.imdecode(np.frombuffer(_reduced(path), np.uint8), cv2.IMREAD_COLOR)


@functools.lru_cache(maxsize=2000)
def _reduced(path: Path) -> bytes:
    """Return a photograph as a small JPEG file, which is read ten times faster."""
    found = _readable(path, cv2.IMREAD_COLOR)
    share = MAX_PX / max(found.shape)
    if share < 1:
        found = cv2.resize(found, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", found, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


def _readable(path: Path, flags: int) -> np.ndarray:
    found = cv2.imread(str(path), flags)
    if found is None:
        raise UsageError(f"{path} is not a readable picture; restore it or remove it from its folder")
    return found


def own_gate(path: Path) -> OwnGate:
    """Return the gate of a PNG file; its opening is the largest transparent area that does not touch the edge.

    Raises:
        UsageError: it is damaged, is not transparent, or has no opening.
    """
    found = _readable(path, cv2.IMREAD_UNCHANGED)
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
    return OwnGate(found, (x, y, x + wide, y + tall))
