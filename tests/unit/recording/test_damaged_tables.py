"""Damaged tables: every row outside the damage is read, the missing ones are named, and visible damage is refused."""

import warnings

import numpy as np
import pytest

from swift_ros import cli
from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_channels import TIME
from swift_ros.recording.table_formats import csv_rows, parquet_rows

COLUMNS = (TIME, "px", "py", "pz", "qx", "qy", "qz", "qw", "u_1", "u_2", "u_3", "u_4")
N, RATE_HZ = 6500, 250.0
N_CSV = 600  # of the draws: a damaged CSV table is read line by line
DAMAGES = ("zeros", "flip", "noise", "missing", "inserted", "cut")


def flown(n=N) -> dict[str, np.ndarray]:
    """Return the columns of a flight: noise around a slow motion, each number with all its digits."""
    rng, t = np.random.default_rng(5), np.arange(n) / RATE_HZ
    values = {name: 0.5 + 0.2 * np.sin(t + k) + 0.01 * rng.standard_normal(n) for k, name in enumerate(COLUMNS)}
    values |= {
        "qx": 0.01 * rng.standard_normal(n),
        "qy": 0.01 * rng.standard_normal(n),
        "qz": 0.0 * t,
        "qw": 1.0 + 0.0 * t,
    }
    return values | {TIME: t}


def write_csv(path, columns):
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, ["%.9f", *["%.10g"] * (len(columns) - 1)], ",", header=",".join(columns), comments="")
    return path


def write_foreign(path, columns, **options):
    """Write a Parquet table as other programs do: without checksums."""
    arrow = pytest.importorskip("pyarrow", reason="pyarrow, which is optional, is not installed")
    import pyarrow.parquet

    pyarrow.parquet.write_table(arrow.table(columns), path, row_group_size=1000, **options)
    return path


def write_own(path, columns):
    pytest.importorskip("pyarrow", reason="pyarrow, which is optional, is not installed")
    parquet_rows.write(columns, path)
    return path


def damaged(content: bytes, kind: str, rng) -> tuple[bytes, int, int]:
    """Return a content with one damage, and the byte range of the original that it touches."""
    at, size = int(rng.integers(len(content))), int(rng.integers(1, 3000))
    end = min(at + size, len(content))
    match kind:
        case "zeros":
            end = min(at + 4, len(content))
            return content[:at] + bytes(end - at) + content[end:], at, end
        case "flip":
            return content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1 :], at, at + 1
        case "noise":
            return content[:at] + rng.bytes(end - at) + content[end:], at, end
        case "missing":
            return content[:at] + content[end:], at, end
        case "inserted":
            return content[:at] + rng.bytes(size) + content[at:], at, at + 1
        case _:
            return content[:at], at, len(content)


def rows_of(path):
    """Return the rows of a table as tuples, and the warnings; None instead of rows that are all refused."""
    module = csv_rows if path.suffix == ".csv" else parquet_rows
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            columns = module.read(path, TIME)
        except UsageError as error:
            assert "\n" not in str(error) and str(error).isprintable()
            return None, [str(error)]
    assert all(issubclass(warning.category, DamagedRecording) for warning in caught)
    if tuple(columns) != COLUMNS:  # `flight_files` refuses a column of another name
        return None, ["another header"]
    return list(zip(*(column.tolist() for column in columns.values()), strict=True)), [str(w.message) for w in caught]


@pytest.mark.parametrize("kind", DAMAGES)
def test_rows_of_a_csv_table_outside_the_damage_are_read(kind, tmp_path):
    rng, path = np.random.default_rng(DAMAGES.index(kind)), write_csv(tmp_path / "flight.csv", flown(N_CSV))
    content = path.read_bytes()
    sound, nothing = rows_of(path)
    assert len(sound) == N_CSV and nothing == []
    starts = np.cumsum([0, *(len(line) + 1 for line in content.split(b"\n")[:-1])])[1:]  # of rows, and the file's end
    for draw in range(64):
        bad, first, end = damaged(content, kind, rng)
        path.write_bytes(bad)
        found, said = rows_of(path)
        if first < starts[0]:
            continue  # the header: refused, or nothing is wrong with it
        # One row beside the damage may be left out: a line break within a cell shortens the row before it.
        before, after = np.searchsorted(starts[1:], first) - 1, np.searchsorted(starts[:-1], end) + 1
        expected = sound[: max(before, 0)] + sound[after:]
        if found is None and len(expected) < 2:
            continue
        assert found is not None and set(found) >= set(expected), (kind, draw, first, end, said)
        invented = len(set(found) - set(sound))
        # A digit that became another digit, or two rows joined to one, cannot be seen: at most one such row.
        assert invented <= 1, (kind, draw, said)
        lost = len(set(sound) - set(found)) - invented
        assert said or lost == 0 or kind == "missing", (kind, draw, "lost without a word")


@pytest.mark.parametrize("kind", DAMAGES)
def test_row_groups_of_a_parquet_table_outside_the_damage_are_read(kind, tmp_path):
    rng, path = np.random.default_rng(DAMAGES.index(kind)), write_own(tmp_path / "flight.parquet", flown())
    content = path.read_bytes()
    sound, nothing = rows_of(path)
    assert len(sound) == N and nothing == []
    import pyarrow.parquet

    metadata = pyarrow.parquet.read_metadata(path)
    columns = [[metadata.row_group(i).column(k) for k in range(len(COLUMNS))] for i in range(metadata.num_row_groups)]
    begins = [min(column.dictionary_page_offset or column.data_page_offset for column in group) for group in columns]
    ends = [*begins[1:], len(content) - metadata.serialized_size - 8]
    starts = np.cumsum([0, *(metadata.row_group(i).num_rows for i in range(metadata.num_row_groups))])
    for draw in range(64):
        bad, first, end = damaged(content, kind, rng)
        path.write_bytes(bad)
        found, said = rows_of(path)
        in_place = kind in ("zeros", "flip", "noise") and end <= ends[-1]
        untouched = [k for k in range(len(begins)) if in_place and (ends[k] <= first or begins[k] >= end)]
        expected = {row for k in untouched for row in sound[starts[k] : starts[k + 1]]}
        assert expected <= set(found or ()), (kind, draw, first, end, said)
        assert set(found or ()) <= set(sound), (kind, draw, first, end, "invented")
        assert said or set(found) == set(sound), (kind, draw, first, end, "lost without a word")


@pytest.mark.parametrize("options", [{}, {"compression": "zstd"}, {"compression": "none", "use_dictionary": False}])
def test_a_parquet_table_of_another_program_is_read_or_refused(options, tmp_path):
    rng, path = np.random.default_rng(1), write_foreign(tmp_path / "flight.parquet", flown(), **options)
    content = path.read_bytes()
    sound, _ = rows_of(path)
    for draw in range(64):
        bad, *_ = damaged(content, DAMAGES[draw % len(DAMAGES)], rng)
        path.write_bytes(bad)
        found, said = rows_of(path)
        assert said or len(found) == len(sound), (draw, "lost without a word")


def test_missing_rows_of_a_csv_table_are_named_with_their_lines_and_times(tmp_path):
    path = write_csv(tmp_path / "flight.csv", flown())
    lines = path.read_text().split("\n")
    lines[5] = lines[5].replace(".", ";", 1)
    lines[100:103] = ["x", "y", "z"]
    path.write_text("\n".join(lines)[:-20])
    with pytest.warns(DamagedRecording) as caught:
        table = flight_files.read(path)
    first, second, third = (str(warning.message) for warning in caught)
    assert "line 6 cannot be read (line 6 has '0;016000000' in column t, which is not a number)" in first
    assert first.endswith("the rows between 0.012 s and 0.020 s are missing")
    assert "lines 100 to 104 cannot be read" in second and second.endswith("between 0.388 s and 0.412 s are missing")
    assert f"line {N + 1} cannot be read" in third and third.endswith("the rows after 25.992 s are missing")
    assert len(table["p_world"].t) == N - 1 - 5 - 1


def test_a_row_group_that_fails_its_checksum_is_named_with_its_times(tmp_path):
    path = write_own(tmp_path / "flight.parquet", flown())
    content = bytearray(path.read_bytes())
    import pyarrow.parquet

    page = pyarrow.parquet.read_metadata(path).row_group(2).column(3)
    content[page.data_page_offset + 200] ^= 4
    path.write_bytes(content)
    with pytest.warns(DamagedRecording, match="row group 3 of 7 cannot be read") as caught:
        table = flight_files.read(path)
    (text,) = (str(warning.message) for warning in caught)
    assert text.endswith("the rows between 7.996 s and 12.000 s are missing") and len(table["p_world"].t) == N - 1000


def test_a_table_without_a_readable_row_is_refused_in_one_sentence(tmp_path):
    path = write_csv(tmp_path / "flight.csv", flown())
    path.write_text(path.read_text().replace("0.", "0:"))
    with pytest.raises(UsageError, match="line 2 has '0:000000000' in column t, .* fewer than two rows can be read"):
        flight_files.read(path)
    path = write_own(tmp_path / "flight.parquet", flown())
    content = path.read_bytes()
    path.write_bytes(content[:4] + bytes(len(content) - 8000) + content[-7996:])
    with pytest.raises(UsageError, match="cannot be read as a Parquet table of numbers"):
        flight_files.read(path)


def test_many_damaged_parts_are_named_in_a_few_sentences(tmp_path):
    path = write_csv(tmp_path / "flight.csv", flown())
    lines = path.read_text().split("\n")
    for number in range(10, 6000, 10):
        lines[number] += ",1"
    path.write_text("\n".join(lines))
    with pytest.warns(DamagedRecording) as caught:
        flight_files.read(path)
    assert len(caught) == 9 and "and 590 further parts up to line 5991" in str(caught[-1].message)


def test_a_command_names_a_damaged_table_once(tmp_path, capsys, monkeypatch):
    path = write_csv(tmp_path / "flight.csv", flown())
    path.write_bytes(path.read_bytes()[:300_000])
    monkeypatch.setattr(cli, "run", lambda argv: [len(flight_files.read(path)["p_world"].t) for _ in range(2)][0])
    assert cli.main([]) > 1000
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"swiftros: warning: {path}: line ") and "the rows after" in line
