"""Image sources: a V4L2 device, a video file, an image folder, or a RealSense T265.

A source has a method `read()`, which returns the next picture in the format of `config/camera.yaml`, None after the
last one, and a method `close()`.
"""

import re
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from swift_ros.camera.model import Camera
from swift_ros.camera.picture import MAX_AGE_S, Picture, fit_to
from swift_ros.camera.t265 import T265
from swift_ros.configuration import refuse_outside, setting
from swift_ros.errors import UsageError

KINDS = ("v4l2", "video", "folder", "t265")
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")
MAX_DELAY_S = 1.0  # s; a file that is late by more does not make up the rest by playing faster


@dataclass(frozen=True)
class CameraSettings:
    """Settings of the node camera."""

    kind: str = setting("v4l2, video, folder or t265")
    path: str = setting("device (/dev/video0), video file or image folder; unused for t265")
    repeat: bool = setting("start files again at their end")

    def __post_init__(self):
        refuse_outside(KINDS, kind=self.kind)
        if not self.path and self.kind != "t265":
            raise ValueError(f"'path' is empty; name the device, file or folder of the kind {self.kind}")


def open_source(settings: CameraSettings, camera: Camera, on_odometry=None):
    """Return the source that the settings select.

    Args:
        settings: of the node camera.
        camera: format of the pictures.
        on_odometry: called by a T265 as `on_odometry(age_s, Odometry)`.

    Raises:
        UsageError: the device, file or library does not exist.
    """
    if settings.kind == "t265":
        return T265(camera, on_odometry)
    if settings.kind == "v4l2":
        return Device(settings.path, camera)
    pictures = Video(settings.path) if settings.kind == "video" else Folder(settings.path)
    return Paced(pictures, camera, settings.repeat)


class Device:
    """A V4L2 camera. The kernel stamps frames on the monotonic clock; a frame without a valid stamp has age 0."""

    def __init__(self, path: str, camera: Camera):
        self._camera = camera
        number = re.fullmatch(r"(?:/dev/video)?(\d+)", path)
        self._capture = cv2.VideoCapture(int(number[1]) if number else path, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise UsageError(f"the camera device {path} cannot be opened; see `ls /dev/video*` and the setting 'path'")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def read(self) -> Picture | None:
        """Return the next picture; None when the device was disconnected."""
        good, image = self._capture.read()
        if not good:
            return None
        age_s = time.monotonic() - self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        return Picture(fit_to(self._camera, image), age_s if 0.0 <= age_s < MAX_AGE_S else 0.0)

    def close(self):
        """Release the device or file."""
        self._capture.release()


class Video:
    """The frames of a video file."""

    def __init__(self, path: str):
        self.name = f"the video {path}"
        self._path = path
        if not Path(path).is_file():
            raise UsageError(f"{self.name} does not exist; correct the setting 'path' of the node camera")
        self.rewind()

    def rewind(self):
        """Start again. Raises UsageError when the file cannot be decoded."""
        self._capture = cv2.VideoCapture(self._path)
        if not self._capture.isOpened():
            raise UsageError(
                f"{self.name} cannot be decoded; convert it to a format that OpenCV supports, such as MJPG in AVI"
            )

    def next(self) -> np.ndarray | None:
        """Return the next image, None after the last."""
        good, image = self._capture.read()
        return image if good else None

    def close(self):
        """Release the device or file."""
        self._capture.release()


class Folder:
    """The images of a folder in the order of the numbers in their names."""

    def __init__(self, path: str):
        self.name = f"the image folder {path}"
        if not Path(path).is_dir():
            raise UsageError(f"{self.name} does not exist; correct the setting 'path' of the node camera")
        self._files = sorted((f for f in Path(path).iterdir() if f.suffix.lower() in IMAGE_SUFFIXES), key=_by_number)
        if not self._files:
            raise UsageError(f"{self.name} holds no image ({', '.join(IMAGE_SUFFIXES)})")
        self.rewind()

    def rewind(self):
        """Start again."""
        self._remaining = iter(self._files)

    def next(self) -> np.ndarray | None:
        """Return the next image (h, w, 3), None after the last. Raises UsageError for a file that is not an image."""
        file = next(self._remaining, None)
        if file is None:
            return None
        image = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if image is None:
            raise UsageError(f"{file} is not a readable image; remove it from the folder")
        return image

    def close(self):
        """Do nothing: no file stays open."""


class Paced:
    """Pictures of files at the camera's rate."""

    def __init__(self, pictures, camera: Camera, repeat: bool):
        self._pictures = pictures
        self._camera = camera
        self._repeat = repeat
        self._due = time.monotonic()

    def read(self) -> Picture | None:
        """Return the next picture when it is due; None after the last, unless it repeats."""
        image = self._pictures.next()
        if image is None and self._repeat:
            self._pictures.rewind()
            image = self._pictures.next()
        if image is None:
            return None
        image = fit_to(self._camera, image)
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = max(self._due, time.monotonic() - MAX_DELAY_S) + 1.0 / self._camera.rate_hz
        return Picture(image, 0.0)

    def close(self):
        """Close the files."""
        self._pictures.close()


def _by_number(file: Path):
    """Return the key that sorts file names by the numbers in them."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
