"""The detector's evaluation around its core: what is loaded for it, and its table and pictures."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from swift_ros import configuration
from swift_ros import track as tracks
from swift_ros.camera import model as lens
from swift_ros.errors import UsageError
from swift_ros.perception.corner_grouping import GroupingSettings
from swift_ros.perception.corner_network import CornerNetwork
from swift_ros.perception.gate_detector import GateDetector
from swift_sim_bridge.gate_detector.data import SEEN, Judged
from swift_sim_bridge.model_files.provenance import file_hash
from swift_sim_bridge.rendering.scene import Looks


@dataclass(frozen=True)
class Stage:
    """All that an evaluation needs: the detector as it flies, camera, track, race looks, which gates are judged."""

    detector: GateDetector
    camera: lens.Camera
    track: tracks.Track
    looks: Looks
    judged: Judged
    models: dict


def load(folder: Path) -> Stage:
    """Return the stage of a configuration folder. Raises UsageError naming the file and key that is amiss."""
    node = _section(folder / "nodes.yaml", "gate_detector")
    judged = _section(folder / "training.yaml", "detector").get("judged")
    model = folder / node["model"]
    network = CornerNetwork(model, tuple(node["providers"]))
    thresholds = {name: node[name] for name in ("peak_threshold", "edge_threshold", "most_peaks")}
    camera = configuration.load(lens.Camera, folder / "camera.yaml")
    grouping = GroupingSettings(**thresholds, stride=network.shape.stride)
    looks = _section(folder / "simulation.yaml", "renderer")
    return Stage(
        detector=GateDetector(camera, network, grouping),
        camera=camera,
        track=configuration.load(tracks.Track, folder / "track.yaml"),
        looks=configuration.build(Looks, looks, f"{folder / 'simulation.yaml'}, section 'renderer'"),
        judged=configuration.build(Judged, judged, f"{folder / 'training.yaml'}, section 'detector', key 'judged'"),
        models={model.name: file_hash(model)},
    )


def _section(path, name):
    content = configuration.read_yaml(path)
    if name not in content:
        raise UsageError(f"{path} lacks the section '{name}'")
    return content[name]


def table(result: dict) -> str:
    """Return the figures as lines to print."""
    gates, shares = result["gates"], result["image_shares"]
    error, spent = result["corner_error_px"], result["pass_cpu_ms"]
    rows = [
        f"{result['images']} images: {shares['tilted']:.0%} tilted over 45 degrees, {shares['several']:.0%} with two "
        f"or more gates, {shares['cut']:.0%} with a cut gate",
        f"corners  {_recall_precision(result['corner_recall'], result['corner_precision'])} of {result['corners']}, "
        f"within {result['within_px']:g} px",
        f"         unseen texture families: "
        f"{_recall_precision(result['recall_unseen_families'], result['precision_unseen_families'])}",
        f"gates    {_recall_precision(gates['recall'], gates['precision'])} of {gates['whole']} whole",
        f"empty    {result['empty_images_with_gates']} of {result['empty_images']} scenes without gates show one",
        f"a pass   {spent['median']:.1f} ms of one core (median), {spent['p99']:.1f} ms (p99)",
    ]
    if error:
        rows.insert(3, f"         error {error['median']:.2f} px median, {error['rms_axis']:.2f} px rms an axis")
    for name, title in (
        ("recall_by_distance_m", "recall by distance, m"),
        ("recall_by_corners_in_view", "recall by corners in view"),
        ("recall_by_roll_deg", "recall by roll in the image, deg"),
        ("precision_by_roll_deg", "precision by roll in the image, deg"),
        ("recall_by_tilt_deg", "recall by tilt, deg"),
    ):
        row = "  ".join(f"{key}: {_percent(entry['share'])} of {entry['of']}" for key, entry in result[name].items())
        rows.append(f"{title:36} {row}")
    return "\n".join(rows)


def _percent(share):
    return "-" if share is None else f"{100 * share:.1f} %"


def _recall_precision(recall, precision):
    return f"recall {_percent(recall)}, precision {_percent(precision)}"


def write_pictures(tally, path: Path) -> None:
    """Write the tally's pictures as one: green crosses are true corners that count, red lines gates found."""
    tiles = []
    for image, gates, pixels, sight in tally.pictures:
        tile = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        for gate in gates:
            outline = np.rint(16 * gate.corners_px).astype(np.int32)
            cv2.polylines(tile, [outline], True, (60, 60, 255), 1, cv2.LINE_AA, 4)
        for point in pixels[sight.judged[:, None] & (sight.state == SEEN)]:
            cv2.drawMarker(tile, tuple(int(round(v)) for v in point), (80, 255, 80), cv2.MARKER_CROSS, 5)
        tiles.append(tile)
    while len(tiles) % 4:
        tiles.append(np.zeros_like(tiles[0]))
    rows = [np.hstack(tiles[i : i + 4]) for i in range(0, len(tiles), 4)]
    if rows:
        cv2.imwrite(str(path), np.vstack(rows))
