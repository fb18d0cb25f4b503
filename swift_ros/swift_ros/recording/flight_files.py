"""Reads and writes flight tables: CSV and Parquet files; reads bags of this graph, and logs of other programs.

A bag of this graph is read by `flight_bags`; PX4 and ArduPilot logs, other bags and tables of other columns are read by
a mapping (`log_mapping`), which is guessed where none is given.
"""

import difflib
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording import bags
from swift_ros.recording.flight_channels import CHANNELS, TIME, ChannelSpec, known_columns, numbered_columns
from swift_ros.recording.flight_checks import checked_table
from swift_ros.recording.flight_table import FlightTable, RowSampling, Samples
from swift_ros.recording.log_formats import other_bags, ros_bags, tables
from swift_ros.recording.log_formats.log import BAGS, DATAFLASH, ROS1_BAGS, SQLITE_BAGS, TABLE, TABLES, ULOG, Log
from swift_ros.recording.log_mapping import guess, mapping_file, reading
from swift_ros.recording.log_mapping.mapping import Mapping as LogMapping
from swift_ros.recording.table_formats import csv_rows, parquet_rows
from swift_ros.text import excerpt

BLACKBOX = (".bbl", ".bfl")
LOGS = (*ULOG, *DATAFLASH)
MIN_KNOWN = 0.5  # share of known columns from which a table is a flight table, whose other columns are misspelt
LOOP_HZ = 200.0  # Hz; motor commands logged more slowly are some of those of a flight controller's loop


def read(path: str | Path, mapping: str | Path | None = None) -> FlightTable:
    """Return the flight in a table, bag or log.

    Args:
        path: a .csv or .parquet table, a bag folder, a folder with one bag below, an .mcap file, a bag of ROS 1 (.bag),
            a PX4 log (.ulg) or an ArduPilot log (.bin, .log).
        mapping: file of the mapping of a log, a bag of another graph or a table of other columns; None for a guess.

    Raises:
        UsageError: there is no flight, it lacks required channels, or its channels contradict each other.

    Warns:
        DamagedRecording: for each part that cannot be read.
    """
    path = Path(path)
    if is_flight_table(path) and mapping is None:
        rows = (csv_rows if path.suffix == ".csv" else parquet_rows).read(path, TIME)
        return checked_table(path.name, channels_from_columns(path.name, rows))
    if not is_log(path) and mapping is None:
        from swift_ros.recording import flight_bags  # imports ROS messages, which a table does not need

        return flight_bags.read(path)
    return table_of(*open_log(path, mapping))


def is_flight_table(path: Path) -> bool:
    """Return whether a file is a table with the columns of a flight table. Raises UsageError for no known file."""
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a .csv or .parquet table, a bag, or a .ulg or .bin log")
    if path.suffix.lower() in BLACKBOX:
        raise UsageError(f"{path} is a blackbox log; convert it to bags with `swiftros import {path}`")
    if path.is_file() and path.suffix.lower() not in (*TABLES, *LOGS, *BAGS, *ROS1_BAGS, *SQLITE_BAGS):
        bags_of_ros = ", ".join((*BAGS, *SQLITE_BAGS, *ROS1_BAGS))
        raise UsageError(
            f"{path} is not a flight: it is neither .csv, .parquet, a bag ({bags_of_ros}) nor a log ({', '.join(LOGS)})"
        )
    if path.suffix not in TABLES:
        return False
    names = tables.column_names(path)
    return len(set(names) & set(known_columns())) > MIN_KNOWN * len(names)


def is_log(path: Path) -> bool:
    """Return whether a path is read by a mapping: a log, a table of other columns, or a bag of another graph."""
    if path.suffix.lower() in LOGS:
        return True
    if path.suffix in TABLES:
        return not is_flight_table(path)
    if other_bags.find(path):
        return True
    from swift_ros.recording import flight_bags

    return flight_bags.is_of_another_graph(path)


def open_log(path: str | Path, mapping: str | Path | None = None) -> tuple[Log, LogMapping]:
    """Return the log at a path with its mapping: that of a file, or a guess. Raises and warns like `read`."""
    path = Path(path)
    given = mapping_file.read(Path(mapping)) if mapping else None
    if path.suffix in TABLES or path.suffix.lower() in LOGS:
        return reading.open_log(path, given)
    if bag := other_bags.find(path):
        log = other_bags.read(bag)
        return log, given or guess.guess(log)
    from swift_ros.recording.replay import find_bag

    log = ros_bags.read(path, bags.open_files(find_bag(path)))
    return log, given or guess.guess(log)


def table_of(log: Log, mapping: LogMapping) -> FlightTable:
    """Return the flight in a log. Raises UsageError like `read`."""
    found = reading.read(log, mapping)
    sampling = {name: RowSampling(one.between, one.late, one.loop_hz) for name, one in mapping.channels.items()}
    channels = {
        name: sampling[name].at_its_time(Samples(one.t, one.values), name) for name, one in found.signals.items()
    }
    skips = TABLE not in log.topics and "motor_command" in channels and channels["motor_command"].rate_hz < LOOP_HZ
    try:
        table = checked_table(log.path.name, channels, skips_commands=skips)
    except UsageError as error:
        raise UsageError(f"{error}{found.left_out and '; '}{found.left_out}") from error
    contradicted = any(check.holds is False for check in found.checks)
    order, columns = found.order, found.motor_columns
    declared = {name: one for name, one in sampling.items() if one != RowSampling() and name in table}
    return replace(
        table,
        notes=found.notes,
        motor_order=order,
        motor_columns=columns,
        contradicted=contradicted,
        sampling=declared,
        one_clock=log.path.suffix.lower() in LOGS,
    )


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
