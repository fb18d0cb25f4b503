"""Reads ArduPilot DataFlash logs, binary (`.bin`) and text (`.log`), sound or damaged.

pymavlink gives the meaning of a message's description (its DFFormat); all messages of a kind are decoded at once,
which takes a hundredth of the time of its reader. Topics have the names of the messages; instances are `IMU[0]` ..
"""

import functools
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFFormat

from swift_ros.errors import UsageError
from swift_ros.recording.log_formats import sound_spans
from swift_ros.recording.log_formats.log import Log, LoggedTopic
from swift_ros.recording.table_formats.damaged_rows import DamagedRows
from swift_ros.recording.table_formats.damaged_rows import warn as warn_of_rows

BINARY, TEXT = b"\xa3\x95", b"FMT,"  # begin of a message; text in the first lines
DESCRIPTION = 0x80  # kind of the messages that describe a kind
HEAD = 3  # bytes of a message before its fields
CHAIN = 3  # messages that must follow each other for reading to resume
TIMES = {"TimeUS": 1.0, "TimeMS": 1e3}  # first field of a message, and its microseconds
PARAMETERS, UNITS = "PARM", "FMTU"
MAX_TRAILING = 528  # bytes; block devices fill the last page of a log


def read(path: Path) -> Log:
    """Return the topics of a DataFlash log.

    Args:
        path: the file.

    Raises:
        UsageError: it is no DataFlash log, or holds no message that can be read.

    Warns:
        DamagedRecording: for each part that cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    if content.startswith(BINARY):
        kinds, values = _binary(path, content)
    elif TEXT in content[:8000]:
        kinds, values = _text(path, content)
    else:
        raise UsageError(f"{path} is not a DataFlash log: neither binary (A3 95) nor text (FMT, ..)")
    parameters: dict[str, float] = {}
    topics: dict[str, LoggedTopic] = {}
    for name, rows in values.items():
        kind = kinds[name]
        if name == PARAMETERS and {"Name", "Value"} <= set(rows):
            parameters = {str(key): float(value) for key, value in zip(rows["Name"], rows["Value"], strict=True)}
        topics |= _topics(name, kind, rows)
    if not topics:
        raise UsageError(f"{path} holds no message with a time twice; it is not a flight")
    return Log(path, "ArduPilot DataFlash", topics, parameters)


def _topics(name: str, kind: DFFormat, rows: dict[str, np.ndarray]) -> dict[str, LoggedTopic]:
    """Return the messages of a kind as a topic, or as one for each instance."""
    time = kind.columns[0] if kind.columns else ""
    if time not in TIMES or time not in rows or len(rows[time]) < 2:
        return {}
    numbers = {column: values for column, values in rows.items() if values.dtype != object}
    t = rows[time].astype(float) * TIMES[time] * 1e-6
    instance = kind.instance_field or next((column for column in ("I", "Instance") if column in numbers), None)
    if instance not in numbers:
        return {name: LoggedTopic(t, numbers, name)}
    found = {}
    for number in np.unique(numbers[instance]):
        chosen = numbers[instance] == number
        columns = {column: values[chosen] for column, values in numbers.items()}
        if np.count_nonzero(chosen) > 1:
            found[f"{name}[{number:g}]"] = LoggedTopic(t[chosen], columns, name)
    return found


def described(kind: int, length: int, name: str, types: str, columns: str) -> DFFormat | None:
    """Return the description of a kind of messages, None where its fields do not fit its length or names.

    Firmware of some years describes a few kinds so; their messages are passed over.
    """
    names = columns.split(",") if columns else []
    if not name.isalnum() or any(letter not in FORMAT_TO_STRUCT for letter in types) or len(names) != len(types):
        return None
    if len(set(names)) != len(names) or not all(column and column.isprintable() for column in names):
        return None
    found = DFFormat(kind, name, length, types, columns)
    return found if struct.calcsize(found.msg_struct) + HEAD == length else None


_FMT = DFFormat(DESCRIPTION, "FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns")


def _binary(path: Path, content: bytes) -> tuple[dict[str, DFFormat], dict[str, dict]]:
    """Return the kinds of messages by name, and their values by column."""
    kinds: dict[int, DFFormat] = {DESCRIPTION: _FMT}
    message_at = functools.partial(_message_at, content, kinds)
    spans, damage = sound_spans.sound_spans(0, len(content), message_at, _candidate(content), CHAIN)
    if damage and _is_filling(content[damage[-1].first_byte :]):
        damage.pop()
    places: dict[int, list[int]] = {}
    for first, end in spans:
        while first < end:
            places.setdefault(content[first + 2], []).append(first)
            first += kinds[content[first + 2]].len
    values = {
        str(kinds[kind].name): _decoded(content, kinds[kind], at) for kind, at in places.items() if kinds[kind].columns
    }
    by_name = {str(kind.name): kind for kind in kinds.values()}
    _name_instances(by_name, kinds, values.get(UNITS))
    firsts = (rows[column][0] * us for rows in values.values() for column, us in TIMES.items() if column in rows)
    sound_spans.warn(path, damage, int(min(firsts, default=0)))
    return by_name, values


def _is_filling(rest: bytes) -> bool:
    """Return whether the end of a log is the rest of a block of the storage, without content."""
    return len(rest) < MAX_TRAILING and not rest.strip(b"\xff\0")


def _message_at(content: bytes, kinds: dict[int, DFFormat], at: int) -> sound_spans.Framed | None:
    """Return the message at a position; a description adds its kind."""
    if content[at : at + 2] != BINARY or at + HEAD > len(content) or content[at + 2] not in kinds:
        return None
    kind = kinds[content[at + 2]]
    end = at + kind.len
    if end > len(content):
        return None
    if kind.type == DESCRIPTION:
        number, length, *texts = struct.unpack_from(_FMT.msg_struct, content, at + HEAD)
        name, types, columns = (text.partition(b"\0")[0].decode("latin-1") for text in texts)
        found = described(number, length, name, types, columns)
        if found is None and not (name.isalnum() and length > HEAD):
            return None
        kinds.setdefault(number, found or DFFormat(number, name, length, "", ""))
    time = kind.columns[0] if kind.columns else ""
    if time not in TIMES or kind.format[0] not in "QI":
        return sound_spans.Framed(end, None)
    (value,) = struct.unpack_from("<" + kind.format[0], content, at + HEAD)
    return sound_spans.Framed(end, int(value * TIMES[time]))


def _candidate(content: bytes) -> Callable[[int], int]:
    def candidate(at: int) -> int:
        found = content.find(BINARY, at)
        return len(content) if found < 0 else found

    return candidate


def _decoded(content: bytes, kind: DFFormat, places: Sequence[int]) -> dict[str, np.ndarray]:
    """Return the values (n,) of all messages of a kind by column."""
    size = kind.len - HEAD
    rows = np.frombuffer(content, np.uint8)[np.asarray(places)[:, None] + HEAD + np.arange(size)]
    types = [FORMAT_TO_STRUCT[letter][0] for letter in kind.format]
    types = [f"S{text[:-1]}" if text[-1] == "s" else "<f2" if text == "e" else f"<{text}" for text in types]
    fields = list(zip(kind.columns, types, strict=True))
    table = np.ascontiguousarray(rows).view(np.dtype(fields))[:, 0]
    found = {}
    for (name, text), mult in zip(fields, kind.msg_mults, strict=True):
        if text[0] == "S":
            found[name] = np.array([value.decode("latin-1") for value in table[name].tolist()], dtype=object)
        else:
            found[name] = table[name] * mult if mult else table[name].copy()
    return found


def _name_instances(by_name: dict[str, DFFormat], kinds: dict[int, DFFormat], units: dict | None) -> None:
    """Set the instance field of the kinds for which the log names one."""
    if units is None or not {"FmtType", "UnitIds"} <= set(units):
        return
    for number, text in zip(units["FmtType"], units["UnitIds"], strict=True):
        kind = by_name.get(str(kinds[int(number)].name)) if int(number) in kinds else None
        at = str(text).find("#")
        if kind is not None and 0 <= at < len(kind.columns):
            kind.set_instance_field(at)


def _text(path: Path, content: bytes) -> tuple[dict[str, DFFormat], dict[str, dict]]:
    """Return the kinds of messages by name, and their values by column, of a log in text form."""
    kinds: dict[str, DFFormat] = {"FMT": _FMT}
    rows: dict[str, list[list[str]]] = {}
    damaged: list[DamagedRows] = []
    for number, cells in _lines(content):
        kind = kinds.get(cells[0])
        if cells[0] == "FMT" and len(cells) >= 6:
            kind = _text_kind(cells)
            if kind:
                kinds[str(kind.name)] = kind
        elif kind and len(cells) == len(kind.columns) + 1:
            rows.setdefault(str(kind.name), []).append(cells[1:])
            continue
        elif kind and any(letter in "ZN" for letter in kind.format):
            continue  # a text with commas, such as MSG
        if not kind:
            damaged.append(DamagedRows(f"line {number}", None, None, "is no message that the log describes"))
    warn_of_rows(path, damaged)
    values = {name: _columns(kinds[name], found) for name, found in rows.items()}
    return kinds, {name: columns for name, columns in values.items() if columns}


def _lines(content: bytes) -> Iterator[tuple[int, list[str]]]:
    begin = content.find(TEXT)
    first = content[:begin].count(b"\n") + 1
    for number, line in enumerate(content[begin:].split(b"\n"), start=first):
        if line.strip():
            yield number, [cell.strip() for cell in line.decode("latin-1").split(",")]


def _text_kind(cells: list[str]) -> DFFormat | None:
    """Return the kind that a line of text describes; its length is that of its fields: old logs have others."""
    types, columns = cells[4], cells[5:]
    if any(letter not in FORMAT_TO_STRUCT for letter in types) or not cells[1].isdecimal() or len(cells[1]) > 3:
        return None
    length = HEAD + sum(struct.calcsize("<" + FORMAT_TO_STRUCT[letter][0]) for letter in types)
    return described(int(cells[1]), length, cells[3], types, ",".join(columns))


def _columns(kind: DFFormat, rows: list[list[str]]) -> dict[str, np.ndarray]:
    """Return the values (n,) by column of the rows whose numbers are numbers."""
    numeric = [i for i, letter in enumerate(kind.format) if letter not in "nNZa"]
    sound = [row for row in rows if all(_is_number(row[i]) for i in numeric)]
    columns = {kind.columns[i]: np.array([float(row[i]) for row in sound]) for i in numeric}
    texts = set(range(len(kind.columns))) - set(numeric)
    return columns | {kind.columns[i]: np.array([row[i] for row in sound], dtype=object) for i in texts}


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
