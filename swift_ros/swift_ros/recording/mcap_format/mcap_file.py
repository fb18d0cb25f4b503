"""Reads one MCAP file, sound or damaged: all chunks whose checksum holds; what lies between them is named.

A file with a sound summary gives the place, the times and the topics of every chunk. Without it (the recording was
killed, the copy was cut, the summary itself is damaged) the file is scanned: after damage, reading resumes at the next
record that is sound.
"""

import bisect
import math
import mmap
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap import records
from mcap.opcode import Opcode

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.recording.mcap_format.mcap_records import (
    FOOTER,
    MAGIC,
    MESSAGE,
    UNREADABLE,
    chunk_content,
    next_sound_record,
    parse,
    read_records,
    record_at,
)

CUSTOM_DATA = "swift"  # name of the metadata record of this graph's bags
# Name of the metadata records of this graph's bags that describe a topic outside the chunks: MCAP describes it in the
# first chunk and in the summary, and a killed recorder writes no summary.
TOPIC = "swift_topic"
# What is missing where a file is damaged; the times are those after the first message.
_MESSAGES = "the messages from {0} to {1} are missing"
_BETWEEN = "messages between {0} and {1} may be missing"
_TOPICS = "messages from {0} to {1} are missing, because the description of their topics is"
_CUSTOM = "the stored configuration is missing"
_CUT = "the file was cut there, and the messages after {0} are missing"


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


@dataclass(frozen=True)
class Topic:
    """A recorded topic.

    Attributes:
        name: full name.
        type: as in `nav_msgs/msg/Odometry`.
        definition: text of the type's schema.
        qos: offered profiles, as a YAML list in the notation of rosbag2.
        type_hash: hash of the type, empty when unknown.
    """

    name: str
    type: str
    definition: bytes
    qos: str
    type_hash: str


@dataclass(frozen=True)
class Damage:
    """A part of a file that cannot be read.

    Attributes:
        file: name of the file.
        first_byte: position of the part.
        end_byte: position behind the part.
        loss: what is missing, a phrase with the places of two times.
        span_ns: log times (first, last) of what is missing, ns.
        begin_ns: log time of the file's first message, ns.
    """

    file: str
    first_byte: int
    end_byte: int
    loss: str
    span_ns: tuple[int, int]
    begin_ns: int

    def __str__(self) -> str:
        first, last = (f"{(time_ns - self.begin_ns) * 1e-9:.3f} s" for time_ns in self.span_ns)
        loss = self.loss.format(first, last)
        return f"bytes {self.first_byte} to {self.end_byte} of {self.file} are damaged: {loss}"


@dataclass(frozen=True)
class _Part:
    """Records that lie together: a chunk, or loose ones; with the log times of their messages, ns."""

    first_byte: int
    end_byte: int
    span_ns: tuple[int, int]
    is_chunk: bool = True


@dataclass
class McapFile:
    """What an MCAP file holds. Made by `open_file`.

    Attributes:
        path: the file.
        topics: by channel number.
        custom: the custom data of this graph's bags, texts by name.
    """

    path: Path
    topics: dict[int, Topic] = field(default_factory=dict)
    custom: dict[str, str] = field(default_factory=dict)
    _content: mmap.mmap | bytes = b""
    _parts: list[_Part] = field(default_factory=list)
    _without_type: set[int] = field(default_factory=set)  # numbers of channels without a schema: they are no ROS topics
    _damaged: list[tuple[int, int, str]] = field(default_factory=list)  # byte ranges, when the file was opened; losses

    def messages(self, wanted: set[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of topics (None: of all) in the order of log times.

        Warns:
            DamagedRecording: for each part that cannot be read.
        """
        for item in self.contents(wanted):
            if isinstance(item, Damage):
                warnings.warn(f"{self.path}: {item}", DamagedRecording, stacklevel=2)
            else:
                yield item

    def damage(self) -> list[Damage]:
        """Return all parts that cannot be read. It reads the whole file."""
        return [item for item in self.contents(set()) if isinstance(item, Damage)]

    def contents(self, wanted: set[str] | None = None) -> Iterator[RawMessage | Damage]:
        """Yield the messages of topics in the order of log times, and each damaged part when its time has come."""
        parts = sorted(self._parts, key=lambda part: (part.span_ns[0], part.first_byte))
        begin_ns = parts[0].span_ns[0] if parts else 0
        for first, end, loss in self._damaged:
            yield Damage(self.path.name, first, end, loss, self._span_between(first, end), begin_ns)
        waiting: list[RawMessage] = []
        begins_ns = [*(part.span_ns[0] for part in parts), math.inf]
        for part, next_ns in zip(parts, begins_ns[1:], strict=True):
            try:
                found, loss = self._part_messages(part, wanted)
            except UNREADABLE:
                found, loss = [], _MESSAGES
            if loss:
                yield Damage(self.path.name, part.first_byte, part.end_byte, loss, part.span_ns, begin_ns)
            waiting += found
            waiting.sort(key=_log_time)
            due = bisect.bisect_left(waiting, next_ns, key=_log_time)
            yield from waiting[:due]
            del waiting[:due]

    def _part_messages(self, part: _Part, wanted: set[str] | None) -> tuple[list[RawMessage], str]:
        """Return the wanted messages of a part and its loss. Raises one of UNREADABLE."""
        content = self._content[part.first_byte : part.end_byte]
        found, loss = [], ""
        for opcode, body in read_records(chunk_content(content) if part.is_chunk else content):
            if opcode != Opcode.MESSAGE:
                continue
            channel, _, log_time_ns, publish_time_ns = MESSAGE.unpack_from(body)
            topic = self.topics.get(channel)
            if topic is None:
                loss = loss if channel in self._without_type else _TOPICS
            elif wanted is None or topic.name in wanted:
                data = bytes(body[MESSAGE.size :])
                found.append(RawMessage(topic.name, topic.type, data, log_time_ns, publish_time_ns))
        return found, loss

    def _span_between(self, first: int, end: int) -> tuple[int, int]:
        """Return the log times between which the messages of a byte range are, from those of its neighbours."""
        before = [part.span_ns[1] for part in self._parts if part.end_byte <= first]
        after = [part.span_ns[0] for part in self._parts if part.first_byte >= end]
        known = [*before, *after] or [0]
        return max(before, default=min(known)), min(after, default=max(known))


def open_file(path: Path) -> McapFile:
    """Return an MCAP file. Raises UsageError when it is none, or cannot be opened."""
    try:
        with open(path, "rb") as stream:
            is_empty = not stream.seek(0, 2)
            content = b"" if is_empty else mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    file = McapFile(path, _content=content)
    if not _read_summary(file):
        _scan(file)
        if content[: len(MAGIC)] != MAGIC and not file._parts:
            raise UsageError(f"{path} is not an MCAP file")
    return file


def _read_summary(file: McapFile) -> bool:
    """Read the parts and topics of a file from its summary; return whether there is a sound one with chunks."""
    content = file._content
    footer_at = len(content) - len(MAGIC) - FOOTER.size
    if footer_at < len(MAGIC) or content[-len(MAGIC) :] != MAGIC:
        return False
    *_, begin, _, checksum = FOOTER.unpack_from(content, footer_at)
    covered = content[begin : footer_at + FOOTER.size - 4]  # up to the checksum
    if not len(MAGIC) < begin < footer_at or (checksum and zlib.crc32(covered) != checksum):
        return False
    try:
        found = [parse(opcode, body) for opcode, body in read_records(content[begin:footer_at])]
    except UNREADABLE:
        return False
    _describe_topics(file, found)
    for row in found:
        if isinstance(row, records.ChunkIndex):
            span = row.message_start_time, row.message_end_time
            end = row.chunk_start_offset + row.chunk_length
            file._parts.append(_Part(row.chunk_start_offset, end, span))
        elif isinstance(row, records.MetadataIndex) and row.name == CUSTOM_DATA:
            _read_metadata(file, row.offset, row.offset + row.length)
    return bool(file._parts)


def _read_metadata(file: McapFile, first: int, end: int) -> None:
    """Read the metadata record at a byte range: the custom data, or the description of a topic."""
    try:
        ((opcode, body),) = read_records(file._content[first:end])
        row = parse(opcode, body)
        if not isinstance(row, records.Metadata):
            raise ValueError("no metadata")
        if row.name == CUSTOM_DATA:
            file.custom = dict(row.metadata)
        elif row.name == TOPIC:
            notes = row.metadata
            topic = Topic(notes["topic"], notes["type"], b"", notes["qos"], notes["type_hash"])
            file.topics[int(notes["channel"])] = topic
    except UNREADABLE:
        file._damaged.append((first, end, _CUSTOM))


def _describe_topics(file: McapFile, found: list[records.McapRecord]) -> None:
    """Read the topics of a file from its schemas and channels; later ones replace earlier ones of the same number."""
    schemas = {row.id: row for row in found if isinstance(row, records.Schema)}
    for row in found:
        if isinstance(row, records.Channel) and row.schema_id in schemas:
            schema, notes = schemas[row.schema_id], row.metadata
            qos, type_hash = notes.get("offered_qos_profiles", ""), notes.get("topic_type_hash", "")
            file.topics[row.id] = Topic(row.topic, schema.name, schema.data, qos, type_hash)
        elif isinstance(row, records.Channel) and row.schema_id == 0:
            file._without_type.add(row.id)


def _scan(file: McapFile) -> None:
    """Read the parts and topics of a file from its records, in their order."""
    content, loose, checked = file._content, [], []
    file._parts.clear()
    file._damaged.clear()
    at, last = (len(MAGIC) * (part == MAGIC) for part in (content[: len(MAGIC)], content[-len(MAGIC) :]))
    while at < len(content) - last:
        try:
            opcode, body, end = record_at(content, at)
            if opcode == Opcode.MESSAGE and end < len(content) - last:
                record_at(content, end)  # has no checksum: what follows shows that its length is right
            if opcode == Opcode.CHUNK:
                inside = list(read_records(chunk_content(content[at:end])))
            else:
                inside = [(opcode, body)]
            rows = [parse(opcode, body) for opcode, body in inside if opcode in (Opcode.SCHEMA, Opcode.CHANNEL)]
            times = [MESSAGE.unpack_from(body)[2] for opcode, body in inside if opcode == Opcode.MESSAGE]
            if opcode == Opcode.METADATA:
                _read_metadata(file, at, end)
        except UNREADABLE:
            end = next_sound_record(content, at + 1, has_chunks=any(part.is_chunk for part in file._parts))
            file._damaged.append((at, end, _CUT if end == len(content) and not last else _BETWEEN))
        else:
            (checked if opcode == Opcode.CHUNK else loose).extend(rows)
            if times:
                file._parts.append(_Part(at, end, (min(times), max(times)), opcode == Opcode.CHUNK))
        at = end
    if not last and not any(loss == _CUT for *_, loss in file._damaged):  # cut between two records
        file._damaged.append((len(content), len(content), _CUT))
    _describe_topics(file, loose + checked)


def _log_time(raw: RawMessage) -> int:
    return raw.log_time_ns
