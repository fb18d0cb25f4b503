"""The log of a training: a file of JSON lines, one for each trial or validation."""

import json
from pathlib import Path

from swift_ros.errors import UsageError


def append(path: Path, row: dict) -> None:
    """Append a row."""
    with open(path, "a") as file:
        file.write(json.dumps(row) + "\n")


def rows_until(path: Path, key: str, last: int) -> list[dict]:
    """Return the rows whose `key` is at most `last`; remove the others from the file.

    An interruption between line and checkpoint leaves a later line, or a part of one: that trial is made again.

    Args:
        path: the file; without it there are no rows.
        key: name of the count of interactions or steps.
        last: count of the checkpoint from which the training goes on.

    Raises:
        UsageError: a line but the last is not readable.
    """
    if not path.exists():
        return []
    rows, lines = [], path.read_text().splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            if row[key] <= last:
                rows.append(row)
        except (ValueError, KeyError, TypeError) as error:
            if number < len(lines):
                raise UsageError(f"{path} is damaged at line {number}; remove the line") from error
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return rows
