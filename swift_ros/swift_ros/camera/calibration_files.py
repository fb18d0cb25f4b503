"""Reads the intrinsics of a camera from calibration files of Kalibr, ROS (camera_info) and OpenCV.

Kalibr's coefficients have the order of ours. OpenCV's own files are YAML, XML or JSON, by `cv2.FileStorage`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from swift_ros.camera.lens import DOUBLE_SPHERE, KANNALA_BRANDT, LENSES, PINHOLE
from swift_ros.camera.model import Intrinsics
from swift_ros.errors import UsageError
from swift_ros.files.yaml_text import parse_yaml
from swift_ros.text import described

KALIBR_LENSES = {("pinhole", "radtan"): PINHOLE, ("pinhole", "none"): PINHOLE, ("ds", "none"): DOUBLE_SPHERE}
KALIBR_LENSES[("pinhole", "equidistant")] = KANNALA_BRANDT
ROS_LENSES = {"plumb_bob": PINHOLE, "rational_polynomial": PINHOLE, "equidistant": KANNALA_BRANDT}
ADVICE = "calibrate with a pinhole, equidistant (Kannala-Brandt) or double-sphere model"


@dataclass(frozen=True)
class Calibration(Intrinsics):
    """Intrinsics of a camera with the model of its lens, one of `lens.LENSES`."""

    model: str


def read_calibration(path: Path, camera: int = 0) -> Calibration:
    """Return the calibration in a file.

    Args:
        path: of the file.
        camera: number of the camera in a file of Kalibr.

    Raises:
        UsageError: the file is none of the formats, or its lens is not supported.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read as a text; give the file that the calibration wrote") from error
    if text.lstrip().startswith(("<?xml", "{")) or "!!opencv-matrix" in text:
        return _opencv(path)
    content = parse_yaml(text, str(path), "give the file that the calibration wrote")
    try:
        if isinstance(content, dict) and "camera_matrix" in content:
            return _ros(path, content)
        if isinstance(content, dict) and f"cam{camera}" in content:
            return _kalibr(path, content[f"cam{camera}"])
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(
            f"{path} lacks a value of a calibration, or has a wrong one: {described(str(error))}"
        ) from error
    raise UsageError(f"{path} holds no camera {camera} of Kalibr, no camera_info of ROS and no matrices of OpenCV")


def fitted(calibration: Calibration, width: int, height: int) -> Calibration:
    """Return the calibration of images that were cropped and scaled to a size as by `picture.fit_to`."""
    scale = min(calibration.width / width, calibration.height / height)
    crop = round(scale * width), round(scale * height)
    left, top = (calibration.width - crop[0]) // 2, (calibration.height - crop[1]) // 2
    across, down = crop[0] / width, crop[1] / height
    return replace(
        calibration,
        width=width,
        height=height,
        fx=calibration.fx / across,
        fy=calibration.fy / down,
        cx=(calibration.cx - left + 0.5) / across - 0.5,
        cy=(calibration.cy - top + 0.5) / down - 0.5,
    )


def _kalibr(path: Path, content: dict) -> Calibration:
    names = content["camera_model"], content.get("distortion_model", "none")
    if names not in KALIBR_LENSES:
        raise UsageError(f"{path}: the lens {' with '.join(map(str, names))} is not supported; {ADVICE}")
    numbers, model = [float(value) for value in content["intrinsics"]], KALIBR_LENSES[names]
    distortion = numbers[:-4] if model == DOUBLE_SPHERE else content.get("distortion_coeffs", [])
    return _checked(path, content["resolution"], numbers[-4:], model, distortion)


def _ros(path: Path, content: dict) -> Calibration:
    name = content.get("distortion_model", "plumb_bob")
    if name not in ROS_LENSES:
        raise UsageError(f"{path}: the lens {described(name)} is not supported; {ADVICE}")
    matrix = np.array(content["camera_matrix"]["data"], dtype=float).reshape(3, 3)
    size = content["image_width"], content["image_height"]
    return _checked(path, size, _focal(matrix), ROS_LENSES[name], content["distortion_coefficients"]["data"])


def _opencv(path: Path) -> Calibration:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        names = (("camera_matrix", "cameraMatrix"), ("distortion_coefficients", "distCoeffs"))
        matrix, distortion = (_first(storage, options).mat() for options in names)
        size = [int(_first(storage, options).real()) for options in (("image_width",), ("image_height",))]
        fisheye = "fisheye" in storage.getNode("flags_description").string() or _is_set(storage, "fisheye_model")
    finally:
        storage.release()
    if matrix is None or distortion is None or not all(size):
        raise UsageError(f"{path} lacks camera_matrix, distortion_coefficients, image_width or image_height")
    model = KANNALA_BRANDT if fisheye else PINHOLE
    return _checked(path, size, _focal(matrix), model, distortion.ravel())


def _first(storage, names):
    """Return the first node of the names that a file has."""
    nodes = [storage.getNode(name) for name in names]
    return next((node for node in nodes if not node.empty()), nodes[0])


def _is_set(storage, name: str) -> bool:
    node = storage.getNode(name)
    return not node.empty() and node.real() != 0


def _focal(matrix) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a camera matrix (3, 3)."""
    return matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]


def _checked(path: Path, size, focal, model: str, distortion) -> Calibration:
    values = [float(value) for value in (*focal, *distortion)]
    if len(focal) != 4 or not np.isfinite(values).all():
        raise UsageError(f"{path} has an intrinsic or a coefficient that is not a number")
    coefficients = tuple(values[4:])
    while len(coefficients) not in LENSES[model].counts and coefficients and coefficients[-1] == 0.0:
        coefficients = coefficients[:-1]  # OpenCV fills up with zeros: thin prism and tilt
    if len(coefficients) not in LENSES[model].counts:
        counts = " or ".join(map(str, LENSES[model].counts))
        raise UsageError(f"{path}: a {model} lens has {counts} coefficients, not {len(coefficients)}; {ADVICE}")
    width, height = (int(value) for value in size)
    fx, fy, cx, cy = values[:4]
    return Calibration(width, height, fx, fy, cx, cy, coefficients, model)
