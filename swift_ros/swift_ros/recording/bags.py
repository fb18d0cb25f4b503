"""rosbag2 MCAP bags: written so that they are readable after any crash; errors of a bag are reported.

A bag is a folder with `metadata.yaml` (version 9) and one `.mcap` file, which holds serialized messages and their
`ros2msg` schemas. `ros2 bag`, Foxglove, PlotJuggler, `rosbags` and `mcap` read it.
"""

import contextlib
import os
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from swift_ros import messages
from swift_ros.errors import UsageError
from swift_ros.recording.message_definitions import schema_text, type_hash

CHUNK_BYTES = 256 * 1024  # bytes; a killed recorder loses at most one incomplete chunk
METADATA_EVERY_S = 1.0  # s; shortest period between two writes of metadata.yaml
_MAGIC = b"\x89MCAP0\r\n"
# End of a complete MCAP file: records DataEnd and Footer (without a summary), then the magic bytes.
_TAIL = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + _MAGIC


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


@dataclass
class _TopicRecord:
    channel: int
    metadata: dict
    count: int = 0


class BagWriter:
    """Writes one bag.

    Args:
        folder: must not contain a bag.
        custom: texts by name to store in the bag (hashes of the models, files of the configuration).

    Raises:
        UsageError: the folder cannot be written.
    """

    def __init__(self, folder: str | os.PathLike, custom: dict[str, str] | None = None):
        self.folder = Path(folder)
        self._custom = dict(custom or {})
        self._topics: dict[str, _TopicRecord] = {}
        self._schemas: dict[str, int] = {}
        self._span = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._stream = _CompleteFile(self.folder / f"{self.folder.name}_0.mcap")
        except FileExistsError as error:
            raise UsageError(f"{self.folder} holds a bag already; choose another folder") from error
        except OSError as error:
            raise UsageError(f"{self.folder} cannot be written: {error.strerror}") from error
        # Writer uses only two methods of its stream.
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES)  # pyright: ignore[reportArgumentType]
        self._writer.start(profile="ros2")
        if self._custom:
            self._writer.add_metadata("swift", self._custom)
        self._stream.commit()
        self._write_metadata()

    def add_topic(self, name: str, type_name: str, qos: str = "") -> None:
        """Declare a topic before its first message.

        Args:
            name: full name.
            type_name: its type, as in `nav_msgs/msg/Odometry`.
            qos: offered profiles, as a YAML list in the notation of rosbag2.
        """
        if name in self._topics:
            return
        if type_name not in self._schemas:
            text = schema_text(type_name).encode()
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text)
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash(type_name)}
        channel = self._writer.register_channel(name, "cdr", self._schemas[type_name], metadata)
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
        first, last = self._span or (0, 0)
        total = sum(record.count for record in self._topics.values())
        start, duration = {"nanoseconds_since_epoch": first}, {"nanoseconds": last - first}
        file = f"{self.folder.name}_0.mcap"
        information = {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": total,
            "topics_with_message_count": [
                {"topic_metadata": record.metadata, "message_count": record.count} for record in self._topics.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file],
            "files": [{"path": file, "starting_time": start, "duration": duration, "message_count": total}],
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


@dataclass(frozen=True)
class RawMessage:
    """One recorded message.

    Attributes:
        topic: full name.
        type: as in `nav_msgs/msg/Odometry`.
        data: CDR bytes.
        log_time_ns: time of recording, ns.
        publish_time_ns: time of publication, ns.
    """

    topic: str
    type: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int


def mcap_file(path: str | os.PathLike) -> Path:
    """Return the `.mcap` file of a bag given as folder or file. Raises UsageError when there is none."""
    path = Path(path)
    if path.is_file() and path.suffix == ".mcap":
        return path
    files = sorted(path.glob("*.mcap")) if path.is_dir() else []
    if not files:
        raise UsageError(f"{path} holds no .mcap file; give a bag folder or an .mcap file")
    return files[0]


def is_truncated(path: str | os.PathLike) -> bool:
    """Return whether a bag's file lacks its end, as after an interrupted copy."""
    with open(mcap_file(path), "rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - len(_MAGIC)))
        return stream.read() != _MAGIC


def read_raw(path: str | os.PathLike, topics=None) -> Iterator[RawMessage]:
    """Yield the messages of a bag in the order of log times; a truncated file is read up to its end.

    Args:
        path: bag folder or .mcap file.
        topics: full names; None for all.

    Raises:
        UsageError: the file is not an MCAP file.
    """
    file = mcap_file(path)
    wanted = None if topics is None else set(topics)
    with open(file, "rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise UsageError(f"{file} is not an MCAP file")
        stream.seek(0)
        try:
            indexed = make_reader(stream).get_summary() is not None
        except (McapError, struct.error, EOFError):
            indexed = False
        stream.seek(0)
        if indexed:
            for schema, channel, message in make_reader(stream).iter_messages(topics=topics):
                assert schema is not None  # every channel of a bag has one
                yield _raw(schema, channel, message)
        else:
            yield from sorted(_scan(stream, wanted), key=lambda raw: raw.log_time_ns)


def _scan(stream, wanted) -> Iterator[RawMessage]:
    """Yield the messages of a file without index, in file order, up to its end or its first incomplete record."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    try:
        for outer in StreamReader(stream, emit_chunks=True).records:
            for record in breakup_chunk(outer) if isinstance(outer, Chunk) else (outer,):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    if wanted is None or channel.topic in wanted:
                        yield _raw(schemas[channel.schema_id], channel, record)
    except (McapError, struct.error, EOFError):
        return


def _raw(schema: Schema, channel: Channel, message: Message) -> RawMessage:
    return RawMessage(channel.topic, schema.name, message.data, message.log_time, message.publish_time)


def read(path: str | os.PathLike, topics=None) -> Iterator[tuple[str, Any, int]]:
    """Yield (topic, ROS message, log_time_ns) of a bag in the order of log times. Raises like `read_raw`."""
    for raw in read_raw(path, topics):
        yield raw.topic, messages.deserialize(raw.data, raw.type), raw.log_time_ns


def topic_types(path: str | os.PathLike) -> dict[str, str]:
    """Return the type of each topic in the bag."""
    file = mcap_file(path)
    with open(file, "rb") as stream:
        try:
            summary = make_reader(stream).get_summary()
        except (McapError, struct.error, EOFError):
            summary = None
    if summary is not None:
        return {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    return {raw.topic: raw.type for raw in read_raw(path)}


def custom_data(path: str | os.PathLike) -> dict[str, str]:
    """Return the custom data of a bag: texts by name, such as hashes and the configuration."""
    with open(mcap_file(path), "rb") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if isinstance(record, Metadata) and record.name == "swift":
                    return dict(record.metadata)
        except (McapError, struct.error, EOFError):
            return {}
    return {}


def require(path: str | os.PathLike, topic: str) -> None:
    """Raise UsageError, with the names of all topics, when a bag lacks a topic."""
    present = topic_types(path)
    if topic not in present:
        raise UsageError(f"{path} has no topic {topic}; it has {', '.join(sorted(present)) or 'none'}")
