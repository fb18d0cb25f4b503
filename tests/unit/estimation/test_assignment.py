"""Data association: the gate and its side, which only the pose estimate can determine."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_flight import CAMERA, TRACK, gate_poses, visible_gates

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_ros.camera.model import unproject
from swift_ros.estimation.assignment import (
    AMBIGUOUS,
    NO_GATE_MATCHES,
    Assignment,
    PoseEstimate,
    observed_gate_rotation,
    resolve_ambiguity,
    to_scale,
)
from swift_ros.types import GateCorners

SIGMA = 0.8 / CAMERA.fx


def facing(position, target) -> np.ndarray:
    """Return the attitude of a level vehicle at `position` that points towards `target`."""
    ahead = np.asarray(target, float) - position
    return geometry.quaternion_from_yaw(np.arctan2(ahead[1], ahead[0]))


def rays(pixels):
    return geometry.rotate(CAMERA.q_body_camera, unproject(CAMERA, pixels))


def pose_estimate(p_map, q_map_body, sigma_m=0.2, sigma_deg=1.0) -> PoseEstimate:
    return PoseEstimate(
        np.asarray(p_map, float), q_map_body, np.diag([sigma_m**2] * 3 + [np.radians(sigma_deg) ** 2] * 3)
    )


def assign(p_map, q_map_body, where: PoseEstimate, only=None, noise_px=0.5):
    """Return the associated and the true gates of an image taken at a pose, and the matches."""
    rng = np.random.default_rng(3)
    visible = [(i, px) for i, px in visible_gates(np.asarray(p_map, float), q_map_body) if only is None or i in only]
    assert visible, "the test needs a visible gate"
    assignment = Assignment(TRACK.corners, CAMERA.p_body_camera, gate=26.1, margin=9.0)
    observed = np.array([rays(pixels + noise_px * rng.standard_normal((4, 2))) for _, pixels in visible])
    matches = assignment.assign(observed, np.full(len(visible), SIGMA), where)
    return [match.gate for match in matches], [i for i, _ in visible], matches


def test_gates_are_associated_without_errors_from_anywhere_on_the_track():
    rng = np.random.default_rng(1)
    correct = 0
    for _ in range(40):
        gate = rng.integers(len(TRACK.gates))
        centre = TRACK.positions[gate]
        position = centre + np.array([*rng.uniform(-7, 7, 2), rng.uniform(0.0, 2.0)])
        q = facing(position, centre)
        if not visible_gates(position, q):
            continue
        offset = rng.standard_normal(3) * 0.2
        found, truth, _ = assign(position, q, pose_estimate(position + offset, q))
        assert all(f in (t, -1) for f, t in zip(found, truth, strict=True)), "never a wrong gate"
        correct += np.mean(np.array(found) == truth) / 40
    assert correct > 0.5


@pytest.mark.parametrize("side, order", [(-1, "in the order of the map"), (1, "left and right exchanged")])
def test_a_gate_is_associated_from_both_sides(side, order):
    gate = 6
    position = TRACK.positions[gate] + side * 5.0 * TRACK.rotations[gate][:, 0] + [0, 0, 0.3]
    q = facing(position, TRACK.positions[gate])
    found, truth, matches = assign(position, q, pose_estimate(position, q), only=[gate])
    assert found == truth == [gate]
    expected = TRACK.corners[gate] if side < 0 else TRACK.corners[gate][[1, 0, 3, 2]]
    assert np.array_equal(matches[0].corners_map, expected), order
    away = observed_gate_rotation(matches[0].corners_map)[:2, 0]
    assert away @ (TRACK.positions[gate] - position)[:2] > 0, "its x axis points away from the observer"


def test_two_gates_above_each_other_are_associated_with_a_metre_of_drift():
    """Gates 4 and 5 are 2.7 m apart: one drift cannot explain both observations by the other gate."""
    position = np.array([1.5, -6.0, 1.5])
    q = facing(position, TRACK.positions[3])
    drifted = position + [0.3, -0.3, 1.2]
    found, truth, _ = assign(position, q, pose_estimate(drifted, q, sigma_m=1.0), only=[3, 4])
    assert truth == [3, 4]
    assert found == [3, 4]


def test_ambiguous_observations_are_dropped():
    """One gate, seen half way between the two with an uncertainty of 2 m, can be either of them."""
    position = np.array([1.5, -6.0, 1.5])
    q = facing(position, TRACK.positions[3])
    drifted = position - [0.0, 0.0, 1.35]
    found, _, matches = assign(position, q, pose_estimate(drifted, q, sigma_m=2.0), only=[3])
    assert found == [-1]
    assert matches[0].reason == AMBIGUOUS


def test_two_observations_are_never_associated_with_the_same_gate():
    position = np.array([1.5, -6.0, 1.5])
    q = facing(position, TRACK.positions[3])
    pixels = dict(visible_gates(position, q))[3]
    twice = np.array([rays(pixels), rays(pixels + 0.3)])
    assignment = Assignment(TRACK.corners, CAMERA.p_body_camera, gate=26.1, margin=9.0)
    matches = assignment.assign(twice, np.full(2, SIGMA), pose_estimate(position, q))
    assert [match.gate for match in matches].count(3) <= 1


def test_an_object_that_is_not_a_gate_of_the_map_has_no_match():
    position = np.array([1.5, -6.0, 1.5])
    q = facing(position, TRACK.positions[3])
    square = rays(np.array([[150.0, 100.0], [180.0, 100.0], [180.0, 130.0], [150.0, 130.0]]))
    assignment = Assignment(TRACK.corners, CAMERA.p_body_camera, gate=26.1, margin=9.0)
    match = assignment.assign(square[None], np.array([SIGMA]), pose_estimate(position, q))[0]
    assert match.gate == -1 and match.reason == NO_GATE_MATCHES
    assert match.mahalanobis > 5


def test_an_image_without_gates_has_no_matches():
    assignment = Assignment(TRACK.corners, CAMERA.p_body_camera, gate=26.1, margin=9.0)
    assert (
        assignment.assign(np.empty((0, 4, 3)), np.empty(0), pose_estimate(np.zeros(3), np.array([0, 0, 0, 1.0]))) == []
    )


def test_the_ambiguity_of_ippe_is_resolved_by_the_map():
    """With noise the mirrored pose often has the smaller error; the vehicle's attitude selects the right one."""
    gate, rng, wrong, resolved_wrong = 5, np.random.default_rng(8), 0, 0
    position = TRACK.positions[gate] - 10.0 * TRACK.rotations[gate] @ np.array([0.94, 0.34, 0.0]) + [0, 0, 0.8]
    q = facing(position, TRACK.positions[gate])
    pixels = dict(visible_gates(position, q))[gate]
    assignment = Assignment(TRACK.corners, CAMERA.p_body_camera, gate=26.1, margin=9.0)
    q_body_gate = geometry.quaternion_multiply(
        geometry.quaternion_conjugate(q), geometry.quaternion_from_yaw(TRACK.yaws[gate])
    )
    for stamp in range(40):
        poses, _ = gate_poses().locate(stamp, [GateCorners(pixels + rng.standard_normal((4, 2)), np.ones(4))])
        if not poses:
            continue
        match = assignment.assign(poses[0].rays_body[None], np.array([1.2 * SIGMA]), pose_estimate(position, q))[0]
        observation = resolve_ambiguity(poses[0], match, q)
        errors = [2 * np.arccos(min(1.0, abs(s.q_body_gate @ q_body_gate))) for s in (poses[0], observation)]
        wrong += errors[0] > np.radians(35)
        resolved_wrong += errors[1] > np.radians(35)
    assert wrong >= 4
    assert resolved_wrong <= wrong // 2


def test_a_gate_of_another_size_is_further_from_the_camera_in_proportion():
    """The pose of a gate of 2.25 m, found as one of 1.5 m, is scaled to its true place by the ratio of the sides."""
    gate, ratio = 2, 1.5
    larger = replace(TRACK, gates=tuple(replace(g, inner_side=2.25, outer_side=2.85) for g in TRACK.gates))
    position = TRACK.positions[gate] - 8.0 * TRACK.rotations[gate] @ np.array([0.9, 0.2, 0.0]) + [0, 0, 0.5]
    q = facing(position, TRACK.positions[gate])
    corners = lens.world_to_camera(CAMERA, position, q, larger.corners[gate])
    pixels, _ = lens.project(CAMERA, corners)
    found = gate_poses().locate(0, [GateCorners(pixels, np.ones(4))])[0][0]
    truth = geometry.rotate_inverse(q, TRACK.positions[gate] - position)
    assert np.linalg.norm(found.p_body - truth) > 1.0
    scaled = to_scale(found, ratio, CAMERA.p_body_camera)
    np.testing.assert_allclose(scaled.p_body, truth, atol=0.01)
    np.testing.assert_allclose(scaled.covariance, ratio**2 * found.covariance)
