"""Reads and writes flight tables: CSV and Parquet files; reads bags of this graph through `flight_bags`."""

import difflib
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_channels import CHANNELS, TIME, ChannelSpec, known_columns, numbered_columns
from swift_ros.recording.flight_checks import checked_table
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.recording.table_formats import csv_rows, parquet_rows
from swift_ros.text import excerpt

BLACKBOX = (".bbl", ".bfl")


def read(path: str | Path) -> FlightTable:
    """Return the flight in a table or bag.

    Args:
        path: a .csv or .parquet table, a bag folder, a folder with one bag below, or an .mcap file.

    Raises:
        UsageError: there is no flight, or it lacks required channels.

    Warns:
        DamagedRecording: for each part that cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a .csv or .parquet table or a bag")
    if path.suffix == ".csv":
        return checked_table(path.name, channels_from_columns(path.name, csv_rows.read(path, TIME)))
    if path.suffix == ".parquet":
        return checked_table(path.name, channels_from_columns(path.name, parquet_rows.read(path, TIME)))
    if path.suffix.lower() in BLACKBOX:
        raise UsageError(f"{path} is a blackbox log; convert it to bags with `swiftros import {path}`")
    if path.is_file() and path.suffix != ".mcap":
        raise UsageError(f"{path} is not a flight: it is neither .csv, .parquet nor .mcap")
    from swift_ros.recording import flight_bags  # imports ROS messages, which a table does not need

    return flight_bags.read(path)


def write(table: FlightTable, path: str | Path) -> None:
    """Write a table to a .csv or .parquet file. Raises UsageError when it cannot be written."""
    path, columns = Path(path), columns_of(table)
    if path.suffix not in (".csv", ".parquet"):
        raise UsageError(f"{path} is neither a .csv nor a .parquet file; give one of these names")
    try:
        if path.suffix == ".csv":
            formats = ["%.9f" if name == TIME else "%.10g" for name in columns]
            rows = np.column_stack(list(columns.values()))
            np.savetxt(path, rows, formats, ",", header=",".join(columns), comments="")
        else:
            parquet_rows.write(columns, path)
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror or error}") from error


def channels_from_columns(name: str, columns: Mapping[str, np.ndarray]) -> dict[str, Samples]:
    """Return the unchecked channels of a table.

    Args:
        name: of the table, for errors.
        columns: values (n,) by column.

    Raises:
        UsageError: a column is unknown (the nearest known one is named), or a channel is incomplete.
    """
    if TIME not in columns:
        raise UsageError(f"{name} lacks the column {TIME} (time, s)")
    known = known_columns()
    for column in columns:
        if column not in known:
            near = difflib.get_close_matches(column, known, n=1, cutoff=0.0)[0]
            raise UsageError(f"{name} has the unknown column '{excerpt(column)}'; the nearest known one is '{near}'")
    channels = {}
    for channel, spec in CHANNELS.items():
        required = _required_columns(spec, columns)
        present = [column for column in required if column in columns]
        if not present:
            continue
        if len(present) < len(required):
            missing = next(column for column in required if column not in columns)
            raise UsageError(f"{name} has {', '.join(present)} but lacks {missing}")
        values = np.stack([np.asarray(columns[column], dtype=float) for column in required], axis=-1)
        single = len(spec.columns) == 1 and "#" not in spec.columns[0]
        channels[channel] = Samples(np.asarray(columns[TIME], dtype=float), values[:, 0] if single else values)
    return channels


def columns_of(table: FlightTable) -> dict[str, np.ndarray]:
    """Return the columns (n,) of a table: one row for each time of any channel, NaN where a channel has no sample."""
    t = np.unique(np.concatenate([samples.t for samples in table.channels.values()]))
    columns = {TIME: t}
    for channel, samples in table.channels.items():
        rows = np.searchsorted(t, samples.t)
        values = samples.values.reshape(len(samples.t), -1)
        for i, column in enumerate(numbered_columns(CHANNELS[channel], values.shape[1])):
            columns[column] = np.full(len(t), np.nan)
            columns[column][rows] = values[:, i]
    return columns


def _required_columns(spec: ChannelSpec, columns) -> list[str]:
    """Return the columns that a channel must have; for rotors, up to the highest number that is present."""
    pattern = re.compile(re.escape(spec.columns[0]).replace(r"\#", r"(\d+)") + "$")
    numbers = [int(match[1]) for match in map(pattern.match, columns) if match and match.groups()]
    return numbered_columns(spec, max(numbers, default=0))
