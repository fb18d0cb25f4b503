"""A folder of labelled images: `labels.json`, the images, and `camera.yaml`, the lens that took them."""

from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

from swift_ros import configuration
from swift_ros.camera.grey import grey_levels
from swift_ros.camera.lens import PINHOLE
from swift_ros.camera.model import Camera, Intrinsics
from swift_ros.errors import UsageError
from swift_sim_bridge.labels import coco
from swift_sim_bridge.labels.labelled_images import LabelledImage

LABELS, CAMERA = "labels.json", "camera.yaml"
FOV_LIMITS_DEG = (5.0, 150.0)  # of an assumed pinhole lens; a wider one needs its calibration


@dataclass(frozen=True)
class LabelledFolder:
    """Labelled images, whose pixels are read when they are needed.

    Attributes:
        path: of the folder.
        images: in the order of the file. Images of the folder that are not in it are not labelled.
        lens: of `camera.yaml`; None where the field of view is assumed.
        fov_deg: assumed horizontal field of view of a pinhole lens, degrees; None with `camera.yaml`.
    """

    path: Path
    images: tuple[LabelledImage, ...]
    lens: Camera | None
    fov_deg: float | None = None

    def camera(self, image: LabelledImage) -> Camera:
        """Return the camera of an image. Raises UsageError when `camera.yaml` is of images of another size."""
        if self.lens is None:
            return pinhole(image.width, image.height, self.fov_deg or 0.0)
        if (self.lens.width, self.lens.height) != (image.width, image.height):
            raise UsageError(
                f"{self.path / CAMERA} is of images of {self.lens.width} x {self.lens.height} px, {image.file_name} "
                f"has {image.width} x {image.height} px; give images of one camera"
            )
        return self.lens

    def pixels(self, image: LabelledImage) -> np.ndarray:
        """Return the grey levels (H, W) uint8 of an image. Raises UsageError when the file is damaged."""
        return grey_levels(self.colours(image))

    def colours(self, image: LabelledImage) -> np.ndarray:
        """Return an image (H, W, 3) uint8, blue first. Raises UsageError when the file is damaged."""
        found = _read_colours(self.path / image.file_name)
        if found.shape[:2] != (image.height, image.width):
            raise UsageError(
                f"{self.path / image.file_name} has {found.shape[1]} x {found.shape[0]} px, {LABELS} says "
                f"{image.width} x {image.height} px"
            )
        return found


def read(path: Path, fov_deg: float | None = None) -> LabelledFolder:
    """Return the labelled images of a folder.

    Args:
        path: folder with `labels.json`.
        fov_deg: horizontal field of view of a pinhole lens that is assumed instead of `camera.yaml`, degrees.

    Raises:
        UsageError: a file is missing or wrong; it names the file and the image.
    """
    if not (path / LABELS).is_file():
        raise UsageError(f"{path} holds no {LABELS}; label its images with `swiftros label {path}`")
    images = coco.read(path / LABELS)
    if not images:
        raise UsageError(f"{path / LABELS} lists no image; label some with `swiftros label {path}`")
    for image in images:
        if not (path / image.file_name).is_file():
            raise UsageError(f"{path / LABELS} lists the image {image.file_name}, which is missing in {path}")
    folder = LabelledFolder(path, tuple(images), read_lens(path, fov_deg), fov_deg)
    for image in images:
        folder.camera(image)
    return folder


def write(path: Path, images: list[LabelledImage], camera: Camera | None = None) -> None:
    """Write `labels.json`, whole or not at all, and `camera.yaml` where a camera is given. Raises UsageError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error
    if camera:
        write_camera(path, camera)
    coco.write(path / LABELS, images)


def write_camera(path: Path, camera: Camera) -> None:
    """Write the `camera.yaml` of a folder. Raises UsageError where it cannot be written."""
    values = {name: value for name, value in asdict(camera).items() if value is not None}
    values["distortion"], values["position"] = list(camera.distortion), list(camera.position)
    coco.replace_text(path / CAMERA, yaml.safe_dump(values, sort_keys=False))


def read_lens(path: Path, fov_deg: float | None) -> Camera | None:
    """Return the camera of a folder's `camera.yaml`, None with an assumed field of view. Raises UsageError."""
    if fov_deg is not None:
        low, high = FOV_LIMITS_DEG
        if not low <= fov_deg <= high:
            raise UsageError(f"--fov-deg {fov_deg:g} is no field of view of a pinhole lens; give {low:g} to {high:g}")
        return None
    if not (path / CAMERA).is_file():
        raise UsageError(
            f"{path} holds no {CAMERA}; write one with `swiftros calibration FILE --out {path / CAMERA}`, or give "
            "--fov-deg, the horizontal field of view of a lens without distortion"
        )
    return configuration.load(Camera, path / CAMERA)


def pinhole(width: int, height: int, fov_deg: float) -> Camera:
    """Return a level camera without distortion, with a horizontal field of view (degrees), for images of a size."""
    focal_px = float(0.5 * width / np.tan(np.radians(0.5 * fov_deg)))
    return level_camera(
        Intrinsics(width, height, focal_px, focal_px, 0.5 * (width - 1), 0.5 * (height - 1), ()), PINHOLE
    )


def level_camera(lens: Intrinsics, model: str, image_circle_deg: float | None = None) -> Camera:
    """Return a camera of which only the lens matters: it is level, at the body's origin, and its times are typical."""
    return Camera(
        **vars(lens),
        position=(0.0, 0.0, 0.0),
        pitch_deg=0.0,
        rate_hz=30.0,
        exposure_s=0.005,
        processing_latency=0.04,
        model=model,
        image_circle_deg=image_circle_deg,
    )


def read_pixels(path: Path) -> np.ndarray:
    """Return the grey levels (H, W) uint8 of an image file as `grey_levels` has them, turned upright by its Exif data.

    Raises:
        UsageError: it is damaged.
    """
    return grey_levels(_read_colours(path))


def _read_colours(path: Path) -> np.ndarray:
    found = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if found is None:
        raise UsageError(f"{path} is not a readable image; restore it or remove it from {LABELS}")
    return found
