"""The filter on corner rays, flown: odometry that drifts, corners that are late, noisy and sometimes wrong."""

import numpy as np
import pytest
from synthetic_flight import LATENCY_NS, Detector, Drift, estimate, odometry, race

# The odometry of the story: 2 % drift, heading off from the start, both bending the path.
DRIFT = Drift(walk=0.03, rate_share=0.02, scale=0.01, yaw_walk_deg=0.6, start_yaw_deg=1.5, coupled=True)


@pytest.fixture(scope="module")
def flown():
    return estimate(DRIFT, seed=1)


def test_the_drift_is_taken_out(flown):
    """The goal is 0.20 m and half the raw error; this is what leaves room for a real detector."""
    assert flown.raw_rmse > 0.4
    assert flown.rmse < 0.13
    assert flown.rmse < 0.5 * flown.raw_rmse


def test_the_filter_knows_how_sure_it_is(flown):
    assert 1.0 < flown.nees < 8.0


def test_the_heading_is_found_from_the_gates(flown):
    """1.5 degrees off at the start, walking on: the paper's filter would hold it."""
    assert np.degrees(np.sqrt(np.mean(flown.attitude_errors**2))) < 0.9


def test_nearly_all_honest_gates_count(flown):
    assert np.mean([update.accepted for update in flown.updates]) > 0.95
    assert all(update.reason for update in flown.updates if not update.accepted)


def test_ignoring_the_delay_is_worse(flown):
    """Corners applied where the vehicle was when they arrived, 40 ms later: half a metre at 13 m/s."""
    assert estimate(DRIFT, seed=1, late_ns=LATENCY_NS).rmse > 2.0 * flown.rmse


def test_wrong_corners_and_invented_gates_are_left_out(flown):
    """One gate in ten with a corner 15 px off, one image in ten with a gate that is not there."""
    dirty = estimate(DRIFT, Detector(outliers=0.1, false_gates=0.1), seed=1)
    assert dirty.rmse < 1.5 * flown.rmse
    invented = [update for update in dirty.updates if update.gate < 0]
    assert invented and not any(update.accepted for update in invented)


def test_a_noisier_detector_costs_centimetres(flown):
    assert estimate(DRIFT, Detector(sigma_px=1.2), seed=1).rmse < flown.rmse + 0.06


def test_with_odometry_alone_the_doubt_grows_with_the_path():
    blind = estimate(DRIFT, Detector(found=0.0, false_gates=0.0), seed=1)
    assert not blind.updates
    assert blind.rmse == pytest.approx(blind.raw_rmse, rel=0.2)
    doubt = [np.sqrt(np.trace(state.covariance_pose[:3, :3])) for state in blind.states]
    assert doubt[-1] > 0.3 > doubt[0]
    assert blind.nees < 10.0


def test_the_velocity_is_the_odometrys_own(flown):
    """Adding the estimated drift rate made it worse."""
    raw = odometry(race(), DRIFT, 1)
    assert np.array_equal(flown.states[500].v_body, raw[500].v_body)
