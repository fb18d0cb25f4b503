"""The gate detector as it flies, with all that its evaluation needs, from a configuration folder."""

from dataclasses import dataclass
from pathlib import Path

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.perception.corner_grouping import GroupingSettings
from swift_ros.perception.corner_network import CornerNetwork
from swift_ros.perception.gate_detector import GateDetector
from swift_ros.track import Track
from swift_sim_bridge.gate_detector.data import GateLimits
from swift_sim_bridge.model_files.provenance import file_hash
from swift_sim_bridge.rendering.scene import Looks


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
    node = _section(folder / "nodes.yaml", "gate_detector")
    limits = _section(folder / "training.yaml", "detector").get("judged")
    model = folder / node["model"]
    network = CornerNetwork(model, tuple(node["providers"]))
    thresholds = {name: node[name] for name in ("peak_threshold", "edge_threshold", "most_peaks")}
    camera = configuration.load(Camera, folder / "camera.yaml")
    grouping = GroupingSettings(**thresholds, stride=network.shape.stride)
    looks = _section(folder / "simulation.yaml", "renderer")
    return DetectorSetup(
        detector=GateDetector(camera, network, grouping),
        camera=camera,
        track=configuration.load(Track, folder / "track.yaml"),
        looks=configuration.build(Looks, looks, f"{folder / 'simulation.yaml'}, section 'renderer'"),
        limits=configuration.build(GateLimits, limits, f"{folder / 'training.yaml'}, section 'detector', key 'judged'"),
        models={model.name: file_hash(model)},
    )


def _section(path, name):
    content = configuration.read_yaml(path)
    if name not in content:
        raise UsageError(f"{path} lacks the section '{name}'")
    return content[name]
