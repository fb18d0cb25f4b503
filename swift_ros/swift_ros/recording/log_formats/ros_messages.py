"""Messages of ROS as columns of numbers, whatever decoded them.

All times are on the clock of the recorder: a topic's own stamps, later by the smallest delay of its messages, so that
topics with stamps of other clocks (a flight controller's, a simulator's) fit together.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import Log, LoggedTopic

MAX_VALUES = 64  # of an array: longer ones are images, scans and point clouds, and no channel of a flight table
MAX_MESSAGE = 4096  # bytes; larger messages are not decoded, for the same reason
OTHER_CLOCK_S = 1.0  # s; a larger smallest delay is a difference of clocks

Row = tuple[float, float, dict[str, float]]  # stamp and log time of a message, s, and its values by name


def row(message: Any, log_time_ns: int) -> Row:
    """Return a decoded message as a row."""
    values, log_s = dict(_numbers("", message)), log_time_ns * 1e-9
    return _stamp_s(values, log_s), log_s, values


def as_log(path: Path, name: str, rows: Mapping[str, list[Row]], types: Mapping[str, str]) -> Log:
    """Return the rows of each topic as a log.

    Args:
        path: of the bag.
        name: of its format.
        rows: rows by topic.
        types: type by topic.

    Raises:
        UsageError: no topic has two messages.
    """
    begin = min((found[0][1] for found in rows.values()), default=0.0)
    topics = {name: _topic(found, types[name], begin) for name, found in rows.items() if len(found) > 1}
    if not topics:
        raise UsageError(f"{path} holds no topic with two messages that can be decoded; it is not a flight")
    return Log(path, name, topics)


def _stamp_s(values: dict[str, float], log_s: float) -> float:
    """Return the time to which a message refers: of its header, or of PX4's `timestamp` (us); else its log time."""
    seconds, nanoseconds = (values.get(f"header.stamp.{part}", 0.0) for part in ("sec", "nanosec"))
    if seconds or nanoseconds:
        return seconds + 1e-9 * nanoseconds
    for name in ("timestamp_sample", "timestamp"):
        if values.get(name):
            return 1e-6 * values[name]
    return log_s


def _numbers(prefix: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield the names and values of all numbers in a message."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        yield prefix, float(value)
    elif hasattr(value, "__slots__") or hasattr(value, "__dict__"):
        for name in getattr(value, "__slots__", None) or vars(value):
            if not name.startswith("_"):
                yield from _numbers(f"{prefix}.{name}" if prefix else name, getattr(value, name))
    elif not isinstance(value, str | bytes) and hasattr(value, "__len__") and len(value) <= MAX_VALUES:
        for i, item in enumerate(value):
            yield from _numbers(f"{prefix}[{i}]", item)


def _topic(rows: list, kind: str, begin_s: float) -> LoggedTopic:
    """Return the rows of a topic as columns; a column that a message lacks is NaN there."""
    names = dict.fromkeys(name for _, _, values in rows for name in values)
    columns = {name: np.array([values.get(name, np.nan) for _, _, values in rows]) for name in names}
    stamp_s, log_s = (np.array([row[i] for row in rows]) for i in (0, 1))
    delay_s = float(np.min(log_s - stamp_s))
    other_clock = abs(delay_s) > OTHER_CLOCK_S
    return LoggedTopic(stamp_s + (delay_s if other_clock else 0.0) - begin_s, columns, kind)
