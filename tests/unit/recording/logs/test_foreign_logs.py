"""Logs of PX4 and ArduPilot, bags of other graphs and tables of other columns give the flight that was flown."""

import re
import warnings

import flown_logs
import numpy as np
import pytest
from flown_logs import BEGIN_S, flight

from swift_ros import cli
from swift_ros.configuration import load
from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import RowSampling
from swift_ros.recording.log_mapping import mapping_file
from swift_ros.vehicle import Vehicle

LOGS = {
    "flight.ulg": flown_logs.ulog,
    "flight.bin": flown_logs.dataflash,
    "flight.log": flown_logs.dataflash_text,
    "flight.mcap": flown_logs.bag,
    "flight.csv": lambda: flown_logs.csv(flown_logs.columns()),
}
# Largest error of each channel: single precision, hundredths of a degree in ATT, whole microseconds of a pulse
TOLERANCES = {"p_world": 1e-5, "v_world": 1e-5, "gyro_body": 1e-5, "specific_force_body": 1e-4, "q_world_body": 2e-4}
TOLERANCES |= {"motor_command": 1e-3, "voltage": 1e-5}


def written(folder, name: str, content: bytes):
    path = folder / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("name", LOGS)
def test_a_log_gives_the_flown_channels_in_the_frames_of_this_project(tmp_path, name):
    table = flight_files.read(written(tmp_path, name, LOGS[name]()))
    flown = flight()
    truth = {"p_world": flown.p, "v_world": flown.v, "q_world_body": flown.q, "gyro_body": flown.gyro}
    truth |= {"specific_force_body": flown.force, "motor_command": flown.motors}
    for channel, values in truth.items():
        found = table[channel]
        np.testing.assert_allclose(found.t, flown.t, atol=2e-6)
        measured = found.values
        if channel == "q_world_body":
            measured = measured * np.sign(np.sum(measured * values, axis=1, keepdims=True))
        np.testing.assert_allclose(measured, values, atol=TOLERANCES[channel], err_msg=channel)
    assert not table.contradicted and not table.rejections
    assert table.one_clock == name.endswith((".ulg", ".bin", ".log"))
    if "voltage" in table:
        assert abs(np.median(table["voltage"].values) - np.median(flown.volts)) < 0.02


@pytest.mark.parametrize("name", LOGS)
def test_the_gyro_shows_the_place_and_spin_of_each_motor(tmp_path, name):
    order = flight_files.read(written(tmp_path, name, LOGS[name]())).motor_order
    assert str(order).startswith("1 front right, counter-clockwise, 2 rear left, counter-clockwise, 3 front left, cl")


def test_motors_in_another_order_than_the_vehicle_file_are_refused_with_the_right_order(tmp_path, capsys, repository):
    path = written(tmp_path, "flight.ulg", flown_logs.ulog())
    assert cli.main(["identify", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "give its columns as [control[3], control[0], control[1], control[2]]" in capsys.readouterr().err
    vehicle = load(Vehicle, repository / "config/drone.yaml")  # Betaflight's order
    expected = np.array([(np.sign(r.position[1]), -np.sign(r.position[0]), -r.spin) for r in vehicle.rotors])
    signs = np.stack([flown_logs.PLACES[:, 1], -flown_logs.PLACES[:, 0], -flown_logs.SPINS], axis=-1)
    np.testing.assert_array_equal(signs[[3, 0, 1, 2]], expected)


def test_a_log_becomes_a_flight_table_in_a_file(tmp_path, capsys):
    path = written(tmp_path, "flight.bin", flown_logs.dataflash())
    assert cli.main(["import", str(path), "--out", str(tmp_path / "table.csv")]) == 0
    printed = capsys.readouterr().out
    assert "q_world_body = ATT: Roll, Pitch, Yaw (deg, NED, FRD)" in printed
    assert "motors have ArduPilot's order" in printed
    again = flight_files.read(tmp_path / "table.csv")
    np.testing.assert_allclose(again["p_world"].values, flight().p, atol=1e-5)


def test_a_written_mapping_gives_the_same_flight_and_can_be_changed(tmp_path):
    path, mapping = written(tmp_path, "flight.ulg", flown_logs.ulog()), tmp_path / "mapping.yaml"
    assert cli.main(["import", str(path), "--write-mapping", str(mapping)]) == 0
    assert flight_files.read(path, mapping).notes == flight_files.read(path).notes
    turned = mapping.read_text().replace('"control[0]", "control[1]"', '"control[1]", "control[0]"')
    mapping.write_text(turned)
    motors = flight_files.read(path, mapping)["motor_command"].values
    np.testing.assert_allclose(motors, flight().motors[:, [1, 0, 2, 3]], atol=1e-6)


def test_a_mapping_declares_what_a_channel_did_between_two_rows(tmp_path):
    path, mapping = written(tmp_path, "flight.csv", LOGS["flight.csv"]()), tmp_path / "mapping.yaml"
    mapping_file.write(flight_files.open_log(path)[1], mapping)
    plain = flight_files.read(path, mapping)
    declared = mapping_file.read(mapping).with_channel("motor_command", between="held", late=0.001, loop_hz=1000.0)
    mapping_file.write(declared.with_channel("gyro_body", between="mean"), mapping)
    table = flight_files.read(path, mapping)
    assert table.sampling["motor_command"] == RowSampling("held", 0.001, 1000.0) and "p_world" not in table.sampling
    early_s = plain["gyro_body"].t - table["gyro_body"].t
    np.testing.assert_allclose(early_s, 0.5 / plain["gyro_body"].rate_hz, rtol=1e-6)
    np.testing.assert_array_equal(plain["motor_command"].t, table["motor_command"].t)
    mapping.write_text(mapping.read_text().replace("between: mean", "between: guessed"))
    with pytest.raises(UsageError, match="between"):
        flight_files.read(path, mapping)


def test_two_topics_for_a_channel_are_no_guess(tmp_path, capsys):
    path = written(tmp_path, "flight.mcap", flown_logs.bag(("/imu/a", "/imu/b"), seconds=1.0))
    with pytest.raises(UsageError, match="gyro_body may be any of the topics /imu/a, /imu/b; choose in a mapping"):
        flight_files.read(path)


def test_a_channel_below_50_rows_a_second_is_left_out_with_the_setting_that_logs_more(tmp_path):
    flown = flight()
    columns = flown_logs.columns()
    for name in ("acc_x", "acc_y", "acc_z"):
        columns[name] = np.where(np.arange(len(flown.t)) % 20 == 0, columns[name], np.nan)
    table = flight_files.read(written(tmp_path, "flight.csv", flown_logs.csv(columns)))
    assert "specific_force_body" not in table and "q_world_body" in table
    assert any("fewer than 50 rows a second: specific_force_body (10)" in note for note in table.notes)


def test_a_log_of_px4_with_its_default_settings_gives_pose_imu_and_collective_thrust(tmp_path):
    table = flight_files.read(written(tmp_path, "flight.ulg", flown_logs.ulog(default_profile=True)))
    flown = flight()
    np.testing.assert_allclose(table["p_world"].values, flown.p[::20], atol=1e-5)
    assert table["q_world_body"].rate_hz == pytest.approx(20.0) and table["gyro_body"].rate_hz == pytest.approx(200.0)
    thrust = np.repeat(flown.motors.mean(axis=1)[::4, None], 4, axis=1)
    np.testing.assert_allclose(table["motor_command"].values, thrust, atol=1e-6)
    assert any("logged 10 times a second; each motor has their mean" in note for note in table.notes)
    assert table.motor_order is None and not table.contradicted


def test_a_slow_pose_needs_a_gyro_and_an_accelerometer_beside_it(tmp_path):
    columns = flown_logs.columns()
    for name in ("pos_x", "pos_y", "pos_z"):
        columns[name] = np.where(np.arange(len(flight().t)) % 20 == 0, columns[name], np.nan)
    table = flight_files.read(written(tmp_path, "flight.csv", flown_logs.csv(columns)))
    np.testing.assert_allclose(table["p_world"].values, flight().p[::20], atol=1e-9)
    without = {name: values for name, values in columns.items() if "gyro" not in name}
    table = flight_files.read(written(tmp_path, "flight.csv", flown_logs.csv(without)))
    assert any("fewer than 50 rows a second: p_world (10)" in note for note in table.notes)


def test_a_truncated_log_is_read_up_to_its_end(tmp_path):
    content = flown_logs.ulog()
    with pytest.warns(DamagedRecording, match="the log ends there, 5.9.* s after its first message"):
        table = flight_files.read(written(tmp_path, "flight.ulg", content[: len(content) // 2 + 7]))
    lost_from_s = table["gyro_body"].t[-1]
    assert 5.9 < lost_from_s < 6.1
    np.testing.assert_allclose(table["gyro_body"].values, flight().gyro[: len(table["gyro_body"].t)], atol=1e-5)


@pytest.mark.parametrize("name", ["flight.ulg", "flight.bin"])
def test_a_lost_part_is_named_and_what_follows_is_read(tmp_path, name):
    content = LOGS[name]()
    first = len(content) // 2 + 5
    damaged = content[:first] + bytes(3000) + content[first + 3000 :]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        table = flight_files.read(written(tmp_path, name, damaged))
    (text,) = [str(one.message) for one in caught if one.category is DamagedRecording]
    before, after = map(float, re.search(r"between ([\d.]+) s and ([\d.]+) s", text).groups())
    t = table["gyro_body"].t
    gap = int(np.argmax(np.diff(t)))
    assert before <= t[gap] + 0.006 and t[gap + 1] - 0.006 <= after  # a row is 5 ms
    assert 0.0 < after - before < 0.2  # 3,000 bytes are 26 rows
    kept = np.isin(np.round(flight().t, 4), np.round(t, 4))
    np.testing.assert_allclose(table["gyro_body"].values, flight().gyro[kept], atol=1e-5)


def test_a_log_of_text_names_the_line_that_is_no_message(tmp_path):
    lines = flown_logs.dataflash_text().split(b"\n")
    lines[200] = b"\x00\x01garbage, 1"
    with pytest.warns(DamagedRecording, match="line 201 cannot be read"):
        table = flight_files.read(written(tmp_path, "flight.log", b"\n".join(lines)))
    assert len(table["gyro_body"].t) >= len(flight().t) - 1


def test_times_count_from_the_first_message_of_the_log_not_from_its_clock(tmp_path):
    assert BEGIN_S > 0
    table = flight_files.read(written(tmp_path, "flight.ulg", flown_logs.ulog()))
    assert table.span_s[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", ["flight.ulg", "flight.bin", "flight.log"])
@pytest.mark.parametrize("content", [b"", b"hello", b"\0" * 5000])
def test_a_file_that_is_no_log_is_refused_in_one_sentence(tmp_path, name, content):
    with pytest.raises(UsageError, match="is not a"):
        flight_files.read(written(tmp_path, name, content))
