"""The gate detector as it flies, with all that its evaluation needs, from a configuration folder."""

from dataclasses import dataclass
from pathlib import Path

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.perception.corner_grouping import GroupingSettings
from swift_ros.perception.corner_network import CornerNetwork
from swift_ros.perception.gate_detector import GateDetector
from swift_ros.perception.settings import DetectorSettings
from swift_ros.track import Track
from swift_sim_bridge.gate_detector.images.targets import GateLimits
from swift_sim_bridge.model_files.provenance import file_hash
from swift_sim_bridge.rendering.scene import Looks

GROUPING = ("peak_threshold", "edge_threshold", "most_peaks", "corner_outset_px")  # of the node


@dataclass(frozen=True)
class DetectorSetup:
    """What an evaluation of the gate detector needs.

    Attributes:
        detector: as it flies.
        camera: the lens and its mount.
        track: of the scenes.
        looks: of a race.
        limits: which gates count.
        models: SHA-256 of the network, by file name.
    """

    detector: GateDetector
    camera: Camera
    track: Track
    looks: Looks
    limits: GateLimits
    models: dict


def load_setup(folder: Path) -> DetectorSetup:
    """Return the detector of a configuration folder. Raises UsageError that names the wrong file and key."""
    node = configuration.load_section(DetectorSettings, folder / "nodes.yaml", "gate_detector")
    limits = configuration.read_section(folder / "training.yaml", "detector").get("judged")
    model = folder / node.model
    network = CornerNetwork(model, node.providers)
    thresholds = {name: getattr(node, name) for name in GROUPING}
    camera = configuration.load(Camera, folder / "camera.yaml")
    grouping = GroupingSettings(**thresholds, stride=network.shape.stride)
    return DetectorSetup(
        detector=GateDetector(camera, network, grouping),
        camera=camera,
        track=configuration.load(Track, folder / "track.yaml"),
        looks=configuration.load_section(Looks, folder / "simulation.yaml", "renderer"),
        limits=configuration.build(GateLimits, limits, f"{folder / 'training.yaml'}, section 'detector', key 'judged'"),
        models={model.name: file_hash(model)},
    )
