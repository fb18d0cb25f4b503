"""Pictures that the user gives: photographs as backgrounds, and own gates."""

import functools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from swift_ros.errors import UsageError
from swift_ros.files.images import image_files
from swift_sim_bridge.gate_detector.images.own_gates.opening import MeshGate
from swift_sim_bridge.gate_detector.images.own_gates.picture import PictureGate

MAX_PX = 960  # longer side of a photograph in memory


@dataclass(frozen=True)
class Pictures:
    """What composites take from pictures.

    Attributes:
        photographs: files, read when they are drawn.
        own_gates: the user's gates.
    """

    photographs: tuple[Path, ...] = ()
    own_gates: tuple[PictureGate | MeshGate, ...] = ()


def read(photographs: Path | None = None, own_gates: tuple[PictureGate | MeshGate, ...] = ()) -> Pictures:
    """Return pictures for composites.

    Args:
        photographs: folder, with all folders below it, of images without gates.
        own_gates: the user's gates.

    Raises:
        UsageError: the folder has no picture, or one cannot be used.
    """
    files = image_files(photographs) if photographs else []
    for file in files:
        _readable(file, cv2.IMREAD_REDUCED_GRAYSCALE_8)
    return Pictures(tuple(files), own_gates)


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
