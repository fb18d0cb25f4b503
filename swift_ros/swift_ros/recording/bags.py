"""Reads rosbag2 MCAP bags, sound or damaged; errors of a bag are reported.

A bag is a folder with `metadata.yaml` (version 9) and one `.mcap` file or, where the recorder was started again in
flight, several: BAG_0.mcap, BAG_1.mcap, ... They hold serialized messages and their `ros2msg` schemas.
"""

import json
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from swift_ros import configuration
from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.files import yaml_text
from swift_ros.messages.serialization import deserialize
from swift_ros.recording.mcap_format.mcap_file import Damage, McapFile, RawMessage, Topic, open_file


def mcap_files(path: str | os.PathLike) -> list[Path]:
    """Return the `.mcap` files of a bag given as folder or file, in the order in which they were written."""
    path = Path(path)
    if path.is_file() and path.suffix == ".mcap":
        return [path]
    return sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name)) if path.is_dir() else []


def open_files(path: str | os.PathLike) -> list[McapFile]:
    """Return the files of a bag given as folder or .mcap file. Raises UsageError without a readable one."""
    files = mcap_files(path)
    if not files:
        raise UsageError(f"{path} holds no .mcap file; give a bag folder or an .mcap file")
    return [open_file(file) for file in files]


def read_raw(path: str | os.PathLike, topics=None) -> Iterator[RawMessage]:
    """Yield the messages of a bag in the order of log times.

    Args:
        path: bag folder or .mcap file.
        topics: full names; None for all.

    Raises:
        UsageError: the file is not an MCAP file.

    Warns:
        DamagedRecording: for each part that cannot be read.
    """
    for file in open_files(path):
        yield from file.messages(None if topics is None else set(topics))


def read(path: str | os.PathLike, topics=None) -> Iterator[tuple[str, Any, int]]:
    """Yield (topic, ROS message, log_time_ns) of a bag in the order of log times. Raises and warns like `read_raw`."""
    for raw in read_raw(path, topics):
        try:
            message = deserialize(raw.data, raw.type)
        except RuntimeError:  # of rclpy; bags of this graph have checksums, but other files need not
            text = f"{path}: messages of {raw.topic} that cannot be decoded are left out"
            warnings.warn(text, DamagedRecording, stacklevel=2)
            continue
        except LookupError as error:
            warnings.warn(f"{path}: {raw.topic} is left out: {error}", DamagedRecording, stacklevel=2)
            continue
        yield raw.topic, message, raw.log_time_ns


def damage(path: str | os.PathLike) -> list[Damage]:
    """Return the parts of a bag that cannot be read. Raises like `read_raw`."""
    return [part for file in open_files(path) for part in file.damage()]


def topics(path: str | os.PathLike) -> dict[str, Topic]:
    """Return the topics of a bag by name. Raises like `read_raw`."""
    return {topic.name: topic for file in open_files(path) for topic in file.topics.values()}


def topic_types(path: str | os.PathLike) -> dict[str, str]:
    """Return the type of each topic in the bag. Raises like `read_raw`."""
    return {name: topic.type for name, topic in topics(path).items()}


def custom_data(path: str | os.PathLike) -> dict[str, str]:
    """Return the custom data of a bag: texts by name, such as hashes and the configuration. Raises like `read_raw`."""
    return open_files(path)[0].custom


def stored_record(path: str | os.PathLike, kind, name: str):
    """Return a file of the configuration that a bag stores, as a dataclass.

    Args:
        path: bag folder or .mcap file.
        kind: the dataclass.
        name: of the file, such as `track.yaml`.

    Raises:
        UsageError: the bag does not store the file, or the text is damaged.
    """
    text, where = custom_data(path).get(f"config/{name}"), f"{path}, config/{name}"
    if text is None:
        raise UsageError(f"{path} does not contain its {name}; fly the race again")
    content = yaml_text.parse_yaml(text, f"{where} is damaged: it", "use another recording")
    return configuration.build(kind, content, where)


def stored_json(path: str | os.PathLike, name: str, default):
    """Return a custom text of a bag that is JSON of the type of `default`. Raises UsageError when it is damaged."""
    text = custom_data(path).get(name)
    try:
        found = default if text is None else json.loads(text)
    except ValueError:
        found = None
    if not isinstance(found, type(default)):
        raise UsageError(f"{path}: its custom data '{name}' is damaged; record or import it again")
    return found


def require(path: str | os.PathLike, topic: str) -> None:
    """Raise UsageError, with the names of all topics, when a bag lacks a topic."""
    present = topic_types(path)
    if topic not in present:
        raise UsageError(f"{path} has no topic {topic}; it has {', '.join(sorted(present)) or 'none'}")
