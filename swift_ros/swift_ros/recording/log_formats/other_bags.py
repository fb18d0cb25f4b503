"""Reads bags in the formats that this graph does not write: rosbag2 SQLite folders, and bags of ROS 1."""

import sqlite3
import warnings
from pathlib import Path

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.typesys import Stores, get_typestore

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.recording.log_formats import ros_messages
from swift_ros.recording.log_formats.log import ROS1_BAGS, SQLITE_BAGS, Log

DESCRIPTION = "metadata.yaml"  # of a rosbag2 folder
# Types of bags without definitions: those that every ROS 2 has are the same in all its distributions.
COMMON_TYPES = Stores.ROS2_HUMBLE


def find(path: Path) -> Path | None:
    """Return the bag of ROS 1, or the folder of the SQLite bag, at a path; None where there is none."""
    if path.is_file():
        if path.suffix.lower() in ROS1_BAGS:
            return path
        return path.parent if path.suffix.lower() in SQLITE_BAGS else None
    folders = {file.parent for suffix in SQLITE_BAGS for file in path.rglob(f"*{suffix}*")} if path.is_dir() else set()
    return folders.pop() if len(folders) == 1 else None


def read(bag: Path) -> Log:
    """Return the topics of a bag.

    Args:
        bag: see `find`.

    Raises:
        UsageError: it cannot be read, or no topic can be decoded.

    Warns:
        DamagedRecording: for each topic that cannot be decoded, and where the bag ends early.
    """
    is_ros1 = bag.suffix.lower() in ROS1_BAGS
    name = "ROS 1 bag" if is_ros1 else "ROS 2 bag (SQLite)"
    if not is_ros1 and not (bag / DESCRIPTION).is_file():
        raise UsageError(f"{bag} has no {DESCRIPTION}; write it with `ros2 bag reindex {bag}`")
    rows: dict[str, list[ros_messages.Row]] = {}
    types: dict[str, str] = {}
    lost: set[str] = set()
    try:
        with AnyReader([bag], default_typestore=get_typestore(COMMON_TYPES)) as reader:
            for connection, log_time_ns, data in reader.messages():
                if len(data) > ros_messages.MAX_MESSAGE or connection.topic in lost:
                    continue
                try:
                    message = reader.deserialize(data, connection.msgtype)
                except Exception:  # of the decoder that was generated from the bag's definition
                    lost.add(connection.topic)
                    continue
                types.setdefault(connection.topic, connection.msgtype)
                rows.setdefault(connection.topic, []).append(ros_messages.row(message, log_time_ns))
    except (AnyReaderError, Ros1Error, Ros2Error, sqlite3.DatabaseError, OSError) as error:
        cure = f"`rosbag reindex {bag}`" if is_ros1 else f"`ros2 bag reindex {bag}`"
        if not rows:
            raise UsageError(f"{bag} cannot be read as a {name} ({error}); repair it with {cure}") from error
        warnings.warn(
            f"{bag} cannot be read to its end ({error}); repair it with {cure}", DamagedRecording, stacklevel=2
        )
    for topic in sorted(lost):
        text = f"{bag}: {topic} is left out: the bag has no definition of its type that can be read"
        warnings.warn(text, DamagedRecording, stacklevel=2)
    return ros_messages.as_log(bag, name, rows, types)
