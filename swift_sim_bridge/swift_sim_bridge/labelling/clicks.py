"""What a person did on the page, recorded in `labelling.jsonl`: a line for each accepted image."""

import json
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.labels.labelled_images import LabelledGate

CLICKS = "labelling.jsonl"
LONGEST_S = 60.0  # s for one image; a longer time is a pause of the person and counts as this
SAME_PX = 0.01  # a corner that moved less was not moved


def changes(proposed: list[LabelledGate], gates: list[LabelledGate], used: list[int | None]) -> dict[str, int]:
    """Return counts of what a person changed.

    Args:
        proposed: gates that the page showed.
        gates: gates that were accepted.
        used: number of the proposal from which each of these came; None for an added gate.
    """
    counts = {"proposed": len(proposed), "unchanged": 0, "corners_moved": 0, "visibility_changed": 0}
    for gate, number in zip(gates, used, strict=True):
        if number is None:
            continue
        before = proposed[number]
        off = np.linalg.norm(gate.corners_px - before.corners_px, axis=-1)
        moved, switched = int((off > SAME_PX).sum()), int((gate.visibility != before.visibility).sum())
        counts["unchanged"] += not (moved or switched)
        counts["corners_moved"] += moved
        counts["visibility_changed"] += switched
    kept = {number for number in used if number is not None}
    return counts | {"added": used.count(None), "deleted": len(proposed) - len(kept)}


def append(path: Path, row: dict) -> None:
    """Add a line to the file. Raises UsageError where it cannot be written."""
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error


def summary(path: Path) -> str:
    """Return a sentence on the recorded work; "" without any. A line that was torn by a crash is left out."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            row = json.loads(line)
            rows.append((min(float(row["seconds"]), LONGEST_S), row["changes"]))
        except (ValueError, TypeError, KeyError):
            continue
    if not rows:
        return ""
    total = {key: sum(int(row.get(key, 0)) for _, row in rows) for key in ("proposed", "unchanged", "corners_moved")}
    total |= {key: sum(int(row.get(key, 0)) for _, row in rows) for key in ("added", "deleted")}
    minutes, seconds = divmod(round(sum(time_s for time_s, _ in rows)), 60)
    return (
        f"{len(rows)} images accepted in {minutes} min {seconds:02d} s: {total['unchanged']} of {total['proposed']} "
        f"proposed gates unchanged, {total['corners_moved']} corners moved, {total['added']} gates added, "
        f"{total['deleted']} deleted"
    )
