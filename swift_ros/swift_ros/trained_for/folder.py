"""What the networks of a configuration folder were not trained for."""

from pathlib import Path

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.track import Track
from swift_ros.trained_for.detector import detector_warnings
from swift_ros.trained_for.pilot import pilot_warnings
from swift_ros.vehicle import Vehicle


def warnings(folder: Path) -> list[str]:
    """Return a sentence for each thing in a configuration folder that a network was not trained for.

    Raises:
        UsageError: a file of the folder is wrong.
    """
    track = configuration.load(Track, folder / "track.yaml")
    vehicle = configuration.load(Vehicle, folder / "drone.yaml")
    camera, looks = configuration.load(Camera, folder / "camera.yaml"), {}
    if (folder / "simulation.yaml").is_file():
        looks = configuration.read_section(folder / "simulation.yaml", "renderer")
    pilot, detector = (
        folder / str(configuration.read_section(folder / "nodes.yaml", node).get("model"))
        for node in ("policy", "gate_detector")
    )
    return pilot_warnings(pilot, track, vehicle) + detector_warnings(detector, camera, track, looks)
