"""Write the intrinsics of a calibration file (Kalibr, ROS camera_info, OpenCV) into a camera.yaml."""

import dataclasses
import math
from pathlib import Path

import yaml

from swift_ros import configuration
from swift_ros.errors import UsageError

NAME = "camera.yaml"


def command(subparsers) -> None:
    """Add the parser of `swiftros calibration`."""
    parser = subparsers.add_parser("calibration", help=__doc__, description=__doc__)
    parser.add_argument("file", type=Path, help="file of the calibration")
    parser.add_argument("--camera", type=int, default=0, metavar="N", help="cam0, cam1... of Kalibr (default: 0)")
    parser.add_argument("--size", metavar="WxH", help="of the stack's images, px: cropped and scaled calibrated ones")
    parser.add_argument("--config", metavar="DIR", help=f"folder of the {NAME} whose other keys are kept")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=f"the new {NAME}")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Convert. Return 0. Raises UsageError on bad input."""
    from swift_ros.camera.calibration_files import fitted, read_calibration  # imports OpenCV
    from swift_ros.camera.model import Camera

    found = read_calibration(arguments.file, arguments.camera)
    found = fitted(found, *_size(arguments.size)) if arguments.size else found
    kept = configuration.read_yaml(configuration.configuration_folder(arguments.config) / NAME)
    kept.pop("image_circle_deg", None)  # of the lens that was there before
    intrinsics = dataclasses.asdict(found) | {"distortion": list(found.distortion)}
    camera = configuration.build(Camera, kept | intrinsics, str(arguments.file))
    if arguments.out.exists():
        raise UsageError(f"{arguments.out} exists; give another --out or move it away")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(yaml.safe_dump(kept | intrinsics, sort_keys=False))
    view_deg = math.degrees(2 * camera.half_angle)
    print(f"{camera.model}, {camera.width} x {camera.height} px, {view_deg:.0f} degrees -> {arguments.out}")
    print("kept: position, pitch, rate, exposure and latency; correct them for your camera")
    return 0


def _size(text: str) -> tuple[int, int]:
    """Return width and height of a text such as 384x384."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) for part in parts):
        raise UsageError(f"--size {text} is not two numbers of pixels such as 384x384")
    return int(parts[0]), int(parts[1])
