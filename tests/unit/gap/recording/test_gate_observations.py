"""The gap tool's camera layer: errors of camera and map are identified from the corners of gates in images."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, SHEET, path, vehicle

from swift_ros.camera.model import Camera
from swift_ros.configuration import build, configuration_folder, load
from swift_ros.recording.flight_table import DetectedGates, FlightTable
from swift_ros.track import Gate, Track
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.nominal import reference_flights
from swift_sim_bridge.gap.pipeline import hypotheses, multi_flight, references
from swift_sim_bridge.gap.recording import gate_observations
from swift_sim_bridge.gap.recording.flight_phase import on_ground
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.report import repaired_files
from swift_sim_bridge.gap.residuals.channels import residual_groups
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.recording import record, record_gates

FOLDER = configuration_folder()
CAMERA = load(Camera, FOLDER / "camera.yaml")
NOISE_PX = 0.3
PLACES = ((11.0, 0.0, 0.0, 0.0), (13.0, 6.0, 1.0, -30.0), (12.0, -7.0, -1.0, 25.0), (17.0, 2.0, 3.0, 10.0))
TRACK = replace(load(Track, FOLDER / "track.yaml"), gates=tuple(Gate((x, y, z), yaw) for x, y, z, yaw in PLACES))


@cache
def trace():
    """Return the flight of the vehicle as its file describes it; the camera does not affect it."""
    with jax.enable_x64(True):
        return reference_flights.fly(vehicle(), path(), SHEET["gyro_rad_s"], 5)[0]


def flight(seed: int, **planted) -> FlightTable:
    """Record the flight, its camera and its map with effects at these parameters, and gates in its images."""
    truth, effects = vehicle(), {effect.key: effect for effect in catalogue(vehicle(), len(TRACK.gates))}
    for key, values in planted.items():
        truth = inject(truth, effects[key], values)
    truth = replace(truth, terms={**truth.terms, "corner_noise": {"px": NOISE_PX}})
    rng, motion = np.random.default_rng(seed), Moving(*(getattr(trace(), name) for name in Moving._fields))
    table = record(path().t, trace(), truth, rng)
    return replace(table, detected_gates=record_gates(path().t, motion, CAMERA, TRACK, truth, rng))


@pytest.fixture(autouse=True)
def few_reference_flights(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)


def read(table: FlightTable):
    return read_recording(table, vehicle()).gate_observations


def test_a_reference_flight_without_gates_in_view_has_zero_camera_residuals():
    seen = flight(1).detected_gates
    blind = replace(flight(1), detected_gates=replace(seen, t=seen.t[:0], corners=seen.corners[:0]))
    reference = ResidualModel(read_recording(blind, vehicle(), simulated=True))
    assert np.all(reference.residual(vehicle())[:, reference.columns["camera"]] == 0.0)


def test_gates_are_associated_with_the_map_and_false_detections_are_left_out():
    seen = flight(1).detected_gates
    rng = np.random.default_rng(0)
    stray = rng.choice(len(seen.t), 60, replace=False)
    corners = seen.corners.copy()
    corners[stray[:30]] += rng.uniform(40.0, 80.0, (30, 1, 2))  # false gates
    corners[stray[30:], 2] += 12.0  # one corner of a good one
    clean, dirty = (
        read(replace(flight(1), detected_gates=replace(seen, corners=each))) for each in (seen.corners, corners)
    )
    assert len(clean.t) > 0.95 * len(seen.t)
    elsewhere = replace(TRACK, gates=tuple(replace(gate, position=(200.0, 0.0, 0.0)) for gate in TRACK.gates))
    none = read_recording(replace(flight(1), detected_gates=replace(seen, track=elsewhere)), vehicle())
    (rejection,) = none.rejections
    assert none.gate_observations is None and "camera" not in residual_groups(none)
    assert rejection.channel == "gates in images" and f"{len(seen.t)} of {len(seen.t)}" in rejection.reason
    assert set(np.unique(clean.gate)) == set(range(len(TRACK.gates)))
    moving = Moving(*(getattr(trace(), name) for name in Moving._fields))
    assert np.abs(dirty.residual(path().t, moving, {})).max() < 4.0
    assert len(dirty.t) > len(clean.t) - 75


@pytest.mark.parametrize(
    "key, values, close",
    [
        ("camera_extrinsic", [0.012, -0.008, 0.006, 0.0, 0.015, -0.01], 0.1),
        pytest.param("camera_focal", [0.01, 1.5, -1.0], 0.05, marks=pytest.mark.slow),
        pytest.param("rolling_shutter", [0.012], 0.05, marks=pytest.mark.slow),
        pytest.param("processing_latency", [0.008], 0.05, marks=pytest.mark.slow),
        pytest.param("gate_displaced[3]", [0.15, -0.1, 0.05, 0.06], 0.1, marks=pytest.mark.slow),
    ],
)
def test_a_planted_error_alone_is_identified_with_its_size(key, values, close):
    found = api.diagnose([flight(2, **{key: values})], vehicle(), lambda text: None, validate=False)
    (taken,) = found.selected
    assert taken.effect.key == key and found.report["verdict"] == "confirmed"
    (finding,) = found.report["findings"]
    estimates = [finding["parameters"][parameter.name] for parameter in taken.effect.parameters]
    errors = np.abs([one["value"] for one in estimates] - np.array(values))
    half = np.array([one["interval95"][1] - one["value"] for one in estimates])
    assert np.all(errors < 2.0 * half) and np.linalg.norm(errors) < close * np.linalg.norm(values)
    repaired = repaired_files.track_text(found)
    if key == "gate_displaced[3]":
        repaired_track = build(Track, repaired_files.yaml.safe_load(repaired), "the repaired track")
        assert np.array(repaired_track.positions[2]) == pytest.approx(np.array(PLACES[2][:3]) + values[:3], abs=0.03)
        assert finding["parameters"]["gate"]["value"] == 3
    else:
        assert repaired is None


def test_a_nominal_flight_gives_no_finding_and_the_minimum_detectable_magnitudes():
    report = api.diagnose([flight(3)], vehicle(), lambda text: None, validate=False).report
    assert report["verdict"] == "nothing_left_out"
    assert report["minimum_detectable"]["camera_extrinsic"]["rotation[2]"] < 0.01
    assert report["minimum_detectable"]["gate_displaced"]["position[0]"] < 0.3


def test_a_recording_without_images_gives_the_reason_why_the_camera_is_not_testable():
    recording = read_recording(replace(flight(3), detected_gates=None), vehicle())
    effects, not_testable = hypotheses.testable(vehicle(), [recording])
    assert not [effect for effect in effects if effect.layer == "camera"]
    assert all(
        "no gates in images" in not_testable[name] for name in ("camera_extrinsic", "gate_displaced", "map_scale")
    )


def test_recordings_with_other_maps_are_compared_without_their_gates():
    one, messages = flight(3), []
    other = replace(one, detected_gates=replace(one.detected_gates, track=replace(TRACK, gates=TRACK.gates[:2])))
    assert multi_flight.comparable([one, one], messages.append) == [one, one] and not messages
    assert [each.detected_gates for each in multi_flight.comparable([one, other], messages.append)] == [None, None]
    assert messages == ["left out, as not all recordings can show it: gates in images"]


def test_gates_redetected_in_another_flight_have_the_given_corner_errors():
    found = read(flight(4))
    errors = np.tile(np.arange(8.0).reshape(1, 4, 2), (len(found.t), 1, 1))
    moving = Moving(*(getattr(trace(), name) for name in Moving._fields))
    again = gate_observations.redetected(found, errors, path().t, moving, {})
    assert isinstance(again, DetectedGates) and len(again.t) == len(found.t)
    assert gate_observations.associate_gates(again, path().t, moving, {}).residual(
        path().t, moving, {}
    ) == pytest.approx(errors, abs=1e-9)


def test_a_vehicle_on_its_podium_before_and_after_the_flight_does_not_fly():
    p, lift = np.zeros((500, 3)), np.full(500, 9.8)
    p[150:350, 2] = 5.0 * np.sin(np.pi * np.arange(200) / 200)
    lift[:140] = lift[360:] = 2.0
    resting = on_ground(p, lift, 0.01)
    assert resting[:150].all() and resting[360:].all() and not resting[160:345].any()
    hover = np.full(500, 9.7)
    assert not on_ground(np.zeros((500, 3)), hover, 0.01).any()
    assert not on_ground(np.outer(np.arange(500) * 0.1, np.ones(3)), np.full(500, 2.0), 0.01).any()


def test_a_landing_between_two_hops_does_not_fly_although_its_estimated_position_drifts():
    t = np.arange(0.0, 12.0, 0.01)
    p, lift = np.zeros((len(t), 3)), np.full(len(t), 9.8)
    for begin in (1.0, 7.0):  # hops of 4 s, and 2 s of idling rotors between them
        hop = (t > begin) & (t < begin + 4.0)
        p[hop, 2] = 3.0 * np.sin(np.pi * (t[hop] - begin) / 4.0)
    landed = (t > 5.0) & (t < 7.0)
    lift[(t < 0.9) | landed | (t > 11.1)] = 2.0
    p += 0.05 * t[:, None]
    p[t > 11.9, 0] += 3.0  # the estimate jumps when the rotors have stopped
    resting = on_ground(p, lift, 0.01)
    assert resting[landed].all() and resting[t < 1.0].all() and resting[t > 11.0].all()
    assert not resting[((t > 1.3) & (t < 4.7)) | ((t > 7.3) & (t < 10.7))].any()
    hover = np.where((t > 3.0) & (t < 9.0), 9.7, 30.0)  # a hover between two races is none
    assert not on_ground(0.0 * p, hover, 0.01).any()
    falling = np.zeros_like(p)
    falling[:, 2] = -4.9 * (t - 6.0) ** 2  # nor is the top of a throw, without thrust
    assert not on_ground(falling, np.where(abs(t - 6.0) < 1.0, 0.5, 9.8), 0.01).any()
