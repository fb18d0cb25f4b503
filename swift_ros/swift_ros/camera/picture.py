"""A picture: an image in the format of `config/camera.yaml`, with its age."""

from dataclasses import dataclass

import cv2
import numpy as np

from swift_ros.camera.grey import grey_levels
from swift_ros.camera.model import Camera

MAX_AGE_S = 1.0  # s; a driver that reports a greater age of an image uses another clock


@dataclass(frozen=True)
class Picture:
    """An image of the camera.

    Attributes:
        image: grey levels (H, W) uint8, in the format of `config/camera.yaml`.
        age_s: time since the exposure, s.
    """

    image: np.ndarray
    age_s: float


def fit_to(camera: Camera, image: np.ndarray) -> np.ndarray:
    """Crop an image to the camera's aspect ratio, centred, and scale it to the camera's size.

    The T265's 848 x 800 px are cropped to 800 x 800 px and scaled to 384 x 384 px; `camera.yaml` is the calibration of
    the result.

    Args:
        camera: the camera.
        image: (h, w) grey, or (h, w, 3) BGR.

    Returns:
        Grey levels (H, W) uint8.
    """
    image = grey_levels(image)
    height, width = image.shape
    scale = min(width / camera.width, height / camera.height)
    crop_width, crop_height = round(scale * camera.width), round(scale * camera.height)
    left, top = (width - crop_width) // 2, (height - crop_height) // 2
    crop = image[top : top + crop_height, left : left + crop_width]
    if crop.shape == (camera.height, camera.width):
        return np.ascontiguousarray(crop)
    interpolation = cv2.INTER_AREA if scale > 1.0 else cv2.INTER_LINEAR
    return cv2.resize(crop, (camera.width, camera.height), interpolation=interpolation)
