"""Flight tables from files and into them: CSV, Parquet, and bags of this graph (`flight_bags`)."""

import csv
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import TIME, FlightTable, channels_from_columns, check, columns_of

BLACKBOX = (".bbl", ".bfl")
TEXT = "utf-8-sig"  # with or without the mark that Excel begins with
EMPTY = ("", "nan", "na", "null", "none")


def read(path: str | Path) -> FlightTable:
    """Return the flight in a .csv or .parquet table, or in a bag (its folder, one with a single bag below, or its
    .mcap file). Raises UsageError, in one sentence, when there is none or it lacks what a flight must have."""
    path = Path(path)
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a .csv or .parquet table or a bag")
    if path.suffix == ".csv":
        return check(path.name, channels_from_columns(path.name, _csv_columns(path)))
    if path.suffix == ".parquet":
        return check(path.name, channels_from_columns(path.name, _parquet_columns(path)))
    if path.suffix.lower() in BLACKBOX:
        raise UsageError(f"{path} is a blackbox log; `swiftros import {path}` makes bags of it, which can be read")
    if path.is_file() and path.suffix != ".mcap":
        raise UsageError(f"{path} is no flight: it is neither .csv, .parquet nor .mcap")
    from swift_ros.recording import flight_bags  # ROS messages, which a table does without

    return flight_bags.read(path)


def write(table: FlightTable, path: str | Path) -> None:
    """Write a table as .csv or .parquet, by its name. Raises UsageError when it cannot be written."""
    path, columns = Path(path), columns_of(table)
    if path.suffix not in (".csv", ".parquet"):
        raise UsageError(f"{path} is neither a .csv nor a .parquet; name the table so")
    try:
        if path.suffix == ".csv":
            formats = ["%.9f" if name == TIME else "%.10g" for name in columns]
            rows = np.column_stack(list(columns.values()))
            np.savetxt(path, rows, formats, ",", header=",".join(columns), comments="")
        else:
            arrow, parquet = _pyarrow(path)
            parquet.write_table(arrow.table(columns), path)
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror or error}") from error


def _csv_columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a CSV table; an empty field is NaN."""
    try:
        with open(path, newline="", encoding=TEXT) as stream:
            header = [name.strip() for name in next(csv.reader(stream), [])]
            rows = sum(1 for _, _ in zip(range(2), stream, strict=False))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path} cannot be read as text: {error}") from error
    if len(header) == 1 and ";" in header[0]:
        raise UsageError(f"{path} separates its columns by ';'; write ',' between them and '.' in numbers")
    if "" in header:
        raise UsageError(f"{path} has no name for column {header.index('') + 1} of {len(header)} in its header")
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise UsageError(f"{path} has two columns named '{twice[0]}'")
    if rows < 2:
        raise UsageError(f"{path} has no two rows; it is no flight")
    try:
        values = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, encoding=TEXT)  # quick, but knows no empty field
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} cannot be read as text: {error}") from error
    except ValueError:
        values = _patient_rows(path, header)
    if values.shape[1] != len(header):
        raise UsageError(f"{path} has {len(header)} names in its header and {values.shape[1]} values a row")
    return dict(zip(header, values.T, strict=True))


def _patient_rows(path: Path, header: list[str]) -> np.ndarray:
    """Return the rows (n, columns) of a CSV table. Raises UsageError that names line and column of what is wrong."""
    rows = []
    with open(path, newline="", encoding=TEXT) as stream:
        reader = csv.reader(stream)
        try:
            next(reader)
            rows = [_numbers(row, header, f"{path} line {reader.line_num}") for row in reader if row]
        except csv.Error as error:
            raise UsageError(f"{path} line {reader.line_num} cannot be read: {error}") from error
    return np.array(rows).reshape(-1, len(header))


def _numbers(row: list[str], header: list[str], where: str) -> list[float]:
    if len(row) != len(header):
        raise UsageError(f"{where} has {len(row)} fields, its header {len(header)}")
    try:
        return [np.nan if text.strip().lower() in EMPTY else float(text) for text in row]
    except ValueError as error:
        at = next(i for i, text in enumerate(row) if not _is_number(text))
        raise UsageError(f"{where}, column {header[at]}: '{row[at]}' is no number") from error


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text.strip().lower() in EMPTY
    return True


def _parquet_columns(path: Path) -> dict[str, np.ndarray]:
    arrow, parquet = _pyarrow(path)
    try:
        content = parquet.read_table(path)
        if not len(content):
            raise UsageError(f"{path} has a header and no rows")
        return {name: np.asarray(content[name].cast("float64").to_numpy()) for name in content.column_names}
    except (OSError, arrow.ArrowException) as error:
        first = str(error).splitlines()[0]
        raise UsageError(f"{path} cannot be read as a Parquet table of numbers: {first}") from error


def _pyarrow(path: Path):
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError(f"{path} is Parquet, which needs pyarrow; `pip install pyarrow`, or use .csv") from error
    return pyarrow, pyarrow.parquet
