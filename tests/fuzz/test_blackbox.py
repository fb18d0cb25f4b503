"""Blackbox logs: no damage of header or frames stops the decoder with anything but one sentence."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from blackbox_writer import NAMES, written
from fuzzing import ABSURD, Edit, budget, count, edited, edits, result_or_refusal
from hypothesis import example, given
from hypothesis import strategies as st

from swift_ros.errors import UsageError
from swift_ros.importers import blackbox, blackbox_log

ROWS = 150
PATH = Path(tempfile.mkdtemp(prefix="swift-fuzz-")) / "log.bbl"


def flown() -> np.ndarray:
    """Return the rows of a short log: smooth and noisy whole numbers."""
    rng = np.random.default_rng(1)
    rows = rng.integers(-200, 200, (ROWS, len(NAMES))).cumsum(axis=0) // 8
    rows[:, [i for i, name in enumerate(NAMES) if name.startswith(("motor", "eRPM"))]] = rng.integers(
        200, 900, (ROWS, 8)
    )
    rows[:, NAMES.index("loopIteration")] = np.arange(ROWS)
    rows[:, NAMES.index("time")] = 1_000_000 + 500 * np.arange(ROWS)
    rows[:, [NAMES.index(name) for name in ("vbatLatest", "rssi", "rcCommand[3]", "setpoint[3]")]] = 1600
    return rows


LOG = written(flown())
HEADER_END = LOG.index(b"\nI") + 1
LINES = LOG[:HEADER_END].splitlines()
TEXTS = st.one_of(
    st.sampled_from(
        (b"", b"0", b"-1", b"--5", b"\xb2", b"1e308", b"nan", b"9" * 5000, b"abc", b"0,0", b"1" * 30, b",", b"-", b"\0")
    ),
    st.sampled_from((b"Betaflight 4.0", b"Betaflight 99999.1", b"Betaflight " + b"4" * 5000 + b".1", b"Cleanflight")),
    st.binary(max_size=12),
)
VALUES = st.one_of(st.integers(0, 14), st.integers(0, 300))


def decoded(content: bytes):
    """Return all logs of a file as flights, or the refusal."""
    PATH.write_bytes(content)
    flights = [blackbox.read(source) for source in blackbox.find(PATH)]
    for flight in flights:
        assert np.all(np.diff(flight.t) > 0)
        for stream in flight.streams:
            for row in np.flatnonzero(stream.rows)[:3]:
                stream.message(int(row), 0)
    return flights


def assert_read_or_refused(content: bytes) -> None:
    found = result_or_refusal(partial(decoded, content))
    count("blackbox", valid=not isinstance(found, UsageError))


def test_the_unmodified_log_is_read():
    log = blackbox_log.decode(LOG, "log")
    assert log.ended and not log.gaps
    np.testing.assert_array_equal(np.stack([log.fields[name] for name in NAMES], axis=1), flown())
    (flight,) = decoded(LOG)
    assert len(flight.t) == ROWS


@budget(0.1)
@given(st.binary(max_size=300), st.booleans())
def test_any_bytes_are_refused(content, begins):
    assert_read_or_refused(blackbox_log.BEGIN * begins + content)


@budget(0.3)
@given(edits())
@example([Edit("overwrite", LOG.index(b"H Data version"), 1, b"\xff")])  # no data version
def test_a_damaged_file_is_read_or_refused(changes):
    assert_read_or_refused(edited(LOG, changes))


@budget(0.25)
@given(edits())
@example([Edit("duplicate", 0, 1289, b"\xff")])  # frames whose times do not increase
def test_a_log_with_damaged_frames_is_read_or_refused(changes):
    assert_read_or_refused(LOG[:HEADER_END] + edited(LOG[HEADER_END:], changes))


@budget(0.25)
@given(st.lists(st.tuples(st.integers(0, len(LINES) - 1), TEXTS), min_size=1, max_size=3))
@example([(next(i for i, line in enumerate(LINES) if b"vbatref" in line), b"\xb2")])
@example([(next(i for i, line in enumerate(LINES) if b"motorOutput" in line), b"abc")])
def test_any_values_in_the_header_are_used_or_refused(changes):
    lines = list(LINES)
    for number, text in changes:
        lines[number] = lines[number].partition(b":")[0] + b":" + text
    assert_read_or_refused(b"\n".join(lines) + b"\n" + LOG[HEADER_END:])


@budget(0.1)
@given(
    st.sampled_from([i for i, line in enumerate(LINES) if line.startswith(b"H Field")]),
    st.integers(0, len(NAMES) - 1),
    st.one_of(
        VALUES.map(lambda value: str(value).encode()), st.sampled_from((*ABSURD, b"time", b"motor[0]", b"eRPM[7]"))
    ),
)
def test_any_field_definition_is_used_or_refused(number, field, text):
    lines = list(LINES)
    name, _, values = lines[number].partition(b":")
    parts = values.split(b",")
    parts[field % len(parts)] = text
    lines[number] = name + b":" + b",".join(parts)
    assert_read_or_refused(b"\n".join(lines) + b"\n" + LOG[HEADER_END:])


def test_a_header_that_names_many_fields_does_not_slow_the_decoder_down():
    names = ",".join(["time", *(f"x{i}" for i in range(1000))])
    zeros = ",".join(["0"] * 1001)
    header = blackbox_log.BEGIN.decode() + "\nH Data version:2\nH Firmware revision:Betaflight 4.5.0\n"
    header += f"H Field I name:{names}\n"
    header += "".join(f"H Field {kind}:{zeros}\n" for kind in ("I signed", "I predictor", "I encoding"))
    header += f"H Field P predictor:{zeros}\nH Field P encoding:{zeros}\n"
    assert isinstance(result_or_refusal(partial(decoded, header.encode() + b"I\0" * 2000)), UsageError)
