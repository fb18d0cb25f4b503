"""Tables: any damage of CSV, Parquet, gzip and HDF5 gives rows, warnings or one sentence."""

import gzip
import tempfile
import warnings
from functools import cache, partial
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest
from fuzzing import budget, count, edited, edits, result_or_refusal
from hypothesis import example, given
from hypothesis import strategies as st

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.importers import blackbird, nanobench
from swift_ros.recording import flight_files
from swift_ros.recording.flight_channels import TIME

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow, which is optional, is not installed")
pyarrow = pytest.importorskip("pyarrow")

FOLDER = Path(tempfile.mkdtemp(prefix="swift-fuzz-"))
N = 60
COLUMNS = (TIME, "px", "py", "pz", "qx", "qy", "qz", "qw", "wx", "wy", "wz", "u_1", "u_2", "u_3", "u_4", "vbat")
CELLS = st.one_of(
    st.sampled_from(
        (
            "",
            " ",
            "nan",
            "inf",
            "-1e308",
            "1e999",
            "1_0",
            "0x10",
            "\u0661",
            "--1",
            "1.2.3",
            '"',
            '"1',
            "#",
            "9" * 5000,
            "\0",
        )
    ),
    st.text(max_size=6),
    st.floats().map(repr),
)
NUMBERS = st.sampled_from((np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, -1.0, 1e-308, 2.0**63))


@cache
def columns() -> dict[str, np.ndarray]:
    """Return a short flight at 100 Hz."""
    rng, t = np.random.default_rng(3), 0.01 * np.arange(N)
    values = {name: 0.5 + 0.1 * np.sin(9.0 * t + k) + 0.01 * rng.standard_normal(N) for k, name in enumerate(COLUMNS)}
    rest = {name: 1e-3 * rng.standard_normal(N) for name in ("qx", "qy", "qz")} | {"qw": np.ones(N)}
    return values | rest | {TIME: t}


@cache
def csv_bytes() -> bytes:
    stream = BytesIO()
    np.savetxt(stream, np.column_stack(list(columns().values())), "%.9g", ",", header=",".join(COLUMNS), comments="")
    return stream.getvalue()


@cache
def parquet_bytes(checksums: bool, compression: str) -> bytes:
    stream = BytesIO()
    table, options = pyarrow.table(columns()), {"write_page_checksum": checksums, "compression": compression}
    parquet.write_table(table, stream, row_group_size=20, **options)
    return stream.getvalue()


def read(name: str, content: bytes):
    """Return the flight in a file of this content."""
    path = FOLDER / name
    path.write_bytes(content)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DamagedRecording)
        table = flight_files.read(path)
    assert all(str(one.message).isprintable() for one in caught)
    for samples in table.channels.values():
        assert np.all(np.diff(samples.t) > 0) and np.all(np.isfinite(samples.values))
    return table


def assert_read_or_refused(function) -> None:
    with np.errstate(all="ignore"):
        found = result_or_refusal(function)
    count("tables", valid=not isinstance(found, UsageError))


@pytest.mark.parametrize("content", [csv_bytes(), parquet_bytes(True, "snappy"), parquet_bytes(False, "none")])
def test_the_unmodified_table_is_read(content):
    table = read("flight.parquet" if content[:4] == b"PAR1" else "flight.csv", content)
    np.testing.assert_allclose(table["p_world"].values[:, 0], columns()["px"], rtol=1e-8)


@budget(0.02)
@given(st.binary(max_size=200), st.sampled_from(("flight.csv", "flight.parquet")), st.booleans())
def test_any_bytes_are_refused(content, name, begins):
    frame = b"PAR1" if name.endswith("parquet") else csv_bytes()[:100]
    assert_read_or_refused(
        partial(read, name, frame * begins + content + frame * (begins and name.endswith("parquet")))
    )


@budget(0.25)
@given(edits())
@example([])
def test_a_damaged_csv_table_is_read(changes):
    assert_read_or_refused(partial(read, "flight.csv", edited(csv_bytes(), changes)))


@budget(0.2)
@given(st.lists(st.tuples(st.integers(0, N), st.integers(0, len(COLUMNS) - 1), CELLS), min_size=1, max_size=20))
@example([(3, 0, "1_0")])
@example([(0, 1, "px\u2028")])
def test_any_cells_are_read_or_left_out(changes):
    rows = [line.split(",") for line in csv_bytes().decode().splitlines()]
    for row, column, text in changes:
        rows[row][column] = text
    assert_read_or_refused(
        partial(read, "flight.csv", "\n".join([*map(",".join, rows), ""]).encode("utf-8", "surrogatepass"))
    )


@budget(0.2)
@given(
    st.sampled_from(("flight.csv", "flight.parquet")),
    st.lists(
        st.tuples(st.sampled_from(COLUMNS), st.integers(0, N), st.integers(1, N), NUMBERS), min_size=1, max_size=4
    ),
)
def test_any_numbers_are_used_or_refused(name, changes):
    values = {column: numbers.copy() for column, numbers in columns().items()}
    for column, begin, size, number in changes:
        values[column][begin : begin + size] = number
    stream = BytesIO()
    if name == "flight.csv":
        np.savetxt(stream, np.column_stack(list(values.values())), "%.9g", ",", header=",".join(values), comments="")
    else:
        parquet.write_table(pyarrow.table(values), stream)
    assert_read_or_refused(partial(read, name, stream.getvalue()))


@budget(0.2)
@given(st.booleans(), st.sampled_from(("snappy", "zstd", "none")), edits())
def test_a_damaged_parquet_table_is_read(checksums, compression, changes):
    assert_read_or_refused(partial(read, "flight.parquet", edited(parquet_bytes(checksums, compression), changes)))


def a_table_of_other_types() -> dict:
    texts, whole = pyarrow.array(["a"] * N), pyarrow.array([1 << 60] * N)
    nested = pyarrow.array([[1.0, 2.0]] * N)
    return {"texts": texts, "whole": whole, "nested": nested, "nothing": pyarrow.array([None] * N)}


@pytest.mark.parametrize("kind", ["texts", "whole", "nested", "nothing"])
@pytest.mark.parametrize("column", [TIME, "px"])
def test_columns_of_other_types_are_read_or_refused(kind, column):
    stream = BytesIO()
    parquet.write_table(pyarrow.table(columns() | {column: a_table_of_other_types()[kind]}), stream)
    assert_read_or_refused(partial(read, "flight.parquet", stream.getvalue()))


@cache
def nanobench_bytes() -> bytes:
    names = (TIME, *nanobench.COLUMNS)
    rows = 0.5 + 0.01 * np.random.default_rng(4).standard_normal((N, len(names)))
    rows[:, 0] = 0.01 * np.arange(N)
    stream = BytesIO()
    np.savetxt(stream, rows, "%.6f", ",", header=",".join(names), comments="")
    return stream.getvalue()


def read_nanobench(content: bytes):
    path = FOLDER / "flight.csv.gz"
    path.write_bytes(content)
    return nanobench.read(path)


@budget(0.08)
@given(edits(), st.booleans())
def test_a_damaged_nanobench_recording_is_read_or_refused(changes, inside):
    content = nanobench_bytes()
    damaged = gzip.compress(edited(content, changes), 1) if inside else edited(gzip.compress(content, 1), changes)
    assert_read_or_refused(partial(read_nanobench, damaged))


@cache
def blackbird_files() -> tuple[bytes, bytes]:
    """Return the HDF5 file and the poses of a short recording."""
    rng, stream = np.random.default_rng(4), BytesIO()
    t = 0.01 * np.arange(N)
    with h5py.File(stream, "w") as file:
        file["ts"] = t
        for name in ("gyro_raw", "accel_raw", "thrust"):
            file[name] = rng.standard_normal((N, 3))
    poses = BytesIO()
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (N, 1))
    np.savetxt(poses, np.column_stack([t, rng.standard_normal((N, 3)), attitude, rng.standard_normal((N, 3))]), "%.9f")
    return stream.getvalue(), poses.getvalue()


def read_blackbird(data: bytes, poses: bytes):
    (FOLDER / blackbird.DATA).write_bytes(data)
    (FOLDER / blackbird.POSES).write_bytes(poses)
    return blackbird.read(FOLDER)


def test_the_unmodified_recordings_of_others_are_read():
    assert len(read_nanobench(gzip.compress(nanobench_bytes())).t) == N
    assert len(read_blackbird(*blackbird_files()).t) == N


@budget(0.05)
@given(edits(), st.booleans())
def test_a_damaged_blackbird_recording_is_read_or_refused(changes, in_poses):
    data, poses = blackbird_files()
    files = (data, edited(poses, changes)) if in_poses else (edited(data, changes), poses)
    assert_read_or_refused(partial(read_blackbird, *files))
