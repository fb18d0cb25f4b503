"""The result of the detector on labelled images as a table, and pictures of the worst images."""

from pathlib import Path

import cv2
import numpy as np

from swift_sim_bridge.gate_detector.evaluation.image_scores import ImageTally
from swift_sim_bridge.gate_detector.evaluation.report import recall_precision
from swift_sim_bridge.labels.folder import LabelledFolder
from swift_sim_bridge.labels.labelled_images import NOT_LABELLED

WORST = 12  # images in the picture
COLUMNS, TILE_PX = 4, 400  # images side by side, and the side of each
TRUE, FOUND = (80, 255, 80), (60, 60, 255)  # BGR: labels are green crosses, detected gates red lines


def table(result: dict, folder: LabelledFolder, least_side_px: float, level: bool = False) -> str:
    """Return the figures of `image_scores.figures` as lines to print; `level` as in `ImageEvaluation`."""
    corners, gates, pose, within = (result[name] for name in ("corners", "whole_gates", "pose", "within"))
    without_attitude = sum(image.q_world_camera is None for image in folder.images)
    rows = [
        f"{result['images']} images, {result['images_without_gate']} of them without a gate: {result['gates']} gates "
        f"that count, {result['gates_too_small']} below {least_side_px:g} px or without a labelled side",
        f"corners  {recall_precision(corners['recall'], corners['precision'])} of {corners['labelled']} labelled and "
        f"{corners['detected']} detected, within {within['px']:g} px or {within['share_of_side']:.0%} of the side",
        f"gates    {recall_precision(gates['recall'], gates['precision'])} of {gates['labelled']} labelled and "
        f"{gates['detected']} detected with four corners",
    ]
    if corners["error_px"]:
        error = corners["error_px"]
        rows.append(f"error    of correct corners {error['median']:.2f} px median, {error['p90']:.2f} px p90")
    if pose["position_error_m"]:
        position, angle = pose["position_error_m"], pose["angle_error_deg"]
        rows.append(
            f"pose     position {position['median']:.3f} m median, {position['p90']:.3f} m p90; angle "
            f"{angle['median']:.1f} deg median, {angle['p90']:.1f} deg p90; of {position['of']} gates"
        )
    partly = sum(not image.all_gates for image in folder.images)
    if partly:
        rows.append(
            f"elsewhere {corners['elsewhere']} corners and {gates['elsewhere']} gates are detected far from the labels "
            f"of {partly} images in which not all gates are labelled; they count in no share"
        )
    if without_attitude:
        taken = "the camera is taken to be level" if level else "it is that at which the labelled gates stand upright"
        rows.append(f"the attitude of {without_attitude} images is not known: {taken}")
    if folder.fov_deg is not None:
        rows.append(f"a pinhole lens of {folder.fov_deg:g} degrees is assumed")
    return "\n".join(rows)


def write_worst(folder: LabelledFolder, tally: ImageTally, path: Path) -> None:
    """Write the images with the most missed and wrong corners as one picture, the worst first."""
    worst = sorted(tally.rows, key=lambda row: -row[0])[:WORST]
    tiles = [_tile(folder, image, gates) for _, image, gates in worst]
    while len(tiles) % COLUMNS:
        tiles.append(np.zeros_like(tiles[0]))
    rows = [np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]
    if rows:
        cv2.imwrite(str(path), np.vstack(rows))


def _tile(folder: LabelledFolder, image, gates) -> np.ndarray:
    scale = TILE_PX / max(image.width, image.height)
    shape = (max(round(scale * image.width), 1), max(round(scale * image.height), 1))
    small = cv2.resize(folder.pixels(image), shape, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    tile = np.zeros((TILE_PX, TILE_PX, 3), np.uint8)
    tile[: shape[1], : shape[0]] = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    for corners in gates:
        outline = np.rint(16 * scale * corners).astype(np.int32)
        cv2.polylines(tile, [outline], True, FOUND, 1, cv2.LINE_AA, 4)
    for gate in image.gates:
        for point in gate.corners_px[gate.visibility != NOT_LABELLED]:
            cv2.drawMarker(tile, tuple(int(round(scale * value)) for value in point), TRUE, cv2.MARKER_CROSS, 9)
    return tile
