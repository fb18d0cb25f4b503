"""Frames to label: the images of a folder, or images of a bag that are written to a folder with what it knows."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.files.images import image_files
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.camera import from_image
from swift_ros.messages.motion import from_odometry
from swift_ros.messages.stamps import message_stamp_ns
from swift_ros.recording import bags
from swift_ros.timeline import Timeline
from swift_ros.track import Track
from swift_ros.types import Odometry
from swift_sim_bridge.labels import coco, folder
from swift_sim_bridge.labels.labelled_images import LabelledImage

FRAMES = "frames.json"  # attitudes, stamps and sequences of the images that were written from bags
IMAGES = "images"  # folder of these images
IMAGE, RAW = "camera/image_raw", "vio/raw"
TRUTH = "ground_truth/odometry"  # of the simulator or of motion capture
MAP_POSES = (TRUTH, "state/odometry")  # poses in the map, the best first
ATTITUDES = (*MAP_POSES, "vio/odometry", RAW)  # all have z up
WITHOUT_MAP = "none"
WHOLE_FLIGHT_S = 1e9


@dataclass(frozen=True)
class Flight:
    """What a bag knows about its frames.

    Attributes:
        track: the gates of the map.
        poses: of the vehicle in the map, by the file name of the frame.
        topic: from which the poses come.
    """

    track: Track
    poses: dict[str, Odometry]
    topic: str

    @property
    def is_true(self) -> bool:
        """The poses are ground truth or motion capture."""
        return self.topic == TRUTH


@dataclass(frozen=True)
class Frames:
    """Frames to label, and where they are.

    Attributes:
        path: of the folder.
        images: without gates.
        lens: of `camera.yaml`; None where the field of view is assumed.
        fov_deg: assumed field of view of a pinhole lens, degrees.
        flight: what the bag knows; None for a folder, and without poses in the map.
    """

    path: Path
    images: list[LabelledImage]
    lens: Camera | None
    fov_deg: float | None = None
    flight: Flight | None = None

    def labelled(self) -> dict[str, LabelledImage]:
        """Return the images that `labels.json` holds, by file name. Raises UsageError when it is damaged."""
        file = self.path / folder.LABELS
        return {image.file_name: image for image in coco.read(file)} if file.is_file() else {}

    def with_labels(self) -> folder.LabelledFolder:
        """Return the folder with all its frames."""
        return folder.LabelledFolder(self.path, tuple(self.images), self.lens, self.fov_deg)


def of_folder(path: Path, fov_deg: float | None) -> Frames:
    """Return the images of a folder. What its labels and `frames.json` say about them is kept. Raises UsageError."""
    lens, known = folder.read_lens(path, fov_deg), {}
    for name in (FRAMES, folder.LABELS):
        if (path / name).is_file():
            known |= {image.file_name: image for image in coco.read(path / name)}
    images = []
    for file in image_files(path, "give a folder of images or a bag"):
        name = file.relative_to(path).as_posix()
        if name in known:
            images.append(replace(known[name], gates=(), source=""))
        else:
            height, width = folder.read_pixels(file).shape
            images.append(LabelledImage(name, width, height))
    frames = Frames(path, images, lens, fov_deg)
    cameras = frames.with_labels()
    for image in images:
        cameras.camera(image)
    return frames


@dataclass(frozen=True)
class BagFrames:
    """Which frames of a bag are labelled.

    Attributes:
        every: each how many-th image.
        poses: topic of the poses in the map; None for the best that the bag has; WITHOUT_MAP.
        config: folder of camera and track; None for those that the bag stores.
    """

    every: int = 10
    poses: str | None = None
    config: Path | None = None


def of_bag(bag: Path, out: Path, wanted: BagFrames, progress: Callable[[int], None] | None = None) -> Frames:
    """Write frames of a bag to a folder, and return them. Frames that are there already are kept.

    Args:
        bag: the recording.
        out: the folder.
        wanted: which frames.
        progress: called with the number of frames after each.

    Raises:
        UsageError: the bag has no images, or none of a topic that is asked for.
    """
    if wanted.every < 1:
        raise UsageError(f"--every {wanted.every} is no number of images; give 1 or more")
    bags.require(bag, full_name(IMAGE))
    camera = _stored(bag, Camera, folder.CAMERA, wanted.config)
    attitudes = _first_timeline(bag, ATTITUDES)[1]
    topic, poses = _map_poses(bag, wanted.poses)
    sequence = bag.resolve().parent.name if bag.name in ("bag", "bag_0.mcap") else bag.stem
    (out / IMAGES).mkdir(parents=True, exist_ok=True)
    images, known = [], {}
    for number, (_, message, _) in enumerate(bags.read(bag, [full_name(IMAGE)])):
        if number % wanted.every:
            continue
        stamp_ns = message_stamp_ns(message)
        image = _write_frame(message, out, f"{IMAGES}/{sequence}_{stamp_ns}.png", camera)
        state, pose = attitudes.at(stamp_ns), poses.at(stamp_ns)
        values = {"sequence": sequence, "stamp_s": stamp_ns / 1e9}
        if state is not None:
            q_world_body = geometry.normalize(state.q_world_body)
            values["q_world_camera"] = geometry.quaternion_multiply(q_world_body, camera.q_body_camera)
        images.append(LabelledImage(image, camera.width, camera.height, **values))
        if pose is not None:
            known[image] = pose
        if progress:
            progress(len(images))
    folder.write_camera(out, camera)
    others = coco.read(out / FRAMES) if (out / FRAMES).is_file() else []
    names = {image.file_name for image in images}
    coco.write(out / FRAMES, [image for image in others if image.file_name not in names] + images)
    flight = Flight(_stored(bag, Track, "track.yaml", wanted.config), known, topic) if topic else None
    return Frames(out, images, camera, flight=flight)


def _stored(bag: Path, kind, name: str, config: Path | None):
    """Return a file of the configuration: of the folder, or as the bag stores it. Raises UsageError."""
    return configuration.load(kind, config / name) if config else bags.stored_record(bag, kind, name)


def _map_poses(bag: Path, wanted: str | None) -> tuple[str, Timeline]:
    """Return the topic of poses in the map, "" without one, and its poses. Raises UsageError."""
    if wanted == WITHOUT_MAP:
        return "", Timeline(WHOLE_FLIGHT_S)
    if wanted and wanted not in MAP_POSES:
        raise UsageError(f"--poses {wanted} is no topic of poses in the map; give {', '.join(MAP_POSES)} or none")
    if wanted:
        bags.require(bag, full_name(wanted))
    return _first_timeline(bag, (wanted,) if wanted else MAP_POSES)


def _first_timeline(bag: Path, candidates) -> tuple[str, Timeline]:
    """Return the first topic that the bag has, "" for none, and its odometry."""
    present, timeline = bags.topic_types(bag), Timeline(WHOLE_FLIGHT_S)
    topic = next((name for name in candidates if full_name(name) in present), "")
    for _, message, _ in bags.read(bag, [full_name(topic)]) if topic else ():
        state = from_odometry(message)
        newest_ns = timeline.newest.stamp_ns if timeline.newest else -1
        if state.stamp_ns > newest_ns and np.isfinite([*state.q_world_body, *state.p_world]).all():
            timeline.add(state)
    return topic, timeline


def _write_frame(message, out: Path, name: str, camera: Camera) -> str:
    """Write an image message as PNG and return its name. Raises UsageError when it is not of the camera's size."""
    try:
        pixels = from_image(message)
    except ValueError as error:
        raise UsageError(f"{name}: {error}") from error
    if pixels.shape != (camera.height, camera.width):
        raise UsageError(
            f"the bag's images have {pixels.shape[1]} x {pixels.shape[0]} px, its {folder.CAMERA} is of "
            f"{camera.width} x {camera.height} px; give the right one with --config DIR"
        )
    if not (out / name).is_file():
        cv2.imwrite(str(out / name), pixels)
    return name
