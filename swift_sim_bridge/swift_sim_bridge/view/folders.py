"""Pictures, logs and names of result folders."""

import json
import math
import re
from pathlib import Path

import rerun as rr

from swift_ros.errors import UsageError


def entity_name(text) -> str:
    """Return a text as a part of an entity's path, without characters that would have to be escaped."""
    return re.sub(r"[^\w.-]+", "_", str(text)).strip("_") or "_"


def log_pictures(recording: rr.RecordingStream, files: list[Path]) -> list[str]:
    """Write PNG and JPEG files to a recording of the viewer; return their entities."""
    entities = []
    for file in files:
        entities.append(f"pictures/{entity_name(file.stem)}")
        recording.log(entities[-1], rr.EncodedImage(path=file), static=True)
    return entities


def read_rows(file: Path) -> list[dict]:
    """Return the rows of a log with a JSON object in each line. Raises UsageError without a readable row.

    A last line without its end is left out: a running training may be writing it.
    """
    rows = []
    lines = file.read_text().splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            rows.append(json.loads(line))
        except ValueError as error:
            if number < len(lines):
                raise UsageError(f"{file}, line {number} is no JSON; the log is damaged") from error
    if not rows or not all(isinstance(row, dict) for row in rows):
        raise UsageError(f"{file} holds no row of a training yet; wait for its first trial")
    return rows


def numbers(row: dict) -> dict[str, float]:
    """Return the finite numbers of a row by name; those of a list get its name and their place, from 1."""
    found = {}
    for name, value in row.items():
        values = value if isinstance(value, list) else [value]
        for i, one in enumerate(values, start=1):
            if isinstance(one, int | float) and not isinstance(one, bool) and math.isfinite(one):
                found[f"{name}_{i}" if isinstance(value, list) else name] = float(one)
    return found
