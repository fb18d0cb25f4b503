"""rosbag2 MCAP folders: written so that they can be read after any crash, read with every flaw named.

A folder holds `metadata.yaml` (version 9) and one `.mcap` file with raw serialized messages and their `ros2msg`
schemas, as `ros2 bag`, Foxglove, PlotJuggler, `rosbags` and `mcap` read them.
"""

import contextlib
import json
import os
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from swift_ros import messages
from swift_ros.configuration import prefixes
from swift_ros.errors import UsageError

CHUNK_BYTES = 256 * 1024
METADATA_EVERY_S = 1.0
_MAGIC = b"\x89MCAP0\r\n"
# DataEnd and Footer without a summary, then the magic: what makes an MCAP file complete.
_TAIL = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + _MAGIC


class _CompleteFile:
    """A stream for mcap's Writer whose file ends with a valid tail after every `commit`.

    The next commit overwrites the tail in the same system call that writes the new data, so a process killed at any
    moment leaves a file that every MCAP reader accepts.
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
        """Write what is pending and the tail (the last commit has its own); return whether there was anything."""
        if not self._pending:
            return False
        try:
            self._write(bytes(self._pending) + (b"" if last else _TAIL))
        except OSError:
            # the torn block goes, and with it the space it took, in which the tail fits again
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
    """Writes one bag folder.

    folder: must not hold a bag yet; custom: text by name that travels in the bag (hashes of models and configuration,
    the configuration's files). Raises UsageError when the folder cannot be written.
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
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="ros2")
        if self._custom:
            self._writer.add_metadata("swift", self._custom)
        self._stream.commit()
        self._write_metadata()

    def add_topic(self, name: str, type_name: str, qos: str = "") -> None:
        """Declare a topic before its first message; `qos` is rosbag2's YAML list of offered profiles."""
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
        """Append one serialized message of a declared topic. Raises OSError, as when the disk is full: what was written
        before stays readable."""
        record = self._topics[topic]
        publish_time_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        self._writer.add_message(record.channel, log_time_ns, data, publish_time_ns, record.count)
        record.count += 1
        first, last = self._span or (log_time_ns, log_time_ns)
        self._span = min(first, log_time_ns), max(last, log_time_ns)
        if self._stream.commit() and self._metadata_is_old():
            self._write_metadata()

    def close(self) -> None:
        """Write the last chunk, the index and the final metadata. Raises OSError as `write` does."""
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


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # libyaml's, a tenth of the time, where it is there
    def ignore_aliases(self, data) -> bool:
        return True


@dataclass(frozen=True)
class RawMessage:
    """One recorded message: topic, type name, CDR bytes, and the two times in ns."""

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


def is_cut_off(path: str | os.PathLike) -> bool:
    """Return whether a bag's file ends in the middle, as after a copy that was interrupted."""
    with open(mcap_file(path), "rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - len(_MAGIC)))
        return stream.read() != _MAGIC


def read_raw(path: str | os.PathLike, topics=None) -> Iterator[RawMessage]:
    """Yield the messages of a bag in log order, of all or the named topics.

    A file that was cut off is read up to the cut. Raises UsageError when it is no MCAP file at all.
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
                yield _raw(schema, channel, message)
        else:
            yield from sorted(_scan(stream, wanted), key=lambda raw: raw.log_time_ns)


def _scan(stream, wanted) -> Iterator[RawMessage]:
    """Yield messages of a file without index, in file order, until it ends or is torn."""
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


def read(path: str | os.PathLike, topics=None) -> Iterator[tuple[str, object, int]]:
    """Yield (topic, ROS message, log_time_ns) of a bag in log order. Raises as `read_raw` does."""
    for raw in read_raw(path, topics):
        yield raw.topic, messages.deserialize(raw.data, raw.type), raw.log_time_ns


def topic_types(path: str | os.PathLike) -> dict[str, str]:
    """Return the type of each topic that has a channel in the bag."""
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
    """Return what the recorder put into the bag besides messages: hashes and configuration, text by name."""
    with open(mcap_file(path), "rb") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if isinstance(record, Metadata) and record.name == "swift":
                    return dict(record.metadata)
        except (McapError, struct.error, EOFError):
            return {}
    return {}


def require(path: str | os.PathLike, topic: str) -> None:
    """Raise UsageError, naming what there is, when a bag lacks a topic."""
    there = topic_types(path)
    if topic not in there:
        raise UsageError(f"{path} has no topic {topic}; it has {', '.join(sorted(there)) or 'none'}")


def _share(package: str) -> Path:
    for prefix in prefixes():
        if (prefix / "share" / package / "package.xml").is_file():
            return prefix / "share" / package
    raise UsageError(f"the message package {package} is not installed; run make setup")


_PRIMITIVES = ("bool", "byte", "char", "float32", "float64", "int", "uint", "string", "wstring")


def schema_text(type_name: str) -> str:
    """Return the concatenated `ros2msg` definition of a type and of everything it holds."""
    written, text = set(), []
    pending = [type_name]
    while pending:
        name = pending.pop(0)
        if name in written:
            continue
        written.add(name)
        package, _, message = name.split("/")
        definition = (_share(package) / "msg" / f"{message}.msg").read_text()
        short = f"{package}/{message}"
        text.append(definition if not text else f"{'=' * 80}\nMSG: {short}\n{definition}")
        pending += _used_types(definition, package)
    return "\n".join(text)


def _used_types(definition: str, package: str) -> list[str]:
    names = []
    for line in definition.splitlines():
        words = line.split("#")[0].split()
        kind = words[0].split("[")[0].split("<")[0] if len(words) > 1 else ""
        if not kind or kind.startswith(_PRIMITIVES):
            continue
        kind = kind if "/" in kind else "std_msgs/Header" if kind == "Header" else f"{package}/{kind}"
        owner, message = kind.split("/")[0], kind.split("/")[-1]
        names.append(f"{owner}/msg/{message}")
    return names


def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a type, empty where its description is not installed."""
    package, _, message = type_name.split("/")
    description = _share(package) / "msg" / f"{message}.json"
    if not description.is_file():
        return ""
    hashes = json.loads(description.read_text()).get("type_hashes", [])
    return next((row["hash_string"] for row in hashes if row["type_name"] == type_name), "")
