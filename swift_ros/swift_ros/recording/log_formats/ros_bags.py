"""Reads the topics of rosbag2 MCAP bags of any graph, by the definitions of their types that the bags store.

All times are on the clock of the recorder: a topic's own stamps, later by the smallest delay of its messages, so that
topics with stamps of other clocks (a flight controller's, a simulator's) fit together.
"""

import contextlib
import io
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.recording.log_formats.log import Log, LoggedTopic
from swift_ros.recording.mcap_format.mcap_file import McapFile, RawMessage, Topic

MAX_VALUES = 64  # of an array: longer ones are images, scans and point clouds, and no channel of a flight table
MAX_MESSAGE = 4096  # bytes; larger messages are not decoded, for the same reason
OTHER_CLOCK_S = 1.0  # s; a larger smallest delay is a difference of clocks


def read(path: Path, files: Sequence[McapFile]) -> Log:
    """Return the topics of a bag.

    Args:
        path: of the bag, for errors.
        files: its MCAP files.

    Raises:
        UsageError: no topic can be decoded.

    Warns:
        DamagedRecording: for each part that cannot be read, and each topic that cannot be decoded.
    """
    rows: dict[str, list[tuple[float, float, dict[str, float]]]] = {}
    types: dict[str, str] = {}
    for file in files:
        decoders = {topic.name: _decoder(topic) for topic in file.topics.values()}
        for name, decode in decoders.items():
            if decode is None:
                _warn(f"{path}: {name} is left out: the bag has no definition of its type that can be read")
        wanted = {name for name, decode in decoders.items() if decode}
        for raw in file.messages(wanted):
            types.setdefault(raw.topic, raw.type)
            if (row := _row(decoders[raw.topic], raw)) is not None:
                rows.setdefault(raw.topic, []).append(row)
    begin = min((found[0][1] for found in rows.values()), default=0.0)
    topics = {name: _topic(found, types[name], begin) for name, found in rows.items() if len(found) > 1}
    if not topics:
        raise UsageError(f"{path} holds no topic with two messages that can be decoded; it is not a flight")
    return Log(path, "ROS 2 bag", topics)


def _warn(text: str) -> None:
    warnings.warn(text, DamagedRecording, stacklevel=3)


def _decoder(topic: Topic):
    schema = Schema(1, topic.definition, "ros2msg", topic.type)
    quiet = io.StringIO()  # it prints each line that it does not understand
    try:
        with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
            return DecoderFactory().decoder_for("cdr", schema) if topic.definition else None
    except Exception:  # its parser raises errors of many kinds
        return None


def _row(decode, raw: RawMessage) -> tuple[float, float, dict[str, float]] | None:
    """Return stamp, log time (both s) and values of a message; None where it cannot be decoded."""
    if len(raw.data) > MAX_MESSAGE:
        return None
    try:
        message = decode(raw.data)
        values = dict(_numbers("", message))
    except Exception:  # of the decoder that was generated from the bag's definition
        return None
    log_s = raw.log_time_ns * 1e-9
    return _stamp_s(values, log_s), log_s, values


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
    if isinstance(value, bool | int | float):
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
