"""Gates of which two or three corners are seen correct the state, and are refused where they may belong elsewhere."""

import numpy as np
import pytest
from synthetic_flight import CAMERA, TRACK, Detector, Drift, gate_poses, images, odometry, race, settings

from swift_ros import geometry
from swift_ros.camera.model import project, world_to_camera
from swift_ros.estimation.assignment import TAKEN
from swift_ros.estimation.estimator import NEEDS_WHOLE_GATES, WHOLE_GATES_REFUSED, StateEstimator
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import GateCorners, IncompleteGate, Odometry

TOP, LEFT, RIGHT = [0, 1], [0, 3], [1, 2]  # corners of an edge
THREE = [0, 1, 2]
BEFORE_GATE_3 = TRACK.positions[2] - 4.0 * TRACK.rotations[2][:, 0] + [0.3, 0.2, 0.1]
TOWARDS_GATE_3 = geometry.quaternion_from_yaw(TRACK.yaws[2])
OFFSET = np.array([0.15, -0.1, 0.12])  # m, of the odometry


def seen(gate: int, corners, p_map=BEFORE_GATE_3, q_map_body=TOWARDS_GATE_3, noise_deg=0.0, rng=None) -> IncompleteGate:
    """Return the given corners of a gate of the map as a camera at a pose of the vehicle sees them."""
    rays = geometry.normalize(world_to_camera(CAMERA, p_map, q_map_body, TRACK.corners[gate][corners]))
    rays_body = np.full((4, 3), np.nan)
    rays_body[corners] = geometry.rotate(CAMERA.q_body_camera, rays)
    if rng is not None:
        rays_body = geometry.normalize(rays_body + np.radians(noise_deg) * rng.standard_normal((4, 3)))
    return IncompleteGate(rays_body, 0.8)


def hovering(shift=OFFSET, **changes):
    """Return an estimator of a vehicle before gate 3 whose position is known to 0.2 m, and its next odometry."""
    changes = {"start_sigma_m": 0.2, "alignment": "map"} | changes
    core = StateEstimator(settings("state_estimator", EstimatorSettings, **changes), TRACK, CAMERA, lockstep=False)
    ticks = (
        Odometry(10_000_000 * i, BEFORE_GATE_3 + shift, TOWARDS_GATE_3, np.zeros(3), np.zeros(3)) for i in range(1000)
    )
    return core, ticks


def corrected(core, ticks, incomplete, whole=()):
    """Return the estimated position after an image, and the results of its gates."""
    core.odometry(sample := next(ticks))
    [(_, updates)] = core.gates(sample.stamp_ns, list(whole), incomplete).updates
    return core.odometry(next(ticks)).states[0].p_world, updates


@pytest.mark.parametrize("corners", [TOP, LEFT, RIGHT, THREE], ids=str)
def test_a_known_pose_is_recovered_from_two_or_three_corners(corners):
    """Three corners at 4 m give the position; two leave the distance along their rays to the uncertainty before."""
    core, ticks = hovering()
    rng = np.random.default_rng(1)
    for _ in range(10):
        position, [update] = corrected(core, ticks, [seen(2, corners, noise_deg=0.1, rng=rng)])
        assert (update.gate, update.accepted, update.reason) == (2, True, "")
        assert np.isnan(update.innovation).all() and update.mahalanobis < 4.0
    error, ahead = position - BEFORE_GATE_3, TRACK.rotations[2][:, 0]
    across = error - (error @ ahead) * ahead
    assert np.linalg.norm(OFFSET) > 0.2
    assert np.linalg.norm(across) < 0.07
    assert abs(error @ ahead) < (0.07 if corners == THREE else 0.15)


def test_corners_that_no_gate_of_the_map_has_there_are_refused():
    core, ticks = hovering()
    clutter = seen(2, TOP, p_map=BEFORE_GATE_3 + [0.0, 0.0, 1.5])
    position, [update] = corrected(core, ticks, [clutter])
    assert not update.accepted and update.gate == -1 and update.reason
    assert np.allclose(position, BEFORE_GATE_3 + OFFSET)


def test_one_wrong_corner_of_three_is_refused():
    core, ticks = hovering()
    wrong = seen(2, THREE)
    wrong.rays_body[1] = geometry.normalize(wrong.rays_body[1] + [0.0, 0.0, 0.15])  # 8 degrees
    position, [update] = corrected(core, ticks, [wrong])
    assert not update.accepted
    assert np.allclose(position, BEFORE_GATE_3 + OFFSET)


def test_a_post_that_may_be_the_left_or_the_right_one_is_dropped():
    """With the position known to a metre only, the left post of gate 3 may be the right one of the gate from behind."""
    core, ticks = hovering(np.zeros(3), start_sigma_m=1.0)
    _, [update] = corrected(core, ticks, [seen(2, LEFT)])
    assert not update.accepted and "nearly equally well" in update.reason


def whole(gate: int, **pose):
    """Return the pose of a whole gate of the map."""
    corners = world_to_camera(CAMERA, pose.get("p_map", BEFORE_GATE_3), TOWARDS_GATE_3, TRACK.corners[gate])
    return gate_poses().locate(0, [GateCorners(project(CAMERA, corners)[0], np.ones(4))])[0][0]


def test_corners_of_a_gate_that_is_whole_in_the_image_are_refused():
    core, ticks = hovering()
    _, updates = corrected(core, ticks, [seen(2, LEFT)], [whole(2)])
    assert [update.accepted for update in updates] == [True, False]
    assert updates[1].reason == TAKEN


def test_after_two_images_of_refused_whole_gates_corners_wait_for_an_accepted_one():
    core, ticks = hovering()
    elsewhere = whole(2, p_map=BEFORE_GATE_3 + [0.0, 0.0, 2.0])
    _, [_, update] = corrected(core, ticks, [seen(2, THREE)], [elsewhere])
    assert update.accepted, "one image may show a false gate"
    for others in ([elsewhere], []):
        _, updates = corrected(core, ticks, [seen(2, THREE)], others)
        assert not updates[-1].accepted and updates[-1].reason == WHOLE_GATES_REFUSED
    corrected(core, ticks, [], [whole(2)])
    _, [update] = corrected(core, ticks, [seen(2, THREE)])
    assert update.accepted


def test_the_filter_on_positions_does_without_incomplete_gates():
    core, ticks = hovering(filter="drift")
    _, [update] = corrected(core, ticks, [seen(2, THREE)])
    assert not update.accepted and update.reason == NEEDS_WHOLE_GATES


@pytest.mark.parametrize("corners", [[], [0], [0, 1, 2, 3]], ids=str)
def test_gates_with_another_number_of_corners_are_refused_with_a_sentence(corners):
    core, ticks = hovering()
    core.odometry(sample := next(ticks))
    output = core.gates(sample.stamp_ns, [], [seen(2, corners)])
    assert not output.updates[0][1] and "not a number" in output.warnings[0]


@pytest.fixture(scope="module")
def flown():
    """Return the errors (m) of a race in which no gate is whole in any image, without and with incomplete gates."""
    truth, raw, core = race(), odometry(race(), Drift(), 1), gate_poses()
    rng = np.random.default_rng(1)
    gates = {i: [partly(gate, rng) for gate in found] for i, found in images(truth, Detector(), 1).items()}
    errors = {}
    for name in ("blind", "corners"):
        estimator = StateEstimator(settings("state_estimator", EstimatorSettings), TRACK, CAMERA, lockstep=True)
        states, updates = [], []
        for i, sample in enumerate(raw):
            outputs = [estimator.odometry(sample)]
            if i in gates:
                incomplete = core.rays(gates[i])[0] if name == "corners" else []
                outputs.append(estimator.gates(sample.stamp_ns, [], incomplete))
            states += [state.p_world for output in outputs for state in output.states]
            updates += [update for output in outputs for _, group in output.updates for update in group]
        distances = np.linalg.norm(np.array(states) - truth.p_map[: len(states)], axis=1)
        errors[name] = float(np.sqrt(np.mean(distances**2)))
    return errors, updates


def partly(gate: GateCorners, rng) -> GateCorners:
    """Return a gate of which one corner is not seen, or two neighbours are not."""
    first, corners, confidence = rng.integers(4), gate.corners_px.copy(), gate.confidence.copy()
    for k in {first, (first + rng.integers(2)) % 4}:
        corners[k], confidence[k] = np.nan, 0.0
    return GateCorners(corners, confidence)


def test_the_drift_of_a_race_without_any_whole_gate_is_corrected(flown):
    errors, updates = flown
    assert errors["blind"] > 0.3
    assert errors["corners"] < 0.15
    assert np.mean([update.accepted for update in updates]) > 0.85
