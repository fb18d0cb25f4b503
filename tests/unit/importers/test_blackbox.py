"""Blackbox logs: complete, truncated and damaged files, units, and alignment to a bag."""

import json

import numpy as np
import pytest
from blackbox_writer import INTERVAL, NAMES, written

from swift_ros import cli
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.importers import alignment, blackbox, blackbox_log
from swift_ros.messages.motion import to_imu, to_odometry
from swift_ros.messages.serialization import serialize
from swift_ros.recording import flight_files
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.types import Odometry

N, STEP_US, BEGIN_US = 9000, 1000, (1 << 32) - 2_000_000  # the controller's clock overflows after two seconds
T = STEP_US * 1e-6 * np.arange(N)


def turning(t):
    """Return body rates (n, 3) rad/s of a flight that does not repeat."""
    slow, fast = np.array([2.1, 2.7, 1.1]), np.array([7.3, 6.1, 4.7])
    amplitude = np.array([3.0, 2.5, 1.2]) * (0.5 + 0.5 * np.sin(0.31 * t[:, None] + np.arange(3)))
    return amplitude * np.sin(slow * t[:, None] + 0.2 * t[:, None] ** 1.3) + 0.5 * np.sin(fast * t[:, None])


def flight_rows(t=T) -> np.ndarray:
    """Return the frames (n, 33) of that flight, with numbers of all sizes."""
    rng, rows = np.random.default_rng(7), np.zeros((len(t), len(NAMES)), dtype=np.int64)
    columns = {name: rows[:, i] for i, name in enumerate(NAMES)}
    columns["loopIteration"][:] = np.arange(len(t))
    columns["time"][:] = (BEGIN_US + np.round(1e6 * t).astype(np.int64) + rng.integers(-3, 4, len(t))) % (1 << 32)
    gyro = np.rad2deg(turning(t))
    for i in range(3):
        columns[f"axisI[{i}]"][:] = np.cumsum(
            rng.choice([0, 1, -3, 20, -300, 40_000, -9_000_000], len(t), p=[0.6, 0.2, 0.1, 0.07, 0.01, 0.01, 0.01])
        )
        columns[f"gyroADC[{i}]"][:] = np.round(gyro[:, i] + rng.standard_normal(len(t)))
        columns[f"setpoint[{i}]"][:] = np.round(gyro[:, i])
        columns[f"axisF[{i}]"][:] = rng.integers(-40, 40, len(t))
        columns[f"accSmooth[{i}]"][:] = rng.integers(-30, 30, len(t)) + (2048 if i == 2 else 0)
    columns["setpoint[3]"][:] = 400
    for i in range(4):
        columns[f"rcCommand[{i}]"][:] = 1000 + np.cumsum(rng.choice([0, 3, -40, 300, -260], len(t))) % 900
        columns[f"motor[{i}]"][:] = 158 + np.cumsum(rng.integers(-9, 10, len(t))) % 1889
        columns[f"eRPM[{i}]"][:] = np.round(1500 + 400 * np.sin(t + i) + rng.standard_normal(len(t)))
    columns["vbatLatest"][:] = 1672 - np.arange(len(t)) // 300
    columns["amperageLatest"][:] = 2500 + rng.integers(-40, 40, len(t))
    columns["rssi"][:] = 1000
    return rows


def check_rows(log: blackbox_log.Log, rows) -> None:
    """Assert that the frames of a log are these rows, each at its time."""
    read = np.stack([log.fields[name] for name in NAMES], axis=1)
    np.testing.assert_array_equal(read, rows)
    np.testing.assert_array_equal(log.time_us % (1 << 32), rows[:, NAMES.index("time")])
    assert np.all(np.diff(log.time_us) > 0)


def test_every_frame_is_decoded_also_across_an_overflow_of_the_clock():
    rows = flight_rows()
    log = blackbox_log.decode(written(rows), "flight.bbl")
    check_rows(log, rows)
    assert log.ended and not log.gaps and log.header["Firmware revision"].startswith("Betaflight 4.5.2")


@pytest.mark.parametrize("cut", [1, 7, 30, 43])
def test_a_truncated_log_is_decoded_up_to_its_end(cut):
    rows = flight_rows(T[:500])
    log = blackbox_log.decode(written(rows, ended=False)[:-cut], "flight.bbl")
    count = len(log.time_us)
    assert not log.ended and 495 <= count < 500
    check_rows(log, rows[:count])


def test_damaged_frames_are_reported_and_decoding_continues_at_the_next_valid_frame():
    rows, data = flight_rows(T[:2000]), bytearray(written(flight_rows(T[:2000])))
    middle = len(data) // 2
    data[middle : middle + 400] = np.random.default_rng(1).integers(0, 256, 400).astype(np.uint8).tobytes()
    log = blackbox_log.decode(bytes(data), "flight.bbl")
    lost = 2000 - len(log.time_us)
    assert 0 < lost < 400 // 20 + 3 * INTERVAL
    assert len(log.gaps) == 1 and log.ended
    first = int(np.searchsorted(log.time_us, log.gaps[0][0], "right"))
    check_rows(log, np.concatenate([rows[:first], rows[first + lost :]]))


def test_a_pause_of_a_minute_loses_only_the_frames_up_to_the_next_i_frames():
    rows = flight_rows(T[:800])
    rows[400:, NAMES.index("time")] += 60_000_000
    log = blackbox_log.decode(written(rows), "flight.bbl")
    assert log.ended and len(log.time_us) > 800 - 3 * INTERVAL
    assert [round((end - begin) * 1e-6) for begin, end in log.gaps] == [60]


def test_a_field_that_is_always_zero_was_not_measured(tmp_path):
    rows = flight_rows(T[:1500])
    for name in (*(f"eRPM[{i}]" for i in range(4)), "amperageLatest"):
        rows[:, NAMES.index(name)] = 0
    (tmp_path / "plain.bbl").write_bytes(written(rows))
    assert cli.main(["import", str(tmp_path / "plain.bbl"), "--out", str(tmp_path / "out")]) == 0
    table = flight_files.read(tmp_path / "out" / "plain")
    assert "rotor_speed" not in table and "current" not in table and "motor_command" in table and "voltage" in table


def test_a_file_with_two_logs_is_imported_as_two_bags_in_si_units(tmp_path, capsys):
    rows = flight_rows(T[:1500])
    (tmp_path / "day.BBL").write_bytes(written(rows) + written(rows, ended=False)[:-5])
    assert cli.main(["import", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    output = capsys.readouterr().out
    assert "log 2 of 2" in output and "truncated" in output
    table = flight_files.read(tmp_path / "out" / "day-1")
    named = {name: rows[:, i].astype(float) for i, name in enumerate(NAMES)}
    sizes = {
        "gyro_body": ("gyroADC", np.pi / 180),
        "specific_force_body": ("accSmooth", 9.80665 / 2048),
        "rotor_speed": ("eRPM", 100 / 7 * 2 * np.pi / 60),
        "omega_command_body": ("setpoint", np.pi / 180),
        "feedforward_body": ("axisF", 1e-3),
    }
    for channel, (field, size) in sizes.items():
        assert table[channel].values[-1, 0] == pytest.approx(size * named[f"{field}[0]"][-1]), channel
    np.testing.assert_allclose(table["motor_command"].values[:, 1], (named["motor[1]"] - 48) / 1999)
    assert table["voltage"].values[0] == pytest.approx(16.72)
    assert table["current"].values[0] == pytest.approx(25, abs=0.5)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert [row["recording"] for row in result["recordings"]] == ["day-1", "day-2"]


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda data: b"ULog" + data[100:], "not a blackbox log"),
        (lambda data: data.replace(b"Betaflight 4.5.2", b"INAV 7.1.0"), "written by INAV 7.1.0"),
        (lambda data: data.replace(b"Data version:2", b"Data version:1"), "data version 1"),
        (lambda data: data.replace(b"Field P predictor:6,2", b"Field P predictor:6,x"), "is damaged"),
        (lambda data: data[: data.index(b"blackbox_high_resolution:0") + 27], "holds no flight"),
    ],
)
def test_an_unsupported_file_is_refused_in_one_sentence(tmp_path, capsys, change, sentence):
    path = tmp_path / "flight.bbl"
    path.write_bytes(change(written(flight_rows(T[:64]))))
    assert cli.main(["import", str(path), "--out", str(tmp_path / "out")]) == 2
    assert sentence in capsys.readouterr().err


OFFSET_S, DRIFT = 1.7e9 + 0.1234567, 60e-6


def bag_of_the_flight(folder, t_flight, gyro):
    """Write a bag with the gyro at 100 Hz on another clock, and with a pose."""
    writer = BagWriter(folder)
    for name in ("imu/data_raw", "ground_truth/odometry"):
        writer.add_topic(full_name(name), TOPICS[name].type)
    for seconds, rate in zip(t_flight * (1 + DRIFT) + OFFSET_S, gyro, strict=True):
        stamp_ns = round(seconds * 1e9)
        imu = serialize(to_imu(stamp_ns, rate, np.array([0.0, 0.0, 9.8])))
        writer.write(full_name("imu/data_raw"), imu, stamp_ns)
        state = Odometry(stamp_ns, np.array([seconds % 7, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), rate)
        data = serialize(to_odometry(state, "map"))
        writer.write(full_name("ground_truth/odometry"), data, stamp_ns)
    writer.close()
    return folder


def test_offset_and_drift_of_the_clocks_are_estimated_from_the_gyros():
    t_log, t_bag = np.arange(0.0, 60.0, 0.001), np.arange(8.0, 75.0, 0.01)
    rng = np.random.default_rng(3)
    gyros = (turning(t) + 0.02 * rng.standard_normal((len(t), 3)) for t in (t_log, t_bag))
    found = alignment.align(t_log, next(gyros), t_bag * (1 + DRIFT) + OFFSET_S, next(gyros))
    for t in (10.0, 55.0):
        assert found.at(t) == pytest.approx(t * (1 + DRIFT) + OFFSET_S, abs=5e-4)
    assert found.drift == pytest.approx(DRIFT, abs=2e-5) and found.correlation > 0.98


def test_a_log_is_aligned_to_the_clock_of_a_bag_of_the_same_flight(tmp_path, capsys):
    path = tmp_path / "flight.bbl"
    path.write_bytes(written(flight_rows()))
    t = np.arange(1.0, 8.0, 0.01)
    bag = bag_of_the_flight(tmp_path / "bag", t, turning(t))
    code = cli.main(["import", str(path), "--align", str(bag), "--out", str(tmp_path / "out")])
    assert code == 0 and "aligned: to bag: offset" in capsys.readouterr().out
    table = flight_files.read(tmp_path / "out" / "flight")
    assert table["p_world"].rate_hz == pytest.approx(100, rel=0.01)
    assert table["gyro_body"].rate_hz == pytest.approx(1000, rel=0.01)
    begin = table["p_world"].t[0]  # the bag began a second after the log
    assert begin == pytest.approx(1.0, abs=0.001)
    error = table["gyro_body"].values - turning(table["gyro_body"].t)
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_the_bag_of_another_flight_is_refused():
    t = np.arange(0.0, 20.0, 0.005)
    with pytest.raises(UsageError, match="do not agree"):
        alignment.align(t, turning(t), t, turning(t[::-1])[:, [2, 0, 1]])
    circle = np.stack([0 * t, 0 * t, np.sin(2 * t)], axis=1)
    with pytest.raises(UsageError, match="several offsets"):
        alignment.align(t, circle, t, circle)


def test_a_log_faster_than_a_flight_table_is_decimated(tmp_path):
    rows = flight_rows(T[:800])
    rows[:, NAMES.index("time")] = np.arange(800) * 125
    path = tmp_path / "fast.bbl"
    path.write_bytes(written(rows))
    flight = blackbox.read(blackbox.find(path)[0])
    assert len(flight.t) == 200 and np.median(np.diff(flight.t)) == pytest.approx(0.0005)
