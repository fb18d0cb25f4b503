"""Reads CSV and Parquet tables of any columns as a log of one topic."""

import difflib
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import TABLE, Log, LoggedTopic
from swift_ros.recording.table_formats import csv_rows, parquet_rows
from swift_ros.text import excerpt


def column_names(path: Path) -> list[str]:
    """Return the names of a table's columns. Raises UsageError when they cannot be read."""
    return csv_rows.column_names(path) if path.suffix == ".csv" else parquet_rows.column_names(path)


def read(path: Path, time: str, columns: list[str]) -> Log:
    """Return some columns of a table, with row numbers as times.

    Args:
        path: a .csv or .parquet file.
        time: column of the times, by which missing rows are named.
        columns: names of the columns to read.

    Raises:
        UsageError: it is no table of numbers, or lacks a column.

    Warns:
        DamagedRecording: for each part that cannot be read.
    """
    present = column_names(path)
    if missing := [name for name in columns if name not in present]:
        near = difflib.get_close_matches(missing[0], present, n=1, cutoff=0.0)[0]
        raise UsageError(f"{path} lacks the column '{excerpt(missing[0])}'; the nearest name is '{excerpt(near)}'")
    found = (csv_rows if path.suffix == ".csv" else parquet_rows).read(path, time, columns)
    rows = np.arange(len(next(iter(found.values()))), dtype=float)
    return Log(path, f"{path.suffix[1:].upper()} table", {TABLE: LoggedTopic(rows, found)})
