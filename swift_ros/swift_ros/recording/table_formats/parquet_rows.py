"""Reads and writes the rows of a Parquet table: of a damaged one, all readable row groups; the others are named.

The tables of this repository hold a checksum for each page. In a table of another program without checksums, a damage
is found only where a page cannot be decoded. The description at the end of the file has no checksum: without it, no row
can be read.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.table_formats.damaged_rows import DamagedRows, warn
from swift_ros.text import excerpt

ROWS_PER_GROUP = 1000  # that a damage makes unreadable: 2 to 20 s of a flight
MAX_BYTES_PER_NUMBER = 1e4  # smallest file: one byte for so many bytes of numbers; fewer are no flight but a damage


def write(columns: Mapping[str, np.ndarray], path: Path) -> None:
    """Write columns (n,) as a table with checksums. Raises UsageError without pyarrow, OSError when it cannot write."""
    arrow, parquet = _pyarrow(path)
    table = arrow.table(dict(columns))
    parquet.write_table(table, path, row_group_size=ROWS_PER_GROUP, write_page_checksum=True)


def column_names(path: Path) -> list[str]:
    """Return the names of the columns. Raises UsageError when the file cannot be read."""
    arrow, parquet = _pyarrow(path)
    try:
        with parquet.ParquetFile(path) as file:
            return list(file.schema_arrow.names)
    except (OSError, arrow.ArrowException, MemoryError, ValueError) as error:
        raise UsageError(f"{path} cannot be read as a Parquet table of numbers: {_first_line(error)}") from error


def read(path: Path, time: str, chosen: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Return the columns (n,) of a Parquet table by name; an empty cell is NaN.

    Args:
        path: the file.
        time: column of the times, by which missing rows are named.
        chosen: names of the columns to read; others may hold texts. None for all.

    Raises:
        UsageError: it is no Parquet table of numbers, or no row can be read.

    Warns:
        DamagedRecording: for each run of row groups that cannot be read.
    """
    arrow, parquet = _pyarrow(path)
    unreadable = (OSError, arrow.ArrowException, MemoryError, ValueError)
    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            names = file.schema_arrow.names
            _check_description(path, file.metadata, names)
            names = names if chosen is None else list(chosen)
            groups = [_group(file, i, names, unreadable) for i in range(file.num_row_groups)]
    except unreadable as error:
        raise UsageError(f"{path} cannot be read as a Parquet table of numbers: {_first_line(error)}") from error
    sound = [group for group in groups if isinstance(group, dict)]
    if not sound and groups:
        raise UsageError(f"{path} cannot be read as a Parquet table of numbers: {groups[0]}")
    if not sum(len(next(iter(group.values()))) for group in sound):
        raise UsageError(f"{path} has a header and no rows")
    warn(path, _parts(groups, time))
    return {name: np.concatenate([group[name] for group in sound]) for name in names}


def _check_description(path: Path, metadata, names: list[str]) -> None:
    """Raise UsageError when the description at the end of a file cannot be that of a flight table."""
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UsageError(f"{path} has two columns named '{excerpt(twice[0])}'")
    if not names:
        raise UsageError(f"{path} has no columns; it is not a flight")
    rows = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
    if min(rows, default=0) < 0 or 8.0 * sum(rows) > MAX_BYTES_PER_NUMBER * path.stat().st_size:
        raise UsageError(f"{path} claims {sum(rows)} rows, which do not fit into its size; it is damaged")


def _group(file, index: int, names: list[str], unreadable) -> dict[str, np.ndarray] | str:
    """Return the columns of a row group, or why it cannot be read."""
    try:
        content = file.read_row_group(index, columns=names)
        columns = {name: np.asarray(content[name].cast("float64").to_numpy()) for name in names}
    except unreadable as error:
        return _first_line(error)
    expected = file.metadata.row_group(index).num_rows
    if any(len(values) != expected for values in columns.values()):
        return "another number of rows than described"
    return columns


def _parts(groups: list[dict[str, np.ndarray] | str], time: str) -> list[DamagedRows]:
    """Return the runs of row groups that cannot be read, with the times of the rows beside them."""
    found, first = [], None
    for i, group in enumerate([*groups, {}]):
        if isinstance(group, str):
            first = i if first is None else first
        elif first is not None:
            before, after = _edge(groups[:first][-1:], time, -1), _edge([group], time, 0)
            place = f"row group {first + 1}" if i == first + 1 else f"row groups {first + 1} to {i}"
            found.append(DamagedRows(f"{place} of {len(groups)}", before, after, str(groups[first])))
            first = None
    return found


def _edge(groups: list, time: str, row: int) -> float | None:
    """Return the time of the first (0) or last (-1) row of a row group; None without one."""
    times = groups[0].get(time, ()) if groups else ()
    return float(times[row]) if len(times) else None


def _first_line(error: Exception) -> str:
    return excerpt(str(error).partition("\n")[0])


def _pyarrow(path: Path):
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError(f"{path} is Parquet, which needs pyarrow; `pip install pyarrow`, or use .csv") from error
    return pyarrow, pyarrow.parquet
