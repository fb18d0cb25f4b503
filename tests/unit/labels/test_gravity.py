"""The lean of a camera is found from the gates in its image, for they stand upright."""

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.camera.model import project
from swift_sim_bridge.labels import folder
from swift_sim_bridge.labels.gravity import r_world_camera_of_gates
from swift_sim_bridge.labels.labelled_images import R_WORLD_LEVEL_CAMERA, VISIBLE, LabelledGate

CAMERA = folder.pinhole(640, 480, 90.0)
SIDE = 1.5  # m


def attitude(roll_deg: float, pitch_deg: float) -> np.ndarray:
    """Return the attitude of a level camera after a turn about its own x axis and then its optical axis."""
    turns = [np.radians([pitch_deg, 0.0, 0.0]), np.radians([0.0, 0.0, roll_deg])]
    pitched, rolled = (geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(turn)) for turn in turns)
    return R_WORLD_LEVEL_CAMERA @ pitched @ rolled


def gate(r_world_camera, place, heading_deg: float, rng) -> LabelledGate:
    """Return the label of an upright gate at a place (3,) in the world, with an error of half a pixel."""
    y = np.array([-np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg)), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    corners = np.array([place + 0.5 * SIDE * (a * y + b * up) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))])
    pixels, seen = project(CAMERA, corners @ r_world_camera)
    assert seen.all()
    return LabelledGate(pixels + rng.normal(0.0, 0.5, (4, 2)), np.full(4, VISIBLE))


def lean_error_deg(found, true) -> float:
    return float(np.degrees(np.arccos(np.clip(found[2] @ true[2], -1.0, 1.0))))


@pytest.mark.parametrize("roll_deg", [-40.0, -12.0, 0.0, 25.0])
@pytest.mark.parametrize("pitch_deg", [-15.0, 0.0, 12.0])
def test_two_gates_seen_at_an_angle_show_roll_and_pitch(roll_deg, pitch_deg):
    rng = np.random.default_rng(3)
    true = attitude(roll_deg, pitch_deg)
    ahead = np.array([np.cos(np.radians(pitch_deg)), 0.0, np.sin(np.radians(pitch_deg))])
    places = [3.5 * ahead + np.array([0.0, 0.9, 0.0]), 5.0 * ahead + np.array([0.0, -1.0, 0.0])]
    gates = tuple(gate(true, place, heading, rng) for place, heading in zip(places, (30.0, -35.0), strict=True))
    found = r_world_camera_of_gates(gates, CAMERA)
    assert lean_error_deg(found, true) < 3.0


def test_of_a_gate_from_the_front_the_roll_is_found_and_the_pitch_stays_level():
    rng = np.random.default_rng(4)
    true = attitude(20.0, 0.0)
    found = r_world_camera_of_gates((gate(true, np.array([6.0, 0.0, 0.0]), 0.0, rng),), CAMERA)
    assert lean_error_deg(found, true) < 5.0


def test_without_a_whole_gate_nothing_is_found():
    half = LabelledGate(np.array([[1.0, 1.0], [9.0, 1.0], [np.nan, np.nan], [1.0, 9.0]]), np.array([2, 2, 0, 2]))
    assert r_world_camera_of_gates((half,), CAMERA) is None
