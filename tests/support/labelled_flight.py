"""A bag of a short flight towards the first gate, with images, true poses, and an estimate that drifts at its end."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros.camera import model as lens
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.camera import to_image
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.serialization import serialize
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.recording.writer import provenance
from swift_ros.types import Odometry
from swift_sim_bridge.gate_detector.evaluation.setup import DetectorSetup
from swift_sim_bridge.rendering.renderer import Renderer

FRAMES, PERIOD_NS = 8, 100_000_000
STEP_M = 0.3  # of the vehicle between two images
SOUND_FRAMES = 5  # after these the estimate is off
DRIFT_M = np.array([0.0, 0.6, 0.2])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
TRUTH, ESTIMATE, IMAGE = "ground_truth/odometry", "state/odometry", "camera/image_raw"
TYPES = {TRUTH: "nav_msgs/msg/Odometry", ESTIMATE: "nav_msgs/msg/Odometry", IMAGE: "sensor_msgs/msg/Image"}


@dataclass(frozen=True)
class PlantedFlight:
    """A bag, and the true corners (4, 2) px of its first gate in each image."""

    bag: Path
    corners_px: list[np.ndarray]


def record(folder: Path, setup: DetectorSetup, config: Path) -> PlantedFlight:
    """Render and record the flight."""
    renderer = Renderer(setup.camera, setup.track, setup.looks, 1003)
    writer, corners = BagWriter(folder, provenance(config)), []
    for topic, kind in TYPES.items():
        writer.add_topic(full_name(topic), kind)
    for number in range(FRAMES):
        stamp_ns = (number + 1) * PERIOD_NS
        position = setup.track.positions[0] - [6.0 - STEP_M * number, 0.4, -0.3]
        image = renderer.render(position, LEVEL, np.zeros(3), np.zeros(3))
        estimate = position + (DRIFT_M if number >= SOUND_FRAMES else 0.0)
        for topic, p_world in ((TRUTH, position), (ESTIMATE, estimate)):
            state = Odometry(stamp_ns, p_world, LEVEL, np.zeros(3), np.zeros(3))
            writer.write(full_name(topic), serialize(to_odometry(state, "map")), stamp_ns)
        writer.write(full_name(IMAGE), serialize(to_image(image, stamp_ns)), stamp_ns)
        rays = lens.world_to_camera(setup.camera, position, LEVEL, setup.track.corners[0])
        corners.append(lens.project(setup.camera, rays)[0])
    writer.close()
    return PlantedFlight(folder, corners)
