"""Names the rows of a table that cannot be read, as the warning DamagedRecording."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

from swift_ros.errors import DamagedRecording

MAX_NAMED = 8  # parts that are named one by one; the others are named together


class DamagedRows(NamedTuple):
    """Rows that lie together and cannot be read.

    Attributes:
        place: where they are in the file, such as "line 17".
        after_s: time of the last readable row before them, s; None without one.
        before_s: time of the first readable row after them, s; None without one.
        reason: what is wrong with them.
    """

    place: str
    after_s: float | None
    before_s: float | None
    reason: str


def warn(path, parts: Sequence[DamagedRows]) -> None:
    """Warn of the damaged rows of a table, once for each part, in the order of the file."""
    named, others = parts[:MAX_NAMED], parts[MAX_NAMED:]
    if others:
        reason = f"and {len(others) - 1} further parts up to {others[-1].place}: {others[0].reason}"
        named = [*named, DamagedRows(others[0].place, others[0].after_s, others[-1].before_s, reason)]
    for part in named:
        text = f"{path}: {part.place} cannot be read ({part.reason}): {_missing(part)}"
        warnings.warn(text, DamagedRecording, stacklevel=3)


def _missing(part: DamagedRows) -> str:
    if part.after_s is None and part.before_s is None:
        return "these rows are missing"
    if part.after_s is None:
        return f"the rows before {part.before_s:.3f} s are missing"
    if part.before_s is None:
        return f"the rows after {part.after_s:.3f} s are missing"
    return f"the rows between {part.after_s:.3f} s and {part.before_s:.3f} s are missing"
