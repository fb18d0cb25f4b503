"""Reads PX4 ULog files (`.ulg`) with pyulog, sound or damaged.

pyulog gets the sound messages alone, and of these the kinds that matter here: at a message that it does not expect it
may end early without a word, or never. Topics have the names of PX4's uORB topics, with `[1]` .. for further instances.
"""

import contextlib
import functools
import io
import re
import struct
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from pyulog import ULog
from pyulog.exceptions import ULogException

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.recording.log_formats import sound_spans
from swift_ros.recording.log_formats.log import Log, LoggedTopic
from swift_ros.text import excerpt

MAGIC = ULog.HEADER_BYTES
BEGIN = 16  # bytes of the file's head
HEAD = struct.Struct("<HB")  # of a message: number of bytes of its content, and kind
TIME = struct.Struct("<Q")  # microseconds; at byte 2 of a message of data, behind the number of its subscription
FLAGS = struct.Struct("<16s3Q")  # content of the message of flags: flags, and where data was appended after a crash
SAMPLED = "timestamp_sample"  # column of the time of measurement; `timestamp` is that of publication
KINDS = frozenset(b"BFIMPQADRLCSO")
DATA, FLAG_BITS, FORMAT, DROPOUT, PARAMETER, SUBSCRIPTION = b"DBFOPA"
CHAIN = 8  # messages that must follow each other for reading to resume: 5 % of all bytes are a kind
MAX_FIELDS = 10_000  # of a message: ten times the largest of PX4
# What pyulog raises for a damaged file.
_UNREADABLE = (ULogException, struct.error, ValueError, TypeError, LookupError, AttributeError, OverflowError)
_UNREADABLE += (MemoryError, RecursionError, OSError)


def read(path: Path) -> Log:
    """Return the topics of a ULog file.

    Args:
        path: the file.

    Raises:
        UsageError: it is no ULog file, or holds no message that can be read.

    Warns:
        DamagedRecording: for each part that cannot be read, and for messages that the logger itself has lost.
    """
    content = _content(path)
    spans, damage = _sound(content)
    begin_us = TIME.unpack_from(content, 8)[0]
    if damage:
        sound_spans.warn(path, damage, begin_us)
    _refuse_absurd_formats(path, content, spans)
    sound = content[:BEGIN] + b"".join(_needed(content, spans))
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # its warnings repeat those above
            log = ULog(io.BytesIO(sound))
    except _UNREADABLE as error:
        raise UsageError(f"{path} cannot be read as ULog: {excerpt(str(error)) or 'it is damaged'}") from error
    if log.file_corruption:
        text = f"{path}: messages that do not fit their description are left out"
        warnings.warn(text, DamagedRecording, stacklevel=2)
    _warn_of_dropouts(path, log)
    topics = {_name(data): _topic(data) for data in log.data_list if len(data.data.get("timestamp", ())) > 1}
    if not topics:
        raise UsageError(f"{path} holds no topic with two messages; it is not a flight")
    numbers = {name: float(value) for name, value in log.initial_parameters.items() if isinstance(value, int | float)}
    return Log(path, "PX4 ULog", topics, numbers)


def _content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    if len(content) < BEGIN or not content.startswith(MAGIC):
        raise UsageError(f"{path} is not a ULog file: it does not begin with 'ULog' and the version")
    return content


def _sound(content: bytes) -> tuple[list[tuple[int, int]], list[sound_spans.Damage]]:
    """Return the sound byte ranges of a file and its damage; data appended after a crash begins where flags say."""
    spans, damage = [], []
    edges = [BEGIN, *_appended(content), len(content)]
    for first, end in zip(edges, edges[1:], strict=False):
        message_at = functools.partial(_message_at, content, end)
        found = sound_spans.sound_spans(first, end, message_at, lambda at: at, CHAIN)
        spans += found[0]
        damage += found[1]
    return spans, damage


def _message_at(content: bytes, end: int, at: int) -> sound_spans.Framed | None:
    if at + HEAD.size > end:
        return None
    size, kind = HEAD.unpack_from(content, at)
    after = at + HEAD.size + size
    if kind not in KINDS or after > end:
        return None
    if kind != DATA:
        return sound_spans.Framed(after, None)
    if size < 10:
        return None
    return sound_spans.Framed(after, TIME.unpack_from(content, at + 5)[0] or None)  # 0: never published


def _appended(content: bytes) -> list[int]:
    """Return the positions of data that was appended after a crash."""
    if len(content) < BEGIN + HEAD.size + FLAGS.size or content[BEGIN + 2] != FLAG_BITS:
        return []
    _, *offsets = FLAGS.unpack_from(content, BEGIN + HEAD.size)
    return sorted({at for at in offsets if BEGIN + HEAD.size + FLAGS.size < at < len(content)})


def _messages(content: bytes, spans: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int, int]]:
    """Yield (kind, first byte, end) of the messages in byte ranges."""
    for first, end in spans:
        while first < end:
            size, kind = HEAD.unpack_from(content, first)
            yield kind, first, first + HEAD.size + size
            first += HEAD.size + size


def _needed(content: bytes, spans: Iterable[tuple[int, int]]) -> list[bytes]:
    """Return the messages that pyulog gets: descriptions and parameters, then subscriptions, data and dropouts.

    A number that is subscribed a second time keeps its first topic.
    """
    definitions, data = [], []
    subscribed = set()
    for kind, first, end in _messages(content, spans):
        size = end - first - HEAD.size
        if kind == FORMAT or (kind == PARAMETER and not subscribed):
            definitions.append(content[first:end])
        elif kind == SUBSCRIPTION and size > 3:
            number = content[first + 4 : first + 6]
            if number not in subscribed:
                subscribed.add(number)
                data.append(content[first:end])
        elif kind == DATA or (kind == DROPOUT and size == 2):
            data.append(content[first:end])
    return definitions + data


def _refuse_absurd_formats(path: Path, content: bytes, spans: Iterable[tuple[int, int]]) -> None:
    """Raise UsageError for a message whose fields, with those of the messages in it, are absurdly many."""
    formats: dict[str, list[tuple[str, int]]] = {}
    for kind, first, end in _messages(content, spans):
        if kind == FORMAT:
            name, _, fields = content[first + HEAD.size : end].decode("utf-8", "ignore").partition(":")
            found = re.finditer(r"(\w+)(?:\[(\d{1,9})\])? \w+;", fields)
            formats[name] = [(match[1], int(match[2] or 1)) for match in found]
    counts: dict[str, int] = {}

    def count(name: str, depth: int = 0) -> int:
        if name not in formats:
            return 1
        if depth > 20:
            return MAX_FIELDS + 1
        if name not in counts:
            counts[name] = min(sum(n * count(kind, depth + 1) for kind, n in formats[name]), MAX_FIELDS + 1)
        return counts[name]

    for name in formats:
        if count(name) > MAX_FIELDS:
            raise UsageError(f"{path} describes '{excerpt(name)}' with more than {MAX_FIELDS} fields; it is damaged")


def _warn_of_dropouts(path: Path, log: ULog) -> None:
    """Warn of messages that the logger could not write in time."""
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        longest_s = max(dropout.duration for dropout in log.dropouts) * 1e-3
        text = f"{path}: the logger has lost messages {len(log.dropouts)} times, for {lost_s:.2f} s in all and up to "
        text += f"{longest_s:.3f} s at a time; use a faster SD card"
        warnings.warn(text, DamagedRecording, stacklevel=3)


def _name(data: ULog.Data) -> str:
    return data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"


def _topic(data: ULog.Data) -> LoggedTopic:
    """Return a topic at the times of measurement; a command counts from the time at which it was published."""
    columns = {name: np.asarray(values) for name, values in data.data.items()}
    measured = not data.name.startswith("actuator") and np.all(columns.get(SAMPLED, 0) > 0)
    return LoggedTopic(columns[SAMPLED if measured else "timestamp"].astype(float) * 1e-6, columns, data.name)
