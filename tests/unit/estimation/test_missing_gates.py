"""A vehicle at rest sees fewer gates than the map has in view: when it is said, and when nothing is said."""

import re
from dataclasses import replace

import numpy as np
import pytest
from synthetic_flight import CAMERA, TRACK, gate_poses, settings, visible_gates

from swift_ros import geometry
from swift_ros.camera.projected_gates import whole_gates
from swift_ros.estimation.estimator import StateEstimator
from swift_ros.estimation.missing_gates import are_missing
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.track import Gate
from swift_ros.types import GateCorners, Odometry

FOUND_SHARE = 0.97


def warnings(found, track=TRACK, images: int = 60, camera=CAMERA) -> list[str]:
    """Return what the estimator says to a vehicle at rest on the podium of the shipped track.

    Args:
        found: called with the number of an image and of a gate in view; returns whether the gate is detected.
        track: that the estimator assumes.
        images: their number, 30 per second.
        camera: that the estimator assumes; the images are those of the shipped one.
    """
    core = StateEstimator(settings("state_estimator", EstimatorSettings), track, camera, lockstep=True)
    poses, rng, said = gate_poses(camera), np.random.default_rng(1), []
    place, attitude = TRACK.start_pose
    for i in range(images):
        stamp_ns = i * 33_000_000
        pixels = [corners + 0.3 * rng.standard_normal((4, 2)) for _, corners in visible_gates(place, attitude)]
        gates = [GateCorners(corners, np.ones(4)) for k, corners in enumerate(pixels) if found(i, k)]
        said += core.odometry(Odometry(stamp_ns, place, attitude, np.zeros(3), np.zeros(3))).warnings
        said += core.gates(stamp_ns, poses.locate(stamp_ns, gates)[0]).warnings
    return said


def test_a_covered_lens_is_reported_with_the_number_of_gates_in_view():
    said = warnings(lambda image, gate: False)
    assert len(said) == 1
    numbers = re.match(
        r"at rest the camera should see 2 gates of the map, and in (\d+) images 0 of them and 0", said[0]
    )
    assert numbers and 30 <= int(numbers[1]) <= 50, said
    assert all(word in said[0] for word in ("lens cover", "exposure", "mount", "track.yaml", "heading"))


def test_nothing_is_said_within_the_first_second():
    assert warnings(lambda image, gate: False, images=30) == []


@pytest.mark.parametrize(
    "found",
    [
        lambda image, gate: True,
        lambda image, gate: gate == 0,
        lambda image, gate: (image + gate) % 2,
        lambda image, gate: image >= 20,
    ],
    ids=["both gates", "one of two", "each in every second image", "not in the first 20 images"],
)
def test_nothing_is_said_where_gates_are_found(found):
    assert warnings(found) == []


def test_gates_that_a_vehicle_with_another_heading_sees_are_counted_as_elsewhere():
    said = warnings(lambda image, gate: True, replace(TRACK, start_yaw_deg=TRACK.start_yaw_deg + 90.0))
    assert len(said) == 1 and re.search("0 of them and 2 elsewhere", said[0]), said


def test_nothing_is_said_where_the_map_has_no_gate_in_view():
    assert warnings(lambda image, gate: False, replace(TRACK, start_yaw_deg=TRACK.start_yaw_deg - 90.0)) == []


@pytest.mark.parametrize(
    ("found", "expected", "missing"),
    [
        (0, 1, False),
        (0, 2, True),
        (1, 2, False),
        (1, 3, True),
        (2, 3, False),
        (5, 7, False),
        (3, 7, True),
        (8, 7, False),
        (0, 0, False),
    ],
)
def test_gates_are_missing_where_chance_does_not_explain_their_number(found, expected, missing):
    assert are_missing(found, np.full(expected, FOUND_SHARE)) == missing


def test_gates_that_are_seldom_found_are_not_missed():
    assert not are_missing(0, np.array([0.6, 0.3]))


@pytest.mark.parametrize("count", range(1, 8))
def test_few_right_calibrations_are_suspected(count):
    """The number of gates is drawn as the detector finds them."""
    drawn = (np.random.default_rng(count).random((4000, count)) < FOUND_SHARE).sum(axis=1)
    assert np.mean([are_missing(int(found), np.full(count, FOUND_SHARE)) for found in drawn]) < 0.04


def row_of_gates(*distances: float):
    """Return a track of gates behind one another along x, the second and later ones smaller."""
    gates = tuple(Gate((x, 0.0, 1.5), 0.0, inner_side=1.0 if i else None) for i, x in enumerate(distances))
    return replace(TRACK, gates=gates)


@pytest.mark.parametrize(("aside", "seen"), [(0.0, {0, 1}), (1.5, {0})])
def test_a_gate_behind_the_frame_of_another_is_not_seen(aside, seen):
    """From straight ahead the opening of the first gate shows the second one; from the side its frame hides corners."""
    level = geometry.quaternion_from_yaw(np.float64(0.0))
    assert set(whole_gates(CAMERA, row_of_gates(4.0, 8.0), np.array([0.0, aside, 1.5]), level)) == seen


def test_the_shortest_side_of_a_gate_is_an_angle():
    level = geometry.quaternion_from_yaw(np.float64(0.0))
    place = np.array([0.0, 0.0, 1.5]) - CAMERA.p_body_camera
    sides = whole_gates(CAMERA, row_of_gates(7.5), place, level)
    assert np.tan(0.5 * sides[0]) == pytest.approx(0.75 / np.hypot(7.5, 0.75))
