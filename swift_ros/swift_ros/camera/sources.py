"""Where images come from: a V4L2 device, a video file, an image folder, or a RealSense T265.

A source gives pictures one after the other, cut and scaled to the camera of `config/camera.yaml`, grey, each with its
age: how long ago it was taken. It ends with None.
"""

import re
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from swift_ros.camera.model import Camera
from swift_ros.configuration import setting
from swift_ros.errors import UsageError

KINDS = ("v4l2", "video", "folder", "t265")
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")
OLDEST_S = 1.0  # a driver that claims more is on another clock


@dataclass(frozen=True)
class CameraSettings:
    kind: str = setting("v4l2, video, folder or t265")
    path: str = setting("device (/dev/video0), video file or image folder; nothing for t265")
    repeat: bool = setting("files begin again at their end")

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"'kind' must be one of {', '.join(KINDS)}, not '{self.kind}'")


@dataclass(frozen=True)
class Picture:
    """image (H, W) uint8, grey, in the format of `config/camera.yaml`; age_s: how long ago it was taken, s."""

    image: np.ndarray
    age_s: float


def open_source(settings: CameraSettings, camera: Camera, hear_odometry=None):
    """Return the source the settings name: `read() -> Picture | None`, `close()`. A T265 also calls
    `hear_odometry(age_s, Odometry)`. Raises UsageError when there is no such device, file or library."""
    if settings.kind == "t265":
        from swift_ros.camera.t265 import T265

        return T265(camera, hear_odometry)
    if settings.kind == "v4l2":
        return Device(settings.path, camera)
    pictures = Video(settings.path) if settings.kind == "video" else Folder(settings.path)
    return Paced(pictures, camera, settings.repeat)


def fit_to(camera: Camera, image: np.ndarray) -> np.ndarray:
    """Return the middle of an image (h, w) or (h, w, 3 BGR) with the camera's proportions, scaled to it, grey uint8.

    The T265's 848 x 800 becomes 800 x 800 becomes 384 x 384; `camera.yaml` is the calibration of the result.
    """
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    height, width = image.shape
    scale = min(width / camera.width, height / camera.height)
    cut_width, cut_height = round(scale * camera.width), round(scale * camera.height)
    left, top = (width - cut_width) // 2, (height - cut_height) // 2
    cut = image[top : top + cut_height, left : left + cut_width]
    if cut.shape == (camera.height, camera.width):
        return np.ascontiguousarray(cut)
    shrinks = scale > 1.0
    return cv2.resize(cut, (camera.width, camera.height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


class Device:
    """A V4L2 camera. The kernel stamps each frame on the monotonic clock; what it does not stamp is taken as new."""

    def __init__(self, path: str, camera: Camera):
        self._camera = camera
        number = re.fullmatch(r"(?:/dev/video)?(\d+)", path)
        self._capture = cv2.VideoCapture(int(number[1]) if number else path, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise UsageError(f"the camera device {path} cannot be opened; see `ls /dev/video*` and the setting 'path'")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def read(self) -> Picture | None:
        """Return the next picture; None when the device has gone."""
        good, image = self._capture.read()
        if not good:
            return None
        age_s = time.monotonic() - self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        return Picture(fit_to(self._camera, image), age_s if 0.0 <= age_s < OLDEST_S else 0.0)

    def close(self):
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
        self._capture = cv2.VideoCapture(self._path)
        if not self._capture.isOpened():
            raise UsageError(f"{self.name} cannot be decoded; convert it to one that OpenCV reads, such as MJPG in AVI")

    def next(self) -> np.ndarray | None:
        good, image = self._capture.read()
        return image if good else None

    def close(self):
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
        self._left = iter(self._files)

    def next(self) -> np.ndarray | None:
        """Return the next image, None after the last. Raises UsageError naming a file that is none."""
        file = next(self._left, None)
        if file is None:
            return None
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise UsageError(f"{file} is not an image that can be read; take it out of the folder")
        return image

    def close(self):
        pass


class Paced:
    """A file's pictures at the camera's rate: none early, and none twice to catch up."""

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
        self._due = max(self._due, time.monotonic() - 1.0) + 1.0 / self._camera.rate_hz
        return Picture(image, 0.0)

    def close(self):
        self._pictures.close()


def _by_number(file: Path):
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
