"""Writes rosbag2 MCAP bags that are readable after any crash.

`ros2 bag`, Foxglove, PlotJuggler, `rosbags` and `mcap` read them.
"""

import contextlib
import os
import struct
import time
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.opcode import Opcode
from mcap.writer import Writer

from swift_ros.errors import UsageError
from swift_ros.recording import bags
from swift_ros.recording.mcap_format.mcap_file import CUSTOM_DATA, TOPIC, Topic, open_file
from swift_ros.recording.mcap_format.mcap_records import FOOTER, HEAD, MAGIC
from swift_ros.recording.mcap_format.message_definitions import schema_text, type_hash

CHUNK_BYTES = 256 * 1024  # bytes; a killed recorder loses at most one incomplete chunk
METADATA_EVERY_S = 1.0  # s; shortest period between two writes of metadata.yaml
# End of a complete MCAP file: records DataEnd and Footer (without a summary), then the magic bytes.
_TAIL = HEAD.pack(Opcode.DATA_END, 4) + struct.pack("<I", 0) + FOOTER.pack(Opcode.FOOTER, 20, 0, 0, 0) + MAGIC


class _CompleteFile:
    """Output stream for mcap's Writer; its file ends with a valid tail after every `commit`.

    The next commit overwrites the tail in the system call that writes the new data. A process that is killed at any
    time therefore leaves a file that every MCAP reader accepts.
    """

    def __init__(self, path: Path):
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._committed = 0
        self._pending = bytearray()

    def write(self, data: bytes) -> int:
        self._pending += data
        return len(data)

    def tell(self) -> int:
        return self._committed + len(self._pending)

    def commit(self, last: bool = False) -> bool:
        """Write the pending data and the tail; return whether there was any data.

        Args:
            last: the data ends with a complete tail of its own.
        """
        if not self._pending:
            return False
        try:
            self._write(bytes(self._pending) + (b"" if last else _TAIL))
        except OSError:
            # remove the incomplete block; the tail then fits into the space that it used
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._committed)
                self._write(_TAIL)
            raise
        self._committed += len(self._pending)
        self._pending.clear()
        if last:
            os.ftruncate(self._file, self._committed)
        return True

    def close(self) -> None:
        os.close(self._file)

    def _write(self, block: bytes) -> None:
        written = 0
        while written < len(block):
            written += os.pwrite(self._file, block[written:], self._committed + written)


@dataclass(frozen=True)
class _Contents:
    """What one file of a bag holds: its name, first and last log time (ns; None without a message), message counts."""

    file: str
    span: tuple[int, int] | None
    counts: dict[str, int]

    @property
    def total(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())

    def as_yaml(self) -> dict:
        """Return the entry of the file in metadata.yaml."""
        start, duration = _times(self.span or (0, 0))
        return {"path": self.file, "starting_time": start, "duration": duration, "message_count": self.total}


def _times(span: tuple[int, int]) -> tuple[dict, dict]:
    """Return begin and duration of a span of log times (ns) in the notation of rosbag2."""
    return {"nanoseconds_since_epoch": span[0]}, {"nanoseconds": span[1] - span[0]}


def _contents(file: Path) -> _Contents:
    """Return what a file holds, by reading it."""
    counts: dict[str, int] = {}
    times = []
    for raw in open_file(file).messages():
        counts[raw.topic] = counts.get(raw.topic, 0) + 1
        times.append(raw.log_time_ns)
    return _Contents(file.name, (min(times), max(times)) if times else None, counts)


@dataclass
class _TopicRecord:
    channel: int
    metadata: dict
    count: int = 0


class BagWriter:
    """Writes one bag.

    Args:
        folder: must not contain a bag, unless `resume`.
        custom: texts by name to store in the bag (hashes of the models, files of the configuration).
        resume: continue a bag in a further file.

    Raises:
        UsageError: the folder cannot be written.
    """

    def __init__(self, folder: str | os.PathLike, custom: dict[str, str] | None = None, resume: bool = False):
        self.folder = Path(folder)
        self._custom = dict(custom or {})
        self._topics: dict[str, _TopicRecord] = {}
        self._schemas: dict[str, int] = {}
        self._span = None
        self._earlier = [_contents(file) for file in bags.mcap_files(self.folder)] if resume else []
        self._name = f"{self.folder.name}_{len(self._earlier)}.mcap"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._stream = _CompleteFile(self.folder / self._name)
        except FileExistsError as error:
            raise UsageError(f"{self.folder} holds a bag already; choose another folder") from error
        except OSError as error:
            raise UsageError(f"{self.folder} cannot be written: {error.strerror}") from error
        # Writer uses only two methods of its stream.
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES)  # pyright: ignore[reportArgumentType]
        self._writer.start(profile="ros2")
        if self._custom:
            self._writer.add_metadata(CUSTOM_DATA, self._custom)
        self._stream.commit()
        self._write_metadata()

    def add_topic(self, name: str, type_name: str, qos: str = "") -> None:
        """Declare a topic, of a type that is installed here, before its first message.

        Args:
            name: full name.
            type_name: its type, as in `nav_msgs/msg/Odometry`.
            qos: offered profiles, as a YAML list in the notation of rosbag2.
        """
        if name not in self._topics:
            self.add_recorded_topic(Topic(name, type_name, schema_text(type_name).encode(), qos, type_hash(type_name)))

    def add_recorded_topic(self, topic: Topic) -> None:
        """Declare a topic as another bag describes it, before its first message."""
        name, type_name, qos = topic.name, topic.type, topic.qos
        if name in self._topics:
            return
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", topic.definition)
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": topic.type_hash}
        channel = self._writer.register_channel(name, "cdr", self._schemas[type_name], metadata)
        notes = {"channel": str(channel), "topic": name, "type": type_name, "qos": qos, "type_hash": topic.type_hash}
        self._writer.add_metadata(TOPIC, notes)
        described = {
            "name": name,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": yaml.safe_load(qos) or [],
            "type_description_hash": metadata["topic_type_hash"],
        }
        self._topics[name] = _TopicRecord(channel, described)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None) -> None:
        """Append one serialized message of a declared topic.

        Raises:
            OSError: the disk is full, for example. Earlier messages stay readable.
        """
        record = self._topics[topic]
        publish_time_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        self._writer.add_message(record.channel, log_time_ns, data, publish_time_ns, record.count)
        record.count += 1
        first, last = self._span or (log_time_ns, log_time_ns)
        self._span = min(first, log_time_ns), max(last, log_time_ns)
        if self._stream.commit() and self._metadata_is_old():
            self._write_metadata()

    def close(self) -> None:
        """Write the last chunk, the index and the final metadata. Raises OSError like `write`."""
        try:
            self._writer.finish()
            self._stream.commit(last=True)
            self._write_metadata()
        finally:
            self._stream.close()

    def _metadata_is_old(self) -> bool:
        return self._described[0] < len(self._topics) or time.monotonic() - self._described[1] > METADATA_EVERY_S

    def _write_metadata(self) -> None:
        self._described = len(self._topics), time.monotonic()
        counts = {name: record.count for name, record in self._topics.items()}
        parts = [*self._earlier, _Contents(self._name, self._span, counts)]
        spans = [part.span for part in parts if part.span] or [(0, 0)]
        start, duration = _times((min(first for first, _ in spans), max(last for _, last in spans)))
        information = {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": sum(part.total for part in parts),
            "topics_with_message_count": [
                {
                    "topic_metadata": record.metadata,
                    "message_count": sum(part.counts.get(name, 0) for part in parts),
                }
                for name, record in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [part.file for part in parts],
            "files": [part.as_yaml() for part in parts],
            "custom_data": {name: text for name, text in self._custom.items() if "\n" not in text} or None,
            "ros_distro": "jazzy",
        }
        partial = self.folder / "metadata.yaml.part"
        partial.write_text(yaml.dump({"rosbag2_bagfile_information": information}, Dumper=_Dumper, sort_keys=False))
        partial.replace(self.folder / "metadata.yaml")


# libyaml's takes a tenth of the time, where it is installed. A type checker does not know what getattr returns.
class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # pyright: ignore[reportGeneralTypeIssues]
    def ignore_aliases(self, data) -> bool:
        return True
