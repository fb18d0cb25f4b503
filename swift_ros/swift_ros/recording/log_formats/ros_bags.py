"""Reads the topics of rosbag2 MCAP bags of any graph, by the definitions of their types that the bags store."""

import contextlib
import io
import warnings
from collections.abc import Sequence
from pathlib import Path

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from swift_ros.errors import DamagedRecording
from swift_ros.recording.log_formats import ros_messages
from swift_ros.recording.log_formats.log import Log
from swift_ros.recording.mcap_format.mcap_file import McapFile, RawMessage, Topic


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
    rows: dict[str, list[ros_messages.Row]] = {}
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
    return ros_messages.as_log(path, "ROS 2 bag", rows, types)


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


def _row(decode, raw: RawMessage) -> ros_messages.Row | None:
    """Return stamp, log time (both s) and values of a message; None where it cannot be decoded."""
    if len(raw.data) > ros_messages.MAX_MESSAGE:
        return None
    try:
        return ros_messages.row(decode(raw.data), raw.log_time_ns)
    except Exception:  # of the decoder that was generated from the bag's definition
        return None
