"""The result of the detector's evaluation as a table and as pictures."""

from pathlib import Path

import cv2
import numpy as np

from swift_sim_bridge.gate_detector.corner_states import VISIBLE

COLUMNS = 4  # images side by side in the picture


def table(result: dict) -> str:
    """Return the figures of `evaluate.figures` as lines to print."""
    gates, shares = result["gates"], result["image_shares"]
    error, spent = result["corner_error_px"], result["pass_cpu_ms"]
    rows = [
        f"{result['images']} images: {shares['tilted']:.0%} tilted over 45 degrees, {shares['several']:.0%} with two "
        f"or more gates, {shares['cut']:.0%} with a cut gate",
        f"corners  {recall_precision(result['corner_recall'], result['corner_precision'])} of {result['corners']}, "
        f"within {result['within_px']:g} px",
        f"         unseen texture families: "
        f"{recall_precision(result['recall_unseen_families'], result['precision_unseen_families'])}",
        f"gates    {recall_precision(gates['recall'], gates['precision'])} of {gates['whole']} whole",
        f"empty    {result['empty_images_with_gates']} of {result['empty_images']} scenes without gates show a gate",
        f"CPU time {spent['median']:.1f} ms a pass (median), {spent['p99']:.1f} ms (p99)",
    ]
    if error:
        rows.insert(3, f"         error {error['median']:.2f} px median, {error['rms_axis']:.2f} px rms an axis")
    if result["large_gates_outset_px"] is not None:
        text = "corners of large gates lie {:+.2f} px too far out in the panorama (median); see 'corner_outset_px'"
        rows.insert(-2, "         " + text.format(result["large_gates_outset_px"]))
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


def recall_precision(recall, precision) -> str:
    """Return recall and precision as text; "-" for None."""
    return f"recall {_percent(recall)}, precision {_percent(precision)}"


def write_pictures(tally, path: Path) -> None:
    """Write the tally's images as one picture: green crosses are true corners, red lines detected gates."""
    tiles = []
    for image, gates, pixels, labels in tally.pictures:
        tile = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        for gate in gates:
            outline = np.rint(16 * gate.corners_px).astype(np.int32)
            cv2.polylines(tile, [outline], True, (60, 60, 255), 1, cv2.LINE_AA, 4)
        for point in pixels[labels.counts[:, None] & (labels.state == VISIBLE)]:
            cv2.drawMarker(tile, tuple(int(round(v)) for v in point), (80, 255, 80), cv2.MARKER_CROSS, 5)
        tiles.append(tile)
    while len(tiles) % COLUMNS:
        tiles.append(np.zeros_like(tiles[0]))
    rows = [np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]
    if rows:
        cv2.imwrite(str(path), np.vstack(rows))
