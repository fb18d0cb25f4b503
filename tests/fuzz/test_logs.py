"""Logs of other programs: any damage of ULog, DataFlash, bags, tables and mappings gives rows or one sentence."""

import tempfile
import warnings
from functools import partial
from pathlib import Path

import flown_logs
import numpy as np
import pytest
from fuzzing import ABSURD, Edit, budget, count, edited, edits, result_or_refusal
from hypothesis import example, given
from hypothesis import strategies as st

from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.log_formats import ulog

FOLDER = Path(tempfile.mkdtemp(prefix="swift-fuzz-"))
SECONDS = 0.5  # of flight in a log
ULOG, DATAFLASH, TEXT, BAG = (
    flown_logs.ulog(rows=round(SECONDS * flown_logs.RATE_HZ)),
    flown_logs.dataflash(rows=round(SECONDS * flown_logs.RATE_HZ)),
    flown_logs.dataflash_text(rows=round(SECONDS * flown_logs.RATE_HZ)),
    flown_logs.bag(seconds=SECONDS),
)
COLUMNS = list(flown_logs.columns())
CSV = flown_logs.csv({name: values[:100] for name, values in flown_logs.columns().items()})
LOGS = {"flight.ulg": ULOG, "flight.bin": DATAFLASH, "flight.log": TEXT, "flight.mcap": BAG, "flight.csv": CSV}
WORDS = st.sampled_from(
    (
        "",
        "-",
        "gyro_x",
        "-gyro_x",
        "timestamp",
        "a:b",
        ":",
        "NED",
        "FRD",
        "y-up",
        "deg/s",
        "us",
        "%",
        "1",
        "\0",
        "x" * 5000,
    )
)
MAPPING = """time: {{column: timestamp, unit: {}}}
channels:
  gyro_body: {{columns: [gyro_x, gyro_y, gyro_z], unit: {}, scale: {}}}
  specific_force_body: {{columns: [acc_x, acc_y, acc_z], body: {}}}
  motor_command: {{columns: [motor_1, motor_2, motor_3, motor_4], range: [{}, {}]}}
"""
NUMBERS = st.one_of(st.floats().map(repr), st.sampled_from(("0", "1", "-1", "1e308", "9" * 400, "null")))


def read(name: str, content: bytes, mapping: Path | None = None):
    """Return the flight in a file of this content."""
    path = FOLDER / name
    path.write_bytes(content)
    with warnings.catch_warnings(record=True) as caught, np.errstate(all="ignore"):
        warnings.simplefilter("always")
        table = flight_files.read(path, mapping)
    assert all(str(one.message).isprintable() for one in caught)
    assert all(note.isprintable() for note in table.notes)
    for samples in table.channels.values():
        assert np.all(np.diff(samples.t) > 0) and np.all(np.isfinite(samples.values))
    return table


def assert_read_or_refused(function) -> None:
    count("logs", valid=not isinstance(result_or_refusal(function), UsageError))


@pytest.mark.parametrize("name", LOGS)
def test_the_unmodified_log_is_read(name):
    table = read(name, LOGS[name])
    rows = len(table["gyro_body"].t)
    np.testing.assert_allclose(table["gyro_body"].values, flown_logs.flight().gyro[:rows], atol=1e-5)
    assert rows == round(SECONDS * flown_logs.RATE_HZ)


@budget(0.1)
@given(st.sampled_from(tuple(LOGS)), st.binary(max_size=300), st.booleans())
def test_any_bytes_are_refused(name, content, begins):
    assert_read_or_refused(partial(read, name, LOGS[name][:400] * begins + content))


@budget(0.6)
@given(st.sampled_from(tuple(LOGS)), edits())
def test_a_damaged_log_is_read_or_refused(name, changes):
    assert_read_or_refused(partial(read, name, edited(LOGS[name], changes)))


@budget(0.15)
@given(edits(), st.sampled_from(("flight.ulg", "flight.bin")))
@example([Edit("zero", 397, 1, b"\xff")], "flight.bin")  # a column without a name
def test_damaged_descriptions_of_messages_are_used_or_refused(changes, name):
    end = 900 if name == "flight.ulg" else 89 * 7  # they stand at the begin
    content = LOGS[name]
    assert_read_or_refused(partial(read, name, edited(content[:end], changes) + content[end:]))


@budget(0.15)
@given(st.lists(st.one_of(WORDS, NUMBERS), min_size=6, max_size=6), edits(2), st.booleans())
def test_any_mapping_is_used_or_refused(words, changes, damaged):
    path = FOLDER / "mapping.yaml"
    text = MAPPING.format(*words).encode("utf-8", "replace")
    path.write_bytes(edited(text, changes) if damaged else text)
    assert_read_or_refused(partial(read, "flight.csv", CSV, path))


@pytest.mark.parametrize("size", [b"[9]", b"[65535]", b"[999999999]", b"[-1]"])
def test_absurd_arrays_of_a_ulog_are_refused_before_they_fill_the_memory(size):
    content = ULOG.replace(b"float[3] gyro_rad", b"x[3] gyro_rad" + b" " * 4)
    nested = b"".join(
        flown_logs.message("F", b"%s:%s%s a;" % (name, kind, size))
        for name, kind in ((b"x", b"y"), (b"y", b"z"), (b"z", b"float"))
    )
    assert_read_or_refused(
        partial(read, "flight.ulg", content[: ulog.BEGIN + 43] + nested + content[ulog.BEGIN + 43 :])
    )


@pytest.mark.parametrize("value", ABSURD)
def test_absurd_times_are_used_or_refused(value):
    for name, mark in (("flight.ulg", b"D"), ("flight.bin", b"\xa3\x95\x82")):
        at = LOGS[name].rindex(mark)
        assert_read_or_refused(partial(read, name, LOGS[name][: at + 3] + value + LOGS[name][at + 3 + len(value) :]))
