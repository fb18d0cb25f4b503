"""Pose of one gate: corners of a known pose, projected by the fisheye, give the pose back."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from synthetic_flight import CAMERA, TRACK, gate_poses, settings

from swift_ros import geometry
from swift_ros.camera.model import project
from swift_ros.perception.gate_pose import GatePoses, GatePoseSettings, solve_square
from swift_ros.track import CORNER_SIGNS
from swift_ros.types import GateCorners

SQUARE_GATE = 0.5 * TRACK.inner_side * CORNER_SIGNS
SIGMA_PX = np.radians(settings("gate_pose", GatePoseSettings).corner_sigma_deg) * CAMERA.fx


def corners_px(p_body, q_body_gate, camera=CAMERA):
    """Return the corners (px) of a gate at a pose in base_link."""
    corners_body = geometry.rotate(q_body_gate, SQUARE_GATE) + p_body
    corners_camera = geometry.rotate_inverse(camera.q_body_camera, corners_body - camera.p_body_camera)
    return project(camera, corners_camera)[0]


def detected(pixels) -> GateCorners:
    return GateCorners(pixels, np.full(4, 0.9))


def turned(yaw_deg, pitch_deg=0.0, roll_deg=0.0):
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    q = geometry.quaternion_from_yaw(yaw)
    for axis, angle in ((1, pitch), (0, roll)):
        q = geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(angle * np.eye(3)[axis]))
    return q


# Ahead, at the edge of the lens, above, near, far, oblique; the last one rolled, as for a banking vehicle.
POSES = [
    ((6.0, 0.0, 1.0), turned(25)),
    ((1.8, 4.5, 2.0), turned(70)),
    ((3.0, -2.0, 4.0), turned(-40, -30)),
    ((1.3, 0.1, 0.5), turned(8)),
    ((12.0, 2.0, 1.0), turned(-45, 5)),
    ((5.0, -3.0, 2.0), turned(30, 10, 70)),
]


@pytest.mark.parametrize("p_body, q_body_gate", POSES)
def test_a_known_pose_is_recovered(p_body, q_body_gate):
    poses, warnings = gate_poses().locate(7, [detected(corners_px(np.array(p_body), q_body_gate))])
    assert not warnings
    pose = poses[0]
    assert np.linalg.norm(pose.p_body - p_body) < 1e-3
    assert abs(pose.q_body_gate @ q_body_gate) > 1 - 1e-6
    assert pose.reprojection_error < 1e-4
    assert pose.reprojection_error <= pose.alternative_reprojection_error
    directions = geometry.normalize(geometry.rotate(q_body_gate, SQUARE_GATE) + np.array(p_body) - CAMERA.p_body_camera)
    assert np.allclose(pose.rays_body, directions, atol=1e-7)
    assert pose.confidence == pytest.approx(0.9)


def symmetric_or_any(low: float, high: float):
    """Return a strategy for numbers from low to high; many are 0 or of the kind that makes a view symmetric."""
    exact = [value for value in (0.0, -45.0, 45.0, -90.0, 90.0, 180.0) if low <= value <= high]
    return st.one_of(st.sampled_from(exact), st.floats(low, high))


@hypothesis_settings(max_examples=300, deadline=None, derandomize=True, database=None)
@given(
    distance=st.floats(0.2, 16.0),
    azimuth=symmetric_or_any(-75.0, 75.0),
    elevation=symmetric_or_any(-75.0, 75.0),
    yaw=symmetric_or_any(-70.0, 70.0),
    pitch=symmetric_or_any(-70.0, 70.0),
    roll=symmetric_or_any(-180.0, 180.0),
)
def test_one_solution_of_ippe_has_the_corners_where_they_are(distance, azimuth, elevation, yaw, pitch, roll):
    """From any side and at any roll, also exactly from the front and in planes of symmetry, without noise."""
    line_of_sight = turned(azimuth, -elevation)
    ahead = geometry.rotation_matrix(geometry.quaternion_multiply(line_of_sight, turned(yaw, pitch, roll)))
    corners = SQUARE_GATE @ ahead.T + geometry.rotate(line_of_sight, np.array([distance, 0.0, 0.0]))
    rays = geometry.normalize(np.stack([-corners[:, 1], -corners[:, 2], corners[:, 0]], axis=-1))
    solvable, positions, rotations = solve_square(TRACK.inner_side, rays)
    assert solvable
    seen = geometry.normalize((SQUARE_GATE - positions[:, None]) @ rotations)
    assert np.abs(seen - rays).max(axis=(1, 2)).min() < 1e-6
    assert np.allclose(np.linalg.det(rotations), 1.0)


def test_the_second_solution_is_the_gate_rotated_the_other_way():
    """A distant square seen 30 degrees from the right looks nearly like one seen 30 degrees from the left."""
    poses, _ = gate_poses().locate(7, [detected(corners_px(np.array([10.0, 0.0, 3.0]), turned(30)))])
    assert np.linalg.norm(poses[0].alternative_p_body - poses[0].p_body) < 0.3
    ahead = geometry.rotate(poses[0].alternative_q_body_gate, np.array([1.0, 0.0, 0.0]))
    assert np.degrees(np.arctan2(ahead[1], ahead[0])) == pytest.approx(-30, abs=8)


def noisy_errors(p_body, q_body_gate, count=60):
    rng = np.random.default_rng(5)
    truth, core = corners_px(np.array(p_body), q_body_gate), gate_poses()
    errors, refused = [], 0
    for stamp in range(count):
        poses, warnings = core.locate(stamp, [detected(truth + SIGMA_PX * rng.standard_normal((4, 2)))])
        refused += len(warnings)
        errors += [(pose.p_body - p_body, pose.covariance) for pose in poses]
    return errors, refused / count


@pytest.mark.parametrize("p_body, q_body_gate", [POSES[0], POSES[3], POSES[4]])
def test_the_covariance_of_twenty_perturbed_sets_is_consistent(p_body, q_body_gate):
    """The mean NEES with a covariance of 20 samples is 3.8, not 3. It is smaller for near gates: the assumed noise
    grows with the size of the gate, the simulated noise does not. Correct corners are not refused."""
    errors, refused = noisy_errors(p_body, q_body_gate)
    nees = [error @ np.linalg.solve(covariance, error) for error, covariance in errors]
    assert 1.0 < np.mean(nees) < 6.0
    assert refused <= 0.02


def test_near_gates_have_the_smallest_error():
    """The error of IPPE alone is 5 cm at 2 m; the fit to the corners reduces it."""
    errors, _ = noisy_errors((1.8, 0.2, 0.6), turned(8))
    assert np.sqrt(np.mean([error @ error for error, _ in errors])) < 0.02


def test_the_covariance_is_reproducible_for_a_stamp():
    gate = [detected(corners_px(np.array([6.0, 0.0, 1.0]), turned(20)))]
    first, again, other = (gate_poses().locate(stamp, gate)[0][0].covariance for stamp in (7, 7, 8))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("p_body, q_body_gate", [POSES[0], POSES[3], POSES[5]])
def test_a_gate_with_one_wrong_corner_is_refused(p_body, q_body_gate):
    pixels = corners_px(np.array(p_body), q_body_gate)
    pixels[1] += [12.0, -9.0]
    poses, warnings = gate_poses().locate(1, [detected(pixels)])
    assert not poses
    assert "not a square" in warnings[0] and "chi-square" in warnings[0]


@pytest.mark.parametrize(
    "pixels, sentence",
    [
        (np.full((4, 2), np.nan), "not a number"),
        (np.array([[100.0, 100.0], [120.0, 100.0], [140.0, 100.0], [160.0, 100.0]]), "refused"),
        (np.full((4, 2), 150.0), "refused"),
        (np.array([[5.0, 190.0], [378.0, 150.0], [378.0, 190.0], [378.0, 230.0]]), "refused"),
    ],
    ids=["not a number", "on a line", "one point", "all around"],
)
def test_corners_that_are_not_a_gate_are_refused_with_a_sentence(pixels, sentence):
    good = detected(corners_px(np.array([6.0, 0.0, 1.0]), turned(20)))
    poses, warnings = gate_poses().locate(1, [detected(pixels), good])
    assert len(poses) == 1 and len(warnings) == 1
    assert sentence in warnings[0]


def test_an_image_without_gates_gives_an_empty_result():
    assert gate_poses().locate(1, []) == ([], [])


def test_the_pose_does_not_depend_on_the_mount_of_the_camera():
    """The pose in base_link is the same for another pitch and position of the camera."""
    camera = replace(CAMERA, pitch_deg=40.0, position=(0.1, 0.02, -0.03))
    core = GatePoses(settings("gate_pose", GatePoseSettings), camera, TRACK.inner_side)
    p_body, q_body_gate = np.array([5.0, 1.0, 2.0]), turned(20)
    poses, _ = core.locate(1, [detected(corners_px(p_body, q_body_gate, camera))])
    assert np.linalg.norm(poses[0].p_body - p_body) < 1e-3


def test_the_rays_to_the_seen_corners_of_an_incomplete_gate_are_those_of_the_whole_one():
    whole = detected(corners_px(np.array([6.0, 0.0, 1.0]), turned(20)))
    seen, unseen = [0, 3], [1, 2]
    corners, confidence = whole.corners_px.copy(), np.array([0.7, 0.0, 0.0, 0.6])
    corners[unseen] = np.nan
    [gate], warnings = gate_poses().rays([GateCorners(corners, confidence)])
    [pose], _ = gate_poses().locate(1, [whole])
    assert not warnings and gate.confidence == 0.6
    assert np.allclose(gate.rays_body[seen], pose.rays_body[seen]) and np.isnan(gate.rays_body[unseen]).all()


@pytest.mark.parametrize("count", [0, 1, 4])
def test_an_incomplete_gate_with_another_number_of_corners_is_refused_with_a_sentence(count):
    corners = np.where(np.arange(4)[:, None] < count, 100.0, np.nan) * np.ones((4, 2))
    gates, [warning] = gate_poses().rays([GateCorners(corners, np.full(4, 0.5))])
    assert gates == [] and f"has {count} corners instead of 2 or 3" in warning
