"""Reads the rows of a CSV table, sound or damaged: a row that is no row of numbers is left out and named.

CSV has no checksum. A damage is found where a row has another number of cells than the header, a cell is no number, a
line break stands within a cell, or the last line has no end. A digit that became another digit is not found.

A table compressed by gzip has one checksum at its end. One that was cut is read up to there; with any other damage no
row of it can be believed.
"""

import bisect
import io
import re
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.table_formats.damaged_rows import DamagedRows, warn
from swift_ros.text import excerpt

GZIP = ".gz"  # suffix
BYTE_ORDER_MARK = b"\xef\xbb\xbf"  # which Excel writes
EMPTY = ("", "nan", "na", "null", "none")  # texts of an empty cell, in lower case
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?|[+-]?inf(?:inity)?", re.IGNORECASE)


def column_names(path: Path) -> list[str]:
    """Return the names of the columns; one without a name is `column 1`. Raises UsageError when there is no header."""
    first, _, _ = _content(path).partition(b"\n")
    return _header(path, first, unnamed=True)


def read(path: Path, time: str, chosen: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Return the columns (n,) of a CSV table by name; an empty cell is NaN.

    Args:
        path: the file; one that ends with .gz is compressed.
        time: column of the times, by which missing rows are named.
        chosen: names of the columns to read, as in `column_names`; others may hold texts. None for all.

    Raises:
        UsageError: it is no CSV table of numbers, or has fewer than two readable rows.

    Warns:
        DamagedRecording: for each run of lines that cannot be read.
    """
    content = _content(path)
    if not content.strip():
        raise UsageError(f"{path} has no text; it is not a flight")
    first, _, rows = content.partition(b"\n")
    header = _header(path, first, unnamed=chosen is not None)
    kept = [header.index(name) for name in (header if chosen is None else chosen)]
    try:
        if not rows.strip() or not rows.endswith(b"\n") or rows.count(b",") != rows.count(b"\n") * (len(header) - 1):
            raise ValueError
        # the fast way; it refuses a damaged row without naming it
        values = np.loadtxt(io.BytesIO(rows), delimiter=",", ndmin=2, encoding="latin-1", comments=None, usecols=kept)
    except ValueError:  # an empty cell, a damaged row, or perhaps an incomplete one at the end
        values = _sound_rows(path, rows, header, kept, time)
    if len(values) < 2:
        raise UsageError(f"{path} has fewer than two rows; it is not a flight")
    return {header[column]: values[:, i] for i, column in enumerate(kept)}


def _content(path: Path) -> bytes:
    """Return the text of a table. Raises UsageError when it cannot be read."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    if path.suffix != GZIP:
        return content
    try:
        return zlib.decompressobj(zlib.MAX_WBITS | 16).decompress(content)  # 16: with the header of gzip
    except zlib.error as error:
        raise UsageError(f"{path} cannot be read as gzip text: {excerpt(str(error))}") from error


def _header(path: Path, line: bytes, unnamed: bool) -> list[str]:
    """Return the names of the columns; with `unnamed` an empty one is replaced. Raises UsageError for no header."""
    try:
        text = line.removeprefix(BYTE_ORDER_MARK).decode()
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} cannot be read as text: its first line is not UTF-8") from error
    header = [_without_quotes(name) for name in text.split(",")]
    if len(header) == 1 and ";" in header[0]:
        raise UsageError(f"{path} separates its columns by ';'; write ',' between them and '.' in numbers")
    if unnamed:
        header = [name or f"column {number}" for number, name in enumerate(header, start=1)]
    if "" in header:
        raise UsageError(f"{path} has no name for column {header.index('') + 1} of {len(header)} in its header")
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise UsageError(f"{path} has two columns named '{excerpt(twice[0])}'")
    return header


def _sound_rows(path: Path, content: bytes, header: list[str], kept: list[int], time: str) -> np.ndarray:
    """Return the kept columns of readable rows (n, k). Raises UsageError where fewer than two are readable."""
    lines = content.split(b"\n")
    rows, errors = {}, {}
    for number, line in enumerate(lines, start=2):
        if line.strip():
            try:
                rows[number] = _numbers(line, header, kept)
            except ValueError as error:
                errors[number] = str(error)
    if lines and lines[-1].strip():  # there is no line break behind it
        errors.setdefault(len(lines) + 1, "has no end: the file was cut there")
    first = min(errors, default=0)
    for number in [number for number in errors if len(header) > 1 and b"," not in lines[number - 2]]:
        for neighbour in (number - 1, number + 1):  # a line break within a cell also shortens the row beside it
            if neighbour in rows:
                errors.setdefault(neighbour, "is beside a line of one cell")
    sound = {number: row for number, row in rows.items() if number not in errors}
    if len(sound) < 2 and errors:
        raise UsageError(f"{path} line {first} {errors[first]}, and fewer than two rows can be read")
    names = [header[column] for column in kept]
    times = {number: row[names.index(time)] for number, row in sound.items()} if time in names else {}
    warn(path, _parts(sorted(sound), errors, times))
    return np.array(list(sound.values())).reshape(-1, len(kept))


def _parts(sound: list[int], errors: dict[int, str], times: dict[int, float]) -> list[DamagedRows]:
    """Return the runs of lines with errors; `times` of the sound lines name what is missing."""
    if not errors:
        return []
    found, wrong = [], sorted(errors)
    for run in np.split(wrong, np.flatnonzero(np.diff(wrong) > 1) + 1):
        first, last = int(run[0]), int(run[-1])
        at = bisect.bisect(sound, first)
        before = times.get(sound[at - 1]) if at > 0 else None
        after = times.get(sound[at]) if at < len(sound) else None
        place = f"line {first}" if first == last else f"lines {first} to {last}"
        found.append(DamagedRows(place, before, after, f"line {first} {errors[first]}"))
    return found


def _numbers(line: bytes, header: list[str], kept: list[int]) -> list[float]:
    """Return the kept numbers of a row. Raises ValueError, whose text says what is wrong with it."""
    cells = line.decode("latin-1").split(",")
    if len(cells) != len(header):
        raise ValueError(f"has {len(cells)} cells, the header {len(header)}")
    return [_number(cells[column], header[column]) for column in kept]


def _number(cell: str, name: str) -> float:
    text = _without_quotes(cell)
    if NUMBER.fullmatch(text):
        return float(text)
    if text.lower() in EMPTY and (text or not cell.strip('"\r')):  # blanks may have been digits
        return np.nan
    raise ValueError(f"has '{excerpt(text)}' in column {excerpt(name)}, which is not a number")


def _without_quotes(cell: str) -> str:
    text = cell.strip(" \t\r\n")
    return text[1:-1].strip(" ") if len(text) > 1 and text[0] == text[-1] == '"' else text
