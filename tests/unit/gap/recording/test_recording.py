"""Recordings are checked before any reference flight: what they lack is named as a pilot names it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swift_ros import cli, geometry
from swift_ros.configuration import build, configuration_folder, load, read_yaml
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.commands import gap
from swift_sim_bridge.gap.effects.catalogue import catalogue, draught
from swift_sim_bridge.gap.nominal import rotor_speed_model
from swift_sim_bridge.gap.pipeline import hypotheses, prepare
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.recording.motor_record import motor_record_of
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.report import effect_help
from swift_sim_bridge.gap.report.content import sentence as report_sentence
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

T = np.arange(0.0, 8.0, 0.01)
FOLDER = configuration_folder()
DRONE, BLACKBIRD = FOLDER / "drone.yaml", FOLDER / "vehicles" / "blackbird.yaml"
SHIPPED = load(Vehicle, DRONE)
POSE, GYRO, ACCELEROMETER = ("p_world", "q_world_body"), ("gyro_body",), ("specific_force_body",)


def flight(*channels: str) -> FlightTable:
    """Return these channels of a hover, a little noisy."""
    rng = np.random.default_rng(1)
    heading = geometry.quaternion_from_yaw(0.01 * rng.standard_normal(len(T)))
    whole = {
        "p_world": np.array([0.0, 0.0, 2.0]) + np.zeros((len(T), 3)),
        "gyro_body": np.zeros((len(T), 3)),
        "specific_force_body": np.array([0.0, 0.0, GRAVITY]) + np.zeros((len(T), 3)),
        "rotor_speed": np.full((len(T), 4), SHIPPED.hover_speed),
        "motor_command": np.full((len(T), 4), 0.25),
        "thrust_command": np.full(len(T), GRAVITY),
        "voltage": np.full(len(T), 15.5),
        "omega_command_body": np.zeros((len(T), 3)),
    }
    noisy = {name: values + 1e-3 * rng.standard_normal(values.shape) for name, values in whole.items()}
    return FlightTable("flight", {name: Samples(T, {"q_world_body": heading, **noisy}[name]) for name in channels})


@pytest.mark.parametrize(
    "channels",
    [(*POSE, "thrust_command"), (*ACCELEROMETER, "thrust_command"), (*ACCELEROMETER, "rotor_speed")],
)
def test_a_recording_of_which_nothing_can_be_compared_is_refused_before_any_reference_flight_is_flown(channels):
    with pytest.raises(UsageError) as error:
        prepare.prepare_evidence([flight(*channels)], SHIPPED, Options(pytest.fail))
    assert "flight: no residual can be computed from its channels; record" in str(error.value)


def test_some_of_a_fast_loops_commands_are_reported_as_too_few_for_the_motors():
    whole = flight(*POSE, *GYRO, *ACCELEROMETER, "rotor_speed", "motor_command", "voltage")
    assert "motor_time_constant" not in not_testable(whole)
    assert {"wind", "gust", "local_draught"} <= set(not_testable(flight(*POSE, *GYRO, *ACCELEROMETER)))
    assert not_testable(replace(whole, skips_commands=True))["motor_time_constant"].startswith(
        "the recording lacks all motor commands that the motors received: it has some of a faster loop's"
    )


def test_residuals_are_zero_while_vio_or_a_battery_sensor_is_silent():
    whole = flight(*POSE, *GYRO, *ACCELEROMETER, "rotor_speed", "voltage")
    pose = {"p_vio": whole["p_world"].values + 0.1, "q_vio_body": whole["q_world_body"].values}
    late = (T > 2.0) & ~((T > 4.0) & (T < 5.0))
    vio = {name: Samples(T[late], values[late]) for name, values in pose.items()}
    read = read_recording(replace(whole, channels={**whole.channels, **vio}), SHIPPED)
    residual_model = ResidualModel(read)
    found, t = residual_model.residual(SHIPPED), residual_model.t
    inside = (t < 1.9) | ((t > 4.1) & (t < 4.9))
    for i, channel in enumerate(residual_model.channels):
        of_vio = channel.layer == "vio"
        assert np.all(found[inside, i] == 0.0) == of_vio and np.any(found[~inside, i] != 0.0)
        assert np.all(residual_model.measured[inside, i]) != of_vio
    meter = Samples(T[T < 5.0], whole["voltage"].values[T < 5.0])
    read = read_recording(replace(whole, channels={**whole.channels, "voltage": meter}), SHIPPED)
    residual_model = ResidualModel(read)
    volts = next(i for i, channel in enumerate(residual_model.channels) if channel.name == "voltage")
    assert np.all(residual_model.residual(SHIPPED)[residual_model.t > 6.0, volts] == 0.0)


def test_a_flight_that_never_leaves_the_ground_is_refused():
    idle = flight(*POSE, *GYRO, *ACCELEROMETER, "rotor_speed")
    idle = replace(idle, channels={**idle.channels, "rotor_speed": Samples(T, np.full((len(T), 4), 150.0))})
    with pytest.raises(UsageError, match="its rotors never lift the vehicle by its file"):
        read_recording(idle, SHIPPED)


def test_a_flight_that_is_too_short_is_refused():
    hop = flight(*POSE, *GYRO, *ACCELEROMETER, "rotor_speed")
    speed = np.where(T[:, None] > 6.0, hop["rotor_speed"].values, 100.0)
    up = hop["p_world"].values + np.array([0.0, 0.0, 1.0]) * np.maximum(T[:, None] - 6.0, 0.0)
    hop = replace(hop, channels={**hop.channels, "rotor_speed": Samples(T, speed), "p_world": Samples(T, up)})
    with pytest.raises(UsageError, match=r"flight: it flies for only 1.8 s while all channels .* fly for longer"):
        read_recording(hop, SHIPPED, simulated=True)


def test_other_numbers_of_motors_are_refused_where_only_commands_were_recorded():
    six = FlightTable("flight", {"motor_command": Samples(T, np.full((len(T), 6), 0.25))})
    with pytest.raises(UsageError, match="flight has 6 rotors, the vehicle 4"):
        rotor_speed_model.with_modelled_rotor_speeds(six, SHIPPED)


def test_channels_without_common_times_are_refused_as_on_other_clocks():
    whole = flight(*POSE, *GYRO, *ACCELEROMETER)
    gyro = whole["gyro_body"]
    apart = {**whole.channels, "gyro_body": Samples(gyro.t + 100.0, gyro.values)}
    with pytest.raises(UsageError, match=r"gyro \(wx wy wz\).* were never recorded at the same time; check their"):
        read_recording(replace(whole, channels=apart), SHIPPED)


def test_all_commands_between_two_rotor_speeds_act():
    """A lag of 33 ms, commands at 500 Hz and speeds at 100: with every fifth command alone it would be 29 ms."""
    t = np.arange(0.0, 8.0, 0.002)
    command = 0.3 + 0.1 * np.sin(2 * np.pi * 3.0 * t + 0.4)
    speed, dense = np.full(len(t), 0.3), SHIPPED.motor.time_constant_up
    for k in range(len(t) - 1):
        speed[k + 1] = command[k] + (speed[k] - command[k]) * np.exp(-0.002 / dense)
    table = FlightTable(
        "flight",
        {
            "motor_command": Samples(t, np.tile(command[:, None], 4)),
            "rotor_speed": Samples(t[::5], np.tile(speed[::5, None], 4)),
        },
    )
    motor_record = motor_record_of(table, SHIPPED)

    def missed(lag_s):
        found = [motor_record.rotor_speed[0, 0]]
        for u, step in zip(motor_record.command[:, 0], np.diff(motor_record.t), strict=True):
            found.append(u + (found[-1] - u) * np.exp(-step / lag_s))
        return float(np.sum((np.array(found) - motor_record.rotor_speed[:, 0])[100:] ** 2))

    lags = dense * np.linspace(0.8, 1.2, 81)
    assert min(lags, key=missed) == pytest.approx(dense, rel=0.02)


def test_channels_of_one_clock_do_not_drift_against_each_other():
    table = flight(*POSE, *GYRO, *ACCELEROMETER, "rotor_speed")
    assert "clock_drift" not in not_testable(table)
    assert not_testable(replace(table, one_clock=True))["clock_drift"].endswith("have the stamps of one clock")


def not_testable(table: FlightTable, vehicle: Vehicle = SHIPPED) -> dict[str, str]:
    return hypotheses.testable(
        vehicle, [read_recording(rotor_speed_model.with_modelled_rotor_speeds(table, vehicle), vehicle)]
    )[1]


def test_missing_channels_have_readable_names_and_recorded_motor_commands_are_not_among_them():
    reasons = not_testable(flight(*POSE, *GYRO, *ACCELEROMETER, "motor_command"))
    for name in ("motor_time_constant", "inertia"):
        assert reasons[name] == "the recording lacks each rotor's own speed (rotor_1 ..)"
    assert reasons["battery_sag"] == "the recording lacks the pack's voltage (vbat)"
    assert reasons["command_latency"] == (
        "the recording lacks commanded rates (cmd_wx cmd_wy cmd_wz), commanded thrust (cmd_thrust)"
    )
    reasons = not_testable(flight(*GYRO, *ACCELEROMETER, "rotor_speed", "motor_command"))
    assert reasons["marker_offset"] == "the recording lacks position (px py pz), attitude (qx qy qz qw)"
    assert not any("_body" in reason or "_world" in reason for reason in reasons.values())


def test_wind_is_explained_also_where_the_vehicle_file_has_no_drag_and_why_it_is_not_testable():
    blackbird = load(Vehicle, BLACKBIRD)
    reasons = not_testable(flight(*POSE, *GYRO, *ACCELEROMETER, "rotor_speed"), blackbird)
    for name in ("wind", "gust", "local_draught", "drag_center"):
        text = effect_help.describe_effect(name, blackbird)
        assert text.startswith(f"{name}: ") and text.splitlines()[-1] == f"not testable with this file: {reasons[name]}"
        assert "not testable" not in effect_help.describe_effect(name, SHIPPED)
    assert "through which it acts" in reasons["wind"] and "\nwind " in effect_help.effect_table(blackbird)
    assert "needs gyro (wx wy wz), position (px py pz), attitude (qx qy qz qw)" in effect_help.describe_effect(
        "gyro_bias", blackbird
    )


def said(capsys, *words) -> str:
    assert cli.main(["gap", *map(str, words)]) == 2
    return capsys.readouterr().err


def test_a_seed_below_zero_and_a_vehicle_too_weak_for_its_map_are_refused_in_a_sentence(tmp_path, capsys):
    assert "--seed is -1; give a whole number from 0" in said(capsys, tmp_path / "none.csv", "--seed", -1)
    content = read_yaml(DRONE)
    content["motor"]["map"]["coefficients"] = [0.0, 0.0, 250.0, 100.0, 60.0]
    gap.refuse_weak(SHIPPED, DRONE)
    with pytest.raises(UsageError) as error:
        gap.refuse_weak(build(Vehicle, content, "weak.yaml"), "weak.yaml")
    assert str(error.value).startswith(
        "weak.yaml: this vehicle cannot hover: at full command and 15.9 V its motor map "
        "gives 1304 rad/s, hover takes 1382;"
    )


@pytest.mark.parametrize("path", sorted(FOLDER.glob("vehicles/*.yaml")) + [DRONE], ids=lambda path: path.stem)
def test_every_shipped_vehicle_hovers_by_its_motor_map(path):
    assert gap.refuse_weak(load(Vehicle, path), path) is None  # it raises where it refuses


def test_a_misspelt_noise_is_refused_with_the_nearest_known():
    content = read_yaml(DRONE)
    content["sensors"]["gyro_rads"] = content["sensors"].pop("gyro_rad_s")
    with pytest.raises(UsageError, match="unknown key 'gyro_rads'; the nearest known one is 'gyro_rad_s'"):
        build(Vehicle, content, "drone.yaml")


def test_results_of_an_earlier_diagnosis_stay_when_a_recording_is_refused(tmp_path, capsys):
    out, flown = tmp_path / "out", flight(*ACCELEROMETER, "rotor_speed")
    out.mkdir()
    (out / "report.json").write_text("{}")
    flight_files.write(flown, tmp_path / "flight.csv")
    assert "no residual can be computed from its channels" in said(capsys, tmp_path / "flight.csv", "--out", out)
    assert (out / "report.json").read_text() == "{}"
    (out / "mine.txt").write_text("keep")
    assert "contains other files (mine.txt)" in said(capsys, tmp_path / "flight.csv", "--out", out)
    assert (out / "report.json").exists()


def test_results_never_replace_their_inputs(tmp_path, capsys):
    repaired, flown = tmp_path / "vehicle.yaml", tmp_path / "flights" / "flight.csv"
    repaired.write_text(DRONE.read_text())
    assert f"{repaired} lies in {tmp_path}, which is emptied" in said(
        capsys, flown, "--vehicle", repaired, "--out", tmp_path
    )
    assert f"{flown} lies in {tmp_path}" in said(capsys, flown, "--out", tmp_path)
    assert "vehicle.yaml lies in" in said(capsys, "--self-test", "--vehicle", repaired, "--out", tmp_path)
    assert repaired.read_text() == DRONE.read_text()


def test_a_self_test_takes_no_recording_and_has_a_folder_of_its_own(tmp_path, monkeypatch, capsys):
    assert "--self-test flies its own flights" in said(capsys, tmp_path / "flight.csv", "--self-test")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(gap, "self_test", lambda vehicle, out: 0 if out == gap.SELF_TEST_OUT else pytest.fail(str(out)))
    gap.OUT.mkdir(parents=True)
    (gap.OUT / "report.json").write_text("{}")
    assert cli.main(["gap", "--self-test"]) == 0 and (gap.OUT / "report.json").exists()


def test_recordings_of_one_name_are_distinguished_by_their_folders():
    bags, logs = [FlightTable("bag", {})] * 2, [FlightTable("first.csv", {}), FlightTable("second.csv", {})]
    paths = [Path("race/seed-0/bag"), Path("race/seed-1/bag")]
    assert [one.name for one in gap.with_unique_names(bags, paths)] == ["seed-0/bag", "seed-1/bag"]
    assert gap.with_unique_names(logs, paths) == logs


def test_a_recording_that_is_given_twice_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert "flight.csv is given twice" in said(capsys, "flight.csv", tmp_path / "flight.csv")


@pytest.mark.parametrize(
    ("section", "key", "value", "sentence"),
    [
        ("motor", "time_constant_up", 0, "'motor.time_constant_up' must be positive, in s"),
        ("sensors", "gyro_rad_s", "a", "'sensors.gyro_rad_s' must be a number, 0 or more, not 'a'"),
        ("sensors", "vbat_v", -0.1, "'sensors.vbat_v' must be a number, 0 or more, not -0.1"),
    ],
)
def test_an_impossible_number_in_the_vehicle_file_is_refused(section, key, value, sentence):
    content = read_yaml(DRONE)
    content[section][key] = value
    with pytest.raises(UsageError, match=re.escape(sentence)):
        build(Vehicle, content, "drone.yaml")


def test_a_vehicle_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "drone.yaml").write_bytes(b"name: caf\xe9\n")
    with pytest.raises(UsageError, match="drone.yaml is not UTF-8 text at line 1; save it as UTF-8"):
        read_yaml(tmp_path / "drone.yaml")


@pytest.mark.parametrize(
    ("key", "values", "sentence"),
    [
        ("time_offset", [-0.002], "The pose is 0.002 s early against the IMU."),
        ("time_offset", [0.002], "The pose is 0.002 s late against the IMU."),
        ("vio_scale", [-0.02], "Distances of VIO are 2.00% too short."),
    ],
)
def test_a_sentence_gives_the_direction_of_an_error(key, values, sentence):
    (effect,) = (one for one in catalogue(SHIPPED) if one.key == key)
    assert report_sentence(effect, values) == sentence


def test_the_sentence_of_a_draught_has_units():
    assert report_sentence(draught(), [5.0, -2.0, 0.3, 1.0, 8.5, 1.5, 3.75]) == (
        "A draught of 5, -2, 0.3 m/s blows within 3.75 m of 1, 8.5, 1.5 m."
    )


def test_an_effect_is_explained_in_words_with_its_equation_and_what_to_fly():
    assert effect_help.describe_effect("rotor_drag", SHIPPED).splitlines()[:2] == [
        "rotor_drag: the rotors drag by ... N/(rad/s m/s) each",
        "equation: F_i,xy = -k_d Omega_i v_i,xy",
    ]
    assert "damaged_propeller: propeller ... gives ... less thrust\n" in effect_help.describe_effect(
        "damaged_propeller", SHIPPED
    )
    assert "payload: it carries a load of ... kg at ..., ..., ... m" in effect_help.describe_effect("payload", SHIPPED)
    for name in ("slung_load", "corner_noise"):
        _, equation, manoeuvre = effect_help.describe_effect(name, SHIPPED).splitlines()
        assert equation.startswith("equation: ") and manoeuvre.startswith("to see it, fly: ")
    assert effect_help.describe_effect("motor_saturation", SHIPPED).endswith(
        "not identified under this name; the simulated flight controller limits its commands to the motors' range"
    )
    assert "time_offset: the pose is ... s late against the IMU\n" in effect_help.describe_effect(
        "time_offset", SHIPPED
    )
