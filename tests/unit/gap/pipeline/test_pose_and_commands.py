"""Recordings of a pose and motor commands alone: they show masses, propellers and packs, and no sensor."""

from dataclasses import replace

import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, STEP_S, flight, vehicle

from swift_ros.recording.flight_table import FlightTable, RowSampling
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.recording.recording import at_times_of_recording, read_recording

CHANNELS = ("p_world", "q_world_body", "motor_command")


@pytest.fixture(autouse=True)
def few_reference_flights(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)


def poor(table: FlightTable, *more: str) -> FlightTable:
    """Return a flight with pose and motor commands alone, and `more` channels."""
    kept = {name: samples for name, samples in table.channels.items() if name in (*CHANNELS, *more)}
    every_command = {"motor_command": RowSampling("held", loop_hz=1.0 / STEP_S)}
    return replace(table, channels=kept, sampling=every_command)


def diagnosed(*more: str, seed: int, **planted) -> dict:
    return api.diagnose([poor(flight(seed, **planted), *more)], vehicle(), lambda text: None, validate=False).report


def named(report: dict) -> list[set[str]]:
    """Return the names that each finding leaves possible."""
    return [{one["effect"], *(other["effect"] for other in one["alternatives"])} for one in report["findings"]]


def test_the_vehicle_of_the_file_gives_no_finding_and_its_physics_is_testable():
    report = diagnosed(seed=2)
    assert report["verdict"] == "nothing_left_out", report["findings"]
    shown = report["minimum_detectable"]
    assert {"mass", "thrust_coefficient", "com_offset", "damaged_propeller", "battery_sag", "rotor_drag"} <= set(shown)
    assert shown["mass"]["mass"] < 0.05 * vehicle().mass
    assert "gyro_bias" in report["not_testable"] and "marker_offset" in report["not_testable"]


def test_a_cut_propeller_is_named_or_in_a_set():
    report = diagnosed(seed=3, **{"damaged_propeller[2]": [0.15]})
    assert report["findings"] and all("damaged_propeller" in names for names in named(report)), report["findings"]


@pytest.mark.slow
def test_a_hung_weight_is_named_by_its_mass_or_in_sets_with_it():
    report = diagnosed(seed=4, payload=[0.1, 0.0, 0.0, -0.08])
    allowed = {"payload", "mass", "com_offset", "inertia"}
    assert report["findings"] and all(names & allowed for names in named(report)), report["findings"]


def test_the_weight_of_a_hover_shows():
    heavy = {"mass": [1.1 * vehicle().mass]}
    report = diagnosed(seed=5, **heavy)
    (one,) = (one for one in report["findings"] if one["effect"] == "mass")
    mass, (low, high) = one["parameters"]["mass"]["value"], one["parameters"]["mass"]["interval95"]
    assert low < heavy["mass"][0] < high
    assert mass - low > 2.0 * (high - mass)  # if the pack was used before the first row, the vehicle is lighter


def test_rates_of_the_attitude_take_the_place_of_a_gyro_and_are_no_channel_of_their_own():
    recording, whole = (read_recording(one, vehicle()) for one in (poor(flight(2)), flight(2)))
    assert not recording.gyro_measured and whole.gyro_measured
    assert not recording.has("gyro_body") and recording.has_motion
    inside = slice(10, -10)
    assert abs((recording.gyro_body - whole.gyro_body)[inside].mean(axis=0)).max() < 0.02


def test_rotor_speeds_that_the_commands_cause_are_low_passed_as_measured_ones():
    """Without the filter what a rate loop does between two times of the recording would look like thrust."""
    table = flight(2)
    speeds = table["rotor_speed"]
    shaken = replace(speeds, values=speeds.values + 30.0 * (-1.0) ** np.arange(len(speeds.t))[:, None])
    recording = read_recording(replace(table, channels={**table.channels, "rotor_speed": shaken}), vehicle())
    inside = slice(2, -2)
    caused = at_times_of_recording(shaken, recording.t)[inside]
    assert np.abs(caused - recording.rotor_speed[inside]).max() < 1e-6
    assert np.abs(caused - at_times_of_recording(speeds, recording.t)[inside]).max() < 3.0
