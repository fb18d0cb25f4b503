"""The gap tool on flights with effects planted by the simulator: it identifies these effects and no others."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, STEP_S, flight, hover, path, vehicle

from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.pipeline import references, single_flight
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.pipeline.prepare import Prior
from swift_sim_bridge.gap.validation import localization


def test_a_hover_identifies_the_gyro_scale_only_on_axes_that_rotate(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    found = api.diagnose(
        [flight(4, along=hover, gyro_scale=[0.0, 0.0, 0.04])], vehicle(), lambda text: None, validate=False
    )
    (one,) = found.report["findings"]
    sizes = [one["parameters"][f"scale[{i}]"]["value"] for i in range(3)]
    assert one["effect"] == "gyro_scale" and sizes == pytest.approx([0.0, 0.0, 0.04], abs=2e-3)


@cache
def drag_and_lag() -> tuple:
    """Return a flight with drag and a motor lag that the vehicle file lacks, and its diagnosis."""
    recording = flight(3, rotor_drag=[6e-5], motor_time_constant=[0.038])
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
        return recording, api.diagnose([recording], vehicle(), lambda text: None)


def test_planted_drag_and_motor_lag_are_identified_and_reduce_the_errors_on_held_out_parts():
    _, found = drag_and_lag()
    entries = {one["effect"]: one for one in found.report["findings"]}
    assert set(entries) == {"rotor_drag", "motor_time_constant"}
    assert entries["rotor_drag"]["parameters"]["k_d"]["value"] == pytest.approx(6e-5, rel=0.03)
    assert entries["motor_time_constant"]["parameters"]["time_constant_up"]["value"] == pytest.approx(0.038, rel=0.02)
    assert found.vehicle.motor.time_constant_down == pytest.approx(0.038, rel=0.02)
    shown = found.report["improvement"]["held_out"]
    assert shown["rollout_rmse_m"]["0.5"]["after"] < 0.7 * shown["rollout_rmse_m"]["0.5"]["before"]
    step = shown["one_step_rmse"]
    assert step["after"] < min(step["knn"], step["gp"]) and max(step["knn"], step["gp"]) < step["before"]
    for axis in "xy":
        force, way = shown["one_step_rmse_by_axis"][axis], shown["rollout_rmse_m_by_axis"][axis]["0.5"]
        assert force["after"] < 0.7 * force["before"] and way["after"] < way["before"]
    assert shown["one_step_rmse_by_speed"]["fast"]["before"] > shown["one_step_rmse_by_speed"]["slow"]["before"]
    assert found.report["improvement"]["left"] == {"verdict": "nothing_left_out", "findings": []}
    where = {one["effect"]: one for one in localization.locate_findings(found, vehicle())["findings"]}
    assert where["rotor_drag"]["channels"] == ["specific_force_x", "specific_force_y"]
    assert where["motor_time_constant"]["channels"] == [f"rotor_speed_{i}" for i in (1, 2, 3, 4)]


def test_a_second_diagnosis_names_what_half_a_repair_leaves_with_the_reference_flights_of_the_first(monkeypatch):
    recording, found = drag_and_lag()
    half = replace(vehicle(), terms=vehicle().terms | {"rotor_drag": {"k_d": 6e-5}})
    silent = Options(lambda text: None)
    monkeypatch.setattr(references, "fly_references", lambda *_: pytest.fail("reference flights fly again"))
    with jax.enable_x64(True):
        left = single_flight.diagnose_repaired(found.evidence, [recording], half, silent, Prior())
    (one,) = left["findings"]
    assert one["effect"] == "motor_time_constant"
    assert one["parameters"]["time_constant_up"]["value"] == pytest.approx(0.038, rel=0.02)


@pytest.mark.slow
def test_propellers_that_stall_are_identified_and_the_repaired_vehicle_leaves_nothing(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    found = api.diagnose([flight(3, propeller_stall=[2.0])], vehicle(), lambda text: None)
    (entry,) = found.report["findings"]
    low, high = entry["parameters"]["slope"]["interval95"]
    assert entry["effect"] == "propeller_stall" and low < 2.0 < high
    assert found.vehicle.terms["propeller_stall"]["slope"] == pytest.approx(2.0, rel=0.15)
    assert found.report["improvement"]["left"] == {"verdict": "nothing_left_out", "findings": []}


def test_a_local_draught_is_identified_and_located(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    center = path().p_world[round(4.0 / STEP_S), 0] + [0.3, 0.2, -0.2]
    report = api.diagnose(
        [flight(6, local_draught=np.array([-2.0, 6.0, 0.0, *center, 1.8]))],
        vehicle(),
        progress=lambda text: None,
        validate=False,
    ).report
    (one,) = report["findings"]
    assert one["effect"] == "local_draught"
    size = {name: entry["value"] for name, entry in one["parameters"].items()}
    assert np.linalg.norm([size[f"center[{i}]"] - center[i] for i in range(3)]) < 0.6
    for name, true in (("velocity[0]", -2.0), ("velocity[1]", 6.0), ("radius", 1.8)):
        low, high = one["parameters"][name]["interval95"]
        assert low < true < high and high - low < 12.0, name


@pytest.mark.parametrize(
    "planted", [(0.06, 0.04, -0.03, 0.01), pytest.param((0.1, 0.02, -0.01, -0.04), marks=pytest.mark.slow)]
)
def test_a_payload_is_identified_with_mass_and_position_and_not_as_mass_inertia_and_offset(planted, monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    found = api.diagnose([flight(51, payload=planted)], vehicle(), lambda text: None, seed=3)
    (load,) = found.report["findings"]
    assert (load["effect"], load["verdict"]) == ("payload", "confirmed")
    for name, true in zip(("mass", *(f"position[{i}]" for i in range(3))), planted, strict=True):
        low, high = load["parameters"][name]["interval95"]
        assert abs(load["parameters"][name]["value"] - true) < max(0.1 * abs(true), 2 * (high - low))
    assert found.vehicle.terms["payload"]["mass"] == pytest.approx(planted[0], rel=0.05)
    predicted = found.report["improvement"]["held_out"]["rollout_rmse_m"]["0.5"]
    assert predicted["after"] < 0.03 * predicted["before"]
    assert found.report["improvement"]["left"] == {"verdict": "nothing_left_out", "findings": []}


def test_mass_and_centre_of_mass_without_more_inertia_are_not_taken_for_a_payload(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    heavier = flight(52, mass=[1.06 * vehicle().mass], com_offset=[0.003, -0.002, 0.0])
    found = api.diagnose([heavier], vehicle(), lambda text: None, seed=3, validate=False)
    assert {one["effect"] for one in found.report["findings"]} == {"mass", "com_offset"}


@pytest.mark.slow
def test_a_hover_shows_mass_and_balance_of_a_payload_but_not_its_position(monkeypatch):
    """In a hover, the noise of rotor speeds looks like more inertia, as of a payload far above or below."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    loaded = flight(55, along=hover, payload=[0.06, 0.02, -0.03, 0.0])
    found = api.diagnose([loaded], vehicle(), lambda text: None, seed=3, validate=False).report["findings"]
    assert {one["effect"] for one in found if one["layer"] == "moment"} == {"com_offset"}
    (weight,) = (one for one in found if one["layer"] == "force")
    assert "mass" in {weight["effect"], *(other["effect"] for other in weight["alternatives"])}


@pytest.mark.slow
def test_a_damaged_propeller_in_a_hover_is_identified_and_not_as_a_shifted_centre_of_mass(monkeypatch):
    """Its moment, as of a shifted centre of mass, is larger than its loss of thrust."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    damaged = flight(56, along=hover, **{"damaged_propeller[2]": [0.024]})
    (found,) = api.diagnose([damaged], vehicle(), lambda text: None, seed=3, validate=False).report["findings"]
    assert (found["effect"], found["variant"]) == ("damaged_propeller", "2")
    assert found["parameters"]["loss"]["value"] == pytest.approx(0.024, rel=0.05)


@pytest.mark.slow
def test_half_the_inertia_is_identified_although_to_first_order_it_looks_like_none(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    half = np.diag(vehicle().inertia_matrix) * [1.0, 1.0, 0.5]
    report = api.diagnose([flight(53, inertia=half)], vehicle(), lambda text: None, validate=False).report
    (found,) = report["findings"]
    assert (found["effect"], found["verdict"]) == ("inertia", "confirmed")
    assert found["parameters"]["inertia[2]"]["value"] == pytest.approx(half[2], rel=0.02)


def test_clock_drift_that_is_knocked_out_becomes_an_equation_and_no_constant_delay(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    report = api.diagnose(
        [flight(7, clock_drift=[500.0])], vehicle(), lambda text: None, knocked_out=("clock_drift",), validate=False
    ).report
    (one,) = report["findings"]
    assert one["verdict"] == "unknown" and one["layer"] == "imu"
    for axis in "xyz":
        size = one["parameters"][f"gyro_{axis}: t modelled turn {axis}"]["value"]
        assert size == pytest.approx(-500e-6, rel=0.1), axis


def test_an_imu_lever_arm_is_identified_without_single_rotor_speeds(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    table = flight(4, imu_lever_arm=[0.02, -0.03, 0.01])
    table = replace(table, channels={name: one for name, one in table.channels.items() if name != "rotor_speed"})
    report = api.diagnose([table], vehicle(), lambda text: None, validate=False).report
    (one,) = report["findings"]
    assert one["effect"] == "imu_lever_arm"
    for i, true in enumerate((0.02, -0.03, 0.01)):
        assert one["parameters"][f"position[{i}]"]["value"] == pytest.approx(true, abs=0.005)


def test_a_tilted_map_is_distinguished_from_an_accelerometer_bias(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    report = api.diagnose(
        [flight(8, map_tilt=np.array([0.012, -0.007]))], vehicle(), progress=lambda text: None, validate=False
    ).report
    (one,) = report["findings"]
    assert one["effect"] == "map_tilt" and not one["alternatives"]
    found = [one["parameters"][f"rotation[{i}]"]["value"] for i in range(2)]
    assert found == pytest.approx([0.012, -0.007], abs=0.0015)


@pytest.mark.slow
def test_a_knocked_out_drag_becomes_an_equation_which_the_repaired_vehicle_flies(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    recording = flight(4, linear_drag=[0.3, 0.3, 0.45])
    found = api.diagnose([recording], vehicle(), lambda text: None, knocked_out=("linear_drag",))
    (equation,) = [one for one in found.report["findings"] if one["verdict"] == "unknown"]
    assert equation["layer"] == "force" and found.report["verdict"] == "unknown"
    assert equation["parameters"]["specific_force_x: v_x"]["value"] == pytest.approx(-0.3 / 0.87, rel=0.1)
    assert equation["parameters"]["specific_force_x: v_x"]["unit"] == "1/s"
    assert not [one for one in found.report["findings"] if one["verdict"] == "confirmed"]
    (where,) = [
        one["where"] for one in localization.locate_findings(found, vehicle())["findings"] if one["effect"] is None
    ]
    assert where["time"] and where["regime"] == equation["where"]["regime"]
    flown = found.vehicle.terms["equation"]
    assert flown["force_x"]["v_x"]["coefficient"] == pytest.approx(-0.3, rel=0.1)
    assert equation["in_repair"] and equation["summands"][0]["removed_share"] > 0.5
    unseen = found.report["improvement"]["held_out"]
    assert unseen["one_step_rmse"]["after"] < 0.5 * unseen["one_step_rmse"]["before"]
    assert unseen["rollout_rmse_m"]["0.5"]["after"] < 0.2 * unseen["rollout_rmse_m"]["0.5"]["before"]
