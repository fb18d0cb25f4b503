"""The paper's drift filter: known drifts and headings are estimated, wrong gates are refused."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_flight import LATENCY_NS, TRACK, Detector, Drift, estimate, settings

from swift_ros import geometry
from swift_ros.estimation.assignment import Match
from swift_ros.estimation.drift_filter import DriftFilter
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry, RelativeGatePose

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
STEP_NS = 33_000_000


def hovering(frame: int, yaw: float = 0.0) -> Odometry:
    q = geometry.quaternion_from_yaw(np.float64(yaw))
    return Odometry(frame * STEP_NS, np.array([0.0, -1.6, 3.0]), q, np.zeros(3), np.zeros(3))


def observation(gate: int, p_map, q_map_body, sigma_m: float = 0.05) -> tuple[Match, RelativeGatePose]:
    """Return the match and pose of gate `gate` as observed from a true pose in the map."""
    q_body_map = geometry.quaternion_conjugate(q_map_body)
    p_body = geometry.rotate(q_body_map, TRACK.positions[gate] - p_map)
    q_body_gate = geometry.quaternion_multiply(q_body_map, geometry.quaternion_from_yaw(TRACK.yaws[gate]))
    pose = RelativeGatePose(
        p_body, q_body_gate, np.eye(3) * sigma_m**2, np.eye(4, 3), 1.0, 0.01, p_body, q_body_gate, 0.02
    )
    return Match(gate, TRACK.corners[gate], pose.rays_body, 0.005, 1.0, ""), pose


def start(**changes) -> DriftFilter:
    return DriftFilter(settings("state_estimator", EstimatorSettings, filter="drift", **changes), hovering(0))


def correct(core: DriftFilter, frame: int, drift, gates=(0,), odometry=None, shifts=None) -> list[str]:
    """Correct the filter by gates; the odometry hovers, and the vehicle is displaced from it by `drift`."""
    odometry = odometry or hovering(frame)
    observed = [observation(gate, odometry.p_world + drift, LEVEL) for gate in gates]
    if shifts:
        observed = [(m, shifted(s, shifts.get(m.gate))) for m, s in observed]
    return core.correct(odometry, [match for match, _ in observed], [pose for _, pose in observed])


def shifted(pose: RelativeGatePose, by) -> RelativeGatePose:
    return pose if by is None else replace(pose, p_body=pose.p_body + by)


def test_a_known_drift_is_estimated():
    core, drift = start(), np.array([0.3, -0.2, 0.1])
    for frame in range(1, 40):
        correct(core, frame, drift)
    pose_estimate = core.pose_estimate(hovering(40))
    assert np.allclose(pose_estimate.p_map - hovering(40).p_world, drift, atol=0.05)
    assert np.allclose(pose_estimate.covariance, pose_estimate.covariance.T)
    assert np.all(np.linalg.eigvalsh(pose_estimate.covariance) > 0)


def test_a_growing_drift_is_extrapolated_to_the_stamp_of_the_odometry():
    core, rate = start(), np.array([0.2, 0.0, -0.1])
    for frame in range(1, 120):
        correct(core, frame, rate * frame * STEP_NS * 1e-9)
    later = hovering(125)
    found = core.pose_estimate(later).p_map - later.p_world
    assert np.allclose(found, rate * 125 * STEP_NS * 1e-9, atol=0.06)


def test_two_gates_in_one_update_reduce_the_variance_more_than_one():
    one, two = start(), start()
    correct(one, 1, np.zeros(3), gates=[0])
    correct(two, 1, np.zeros(3), gates=[0, 5])
    assert np.trace(two.pose_estimate(hovering(1)).covariance[:3, :3]) < np.trace(
        one.pose_estimate(hovering(1)).covariance[:3, :3]
    )


def test_a_gate_that_contradicts_the_others_is_refused_with_a_reason():
    core = start()
    for frame in range(1, 20):
        correct(core, frame, np.zeros(3), gates=[0, 5])
    before = core.pose_estimate(hovering(20)).p_map
    reasons = correct(core, 20, np.zeros(3), gates=[0, 5], shifts={5: np.array([2.5, 0.0, 0.0])})
    assert reasons[0] == "" and "standard deviations off" in reasons[1]
    assert np.linalg.norm(core.pose_estimate(hovering(20)).p_map - before) < 0.05


def test_the_heading_is_averaged_over_the_first_seconds_and_then_constant():
    core, odd = start(drift_yaw_s=1.0, start_yaw_sigma_deg=10.0), np.radians(-4.0)
    for frame in range(1, 60):
        correct(core, frame, np.zeros(3), odometry=hovering(frame, odd))
    found = geometry.yaw_of(core.pose_estimate(hovering(60, odd)).q_map_body)
    assert np.degrees(found) == pytest.approx(0.0, abs=1.5)
    for frame in range(60, 120):
        correct(core, frame, np.zeros(3), odometry=hovering(frame, odd + 0.2))
    assert geometry.yaw_of(core.pose_estimate(hovering(120, odd)).q_map_body) == pytest.approx(found), "constant"


@pytest.fixture(scope="module")
def flown():
    return estimate(Drift(), seed=1, filter="drift")


def test_most_of_the_drift_of_a_lap_is_corrected(flown):
    assert flown.rmse < 0.25
    assert flown.rmse < 0.5 * flown.raw_rmse
    assert flown.nees < 20.0


def test_wrong_corners_are_refused(flown):
    """Without a test of the innovation one wrong corner in twenty gates gave larger errors than the odometry."""
    assert estimate(Drift(), Detector(outliers=0.1), seed=1, filter="drift").rmse < 1.5 * flown.rmse


def test_ignoring_the_delay_is_worse(flown):
    assert estimate(Drift(), seed=1, late_ns=LATENCY_NS, filter="drift").rmse > 2.0 * flown.rmse
