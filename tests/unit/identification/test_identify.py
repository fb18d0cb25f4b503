"""Identification recovers planted coefficients with correct standard errors, and refuses what a flight lacks."""

import json
from dataclasses import replace

import numpy as np
import pytest
from planted_flight import plain_file, planted, record, shipped

from swift_ros import cli, configuration
from swift_ros.configuration import read_yaml
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import MotorMap, Vehicle
from swift_sim_bridge.identification import identify as identification
from swift_sim_bridge.physics.state import parameters_from_vehicle

FILE = plain_file()
TRUTH = {
    "thrust_coefficient": 1.05e-6,
    "torque_coefficient": 1.3e-8,
    "terms.rotor_drag.k_d": 6e-5,
    "terms.body_drag.c[0]": 0.008,
    "terms.body_drag.c[1]": 0.003,
    "terms.body_drag.c[2]": 0.012,
    "terms.rotor_gyroscopic.inertia": 8e-6,
    "battery.open_circuit_full": 16.5,
    "battery.open_circuit_slope": 2.0,
    "battery.resistance": 0.02,
    "battery.rc_resistance": 0.006,
    "battery.rc_time": 3.0,
    "battery.efficiency": 0.8,
    "battery.avionics_w": 20.0,
    "motor.map.coefficients[0]": 30.0,
    "motor.map.coefficients[1]": 5.0,
    "motor.map.coefficients[2]": 200.0,
    "motor.map.coefficients[3]": 140.0,
    "motor.map.coefficients[4]": 150.0,
    "motor.time_constant_up": 0.025,
    "motor.time_constant_down": 0.045,
}


def truth() -> Vehicle:
    """Return the shipped vehicle with all values of TRUTH."""
    sections = {
        name: {key.split(".")[1]: value for key, value in TRUTH.items() if key.startswith(name)}
        for name in ("battery",)
    }
    motor_map = MotorMap(tuple(TRUTH[f"motor.map.coefficients[{i}]"] for i in range(5)))
    times = {key: TRUTH[f"motor.{key}"] for key in ("time_constant_up", "time_constant_down")}
    terms = {
        "rotor_drag": {"k_d": TRUTH["terms.rotor_drag.k_d"]},
        "body_drag": {"c": [TRUTH[f"terms.body_drag.c[{i}]"] for i in range(3)]},
        "rotor_gyroscopic": {"inertia": TRUTH["terms.rotor_gyroscopic.inertia"]},
    }
    coefficients = {key: TRUTH[key] for key in ("thrust_coefficient", "torque_coefficient")}
    return planted(terms=terms, motor={"map": motor_map, **times}, **sections, **coefficients)


def identified(*tables, more=(), less=(), content=None):
    """Return the identification of the shipped vehicle from the tables, and its result."""
    found = identification.identify(list(tables), content or read_yaml(FILE), "drone.yaml", more, less)
    return found, identification.as_result(found, list(tables))


def rows(result):
    return {row["name"]: row for row in result["coefficients"]}


def only(table, *channels, without=()):
    kept = {
        name: samples
        for name, samples in table.channels.items()
        if (not channels or name in channels) and name not in without
    }
    return FlightTable(table.name, kept)


@pytest.fixture(scope="module")
def clean():
    return record(truth(), noise=0.0)


def test_without_noise_every_planted_coefficient_is_recovered_within_a_percent(clean):
    _, result = identified(clean, more=["rotor_gyroscopic"])
    for name, value in TRUTH.items():
        assert rows(result)[name]["value"] == pytest.approx(value, rel=0.01), name


@pytest.mark.slow
def test_a_file_without_a_force_of_the_air_gets_every_coefficient_of_the_paper_s_polynomial():
    summands = {
        "f_x": [-0.15, -0.01, 2e-8, -6e-8],
        "f_y": [-0.12, -0.015, -1e-8, -5e-8],
        "f_z": [-0.1, -0.02, 0.05, 0.004, 3e-8, -8e-8, 1e-9],
        "tau_x": [2e-3, 1e-4, 1e-9, 5e-10, 1e-11],
        "tau_y": [-2e-3, -1e-4, 1e-9, -5e-10, 1e-11],
        "tau_z": [1e-3, -1e-3],
    }
    table = record(replace(shipped(), terms={"aerodynamic_polynomial": summands}), noise=0.0)
    _, result = identified(only(table, without=("voltage", "motor_command")), less=["rotor_drag", "body_drag"])
    for name, values in summands.items():
        found = [rows(result)[f"terms.aerodynamic_polynomial.{name}[{i}]"]["value"] for i in range(len(values))]
        np.testing.assert_allclose(found, values, rtol=0.02, err_msg=name)


def test_with_noise_planted_coefficients_lie_near_their_intervals_and_held_out_errors_decrease(tmp_path, capsys):
    table = record(truth(), seed=2)
    flight_files.write(table, tmp_path / "flight.csv")
    arguments = [
        "identify",
        tmp_path / "flight.csv",
        "--vehicle",
        FILE,
        "--with",
        "rotor_gyroscopic",
        "--out",
        tmp_path / "out",
    ]
    assert cli.main(list(map(str, arguments))) == 0
    printed = capsys.readouterr().out
    assert "terms.rotor_drag.k_d" in printed and "RMS error on unseen blocks" in printed
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    off = {
        name: (rows(result)[name]["value"] - value) / rows(result)[name]["standard_error"]
        for name, value in TRUTH.items()
    }
    assert np.mean(np.abs([*off.values()]) < 2.0) > 0.8 and np.abs([*off.values()]).max() < 4.0, off
    for part in result["parts"].values():
        for name, errors in part["held_out_rmse"].items():
            assert errors["after"] < 0.5 * errors["before"], name
    repaired = configuration.load(Vehicle, tmp_path / "out" / "vehicle.yaml")
    assert repaired.motor.time_constant_up == pytest.approx(0.025, rel=0.01) and repaired.mass == shipped().mass
    assert "# thrust_coefficient: 1.0" in (tmp_path / "out" / "vehicle.yaml").read_text()
    assert (tmp_path / "out" / "fit.png").stat().st_size > 10_000


def test_a_hover_identifies_no_drag_and_no_motor_map_and_the_needed_manoeuvres_are_reported():
    table = record(shipped(), size=0.0)
    found, result = identified(table, more=["rotor_gyroscopic"])
    for name in ("terms.rotor_drag.k_d", "terms.body_drag.c[0]", "motor.time_constant_up", "thrust_coefficient"):
        assert "refused" in rows(result)[name] and rows(result)[name]["fly"], name
    assert found.content["terms"]["rotor_drag"] == read_yaml(FILE)["terms"]["rotor_drag"]
    assert "throttle steps" in rows(result)["motor.time_constant_up"]["fly"]


def test_a_log_with_skipped_commands_and_slow_voltage_identifies_forces_and_pack_but_no_time_constant(clean):
    every, rarely = slice(None, None, 5), slice(None, None, 50)
    slow = {
        name: Samples(
            s.t[rarely if name in ("voltage", "current") else every],
            s.values[rarely if name in ("voltage", "current") else every],
        )
        for name, s in clean.channels.items()
    }
    _, result = identified(FlightTable("slow", slow))
    for name, share in (("thrust_coefficient", 0.005), ("terms.rotor_drag.k_d", 0.02), ("battery.resistance", 0.02)):
        assert rows(result)[name]["value"] == pytest.approx(TRUTH[name], rel=share), name
    assert "take its own log" in rows(result)["motor.time_constant_up"]["refused"]


def test_missing_channels_are_reported_and_the_rest_is_identified(clean):
    blind = only(clean, without=("specific_force_body", "current", "motor_command"))
    _, result = identified(blind, more=["rotor_gyroscopic"])
    for name in ("thrust_coefficient", "terms.rotor_drag.k_d", "terms.body_drag.c[2]"):  # from velocity alone
        assert rows(result)[name]["value"] == pytest.approx(TRUTH[name], rel=0.02), name
    assert "nothing that was measured" in rows(result)["battery.efficiency"]["refused"]
    assert "has no motor commands" in result["parts"]["motors"]["missing"]
    assert "no current was recorded" in result["parts"]["battery"]["notes"][0]


def test_equal_rotor_speeds_identify_forces_but_no_moments(clean):
    speeds = clean["rotor_speed"]
    mean = np.sqrt(np.mean(speeds.values**2, axis=1, keepdims=True))
    same = only(clean, without=("voltage", "motor_command"))
    same.channels["rotor_speed"] = Samples(speeds.t, np.repeat(mean, 4, axis=1))
    _, result = identified(same, more=["rotor_gyroscopic"])
    assert rows(result)["thrust_coefficient"]["value"] == pytest.approx(1.05e-6, rel=0.01)
    assert "nothing that was measured" in rows(result)["torque_coefficient"]["refused"]
    assert "moments are left out" in result["parts"]["forces and moments"]["notes"][0]


def test_flights_that_identify_nothing_end_with_exit_code_1(tmp_path, capsys):
    table = record(shipped(), seconds=5.0)
    flight_files.write(only(table, "p_world", "q_world_body", "motor_command"), tmp_path / "poor.csv")
    assert cli.main(["identify", str(tmp_path / "poor.csv"), "--out", str(tmp_path / "out")]) == 1
    assert "has no rotor speeds" in capsys.readouterr().out
    assert configuration.load(Vehicle, tmp_path / "out" / "vehicle.yaml").mass == shipped().mass


def test_an_unknown_term_is_refused_in_one_sentence():
    with pytest.raises(UsageError, match="no force or moment 'warp_drive'"):
        identification.with_terms(read_yaml(FILE), "drone.yaml", ["warp_drive"], [])
    with pytest.raises(UsageError, match="no term 'wind' to leave out"):
        identification.with_terms(read_yaml(FILE), "drone.yaml", [], ["wind"])


def test_blackbird_flies_with_rotor_drag(tmp_path, shared_data):
    assert cli.main(["import", str(shared_data / "blackbird" / "test"), "--out", str(tmp_path)]) == 0
    content = read_yaml(FILE) | {"mass": 0.915, "thrust_coefficient": 1.8511e-6, "inertia": [4.9e-3, 4.9e-3, 6.9e-3]}
    _, result = identified(flight_files.read(tmp_path), content=content, less=["body_drag"])
    drag = rows(result)["terms.rotor_drag.k_d"]["value"]
    speed = np.sqrt(0.915 * 9.81 / (4 * 1.8511e-6))
    assert drag * 4 * speed / 0.915 == pytest.approx(0.355, abs=0.05)  # 1/s: 0.32 and 0.39 on the two axes
    for axis in "xy":
        errors = result["parts"]["forces and moments"]["held_out_rmse"][f"specific force {axis}, body"]
        assert errors["after"] < 0.8 * errors["before"]


@pytest.mark.slow
def test_the_coefficients_of_an_equation_are_estimated_again_with_their_variances():
    def equation(force: float, moment: float) -> dict:
        return {
            "force_y": {"v_x v_z": {"coefficient": force, "range": [-200.0, 200.0]}},
            "moment_z": {"v_y": {"coefficient": moment, "range": [-30.0, 30.0]}},
        }

    flown = replace(shipped(), terms={**shipped().terms, "equation": equation(0.012, 6e-4)})
    content = read_yaml(FILE)
    content["terms"]["equation"] = equation(0.006, 0.0)
    found, result = identified(record(flown, noise=0.0), content=content)
    entry = found.content["terms"]["equation"]
    assert entry["force_y"]["v_x v_z"]["coefficient"] == pytest.approx(0.012, rel=0.01)
    assert entry["moment_z"]["v_y"]["coefficient"] == pytest.approx(6e-4, rel=0.02)
    assert rows(result)["terms.equation.moment_z.v_y.coefficient"]["unit"] == "N s"
    assert np.all(np.diag(entry["covariance"]) > 0.0)
    parameters_from_vehicle(configuration.build(Vehicle, found.content, "the repaired file"))
