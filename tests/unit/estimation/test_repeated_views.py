"""What images of one view add: a vehicle at rest looks at the same gate for a long time, then flies."""

import numpy as np
import pytest
from synthetic_flight import CAMERA, TRACK, Detector, Drift, estimate, race

from swift_ros.estimation.assignment import Match, PoseEstimate
from swift_ros.estimation.repeated_views import RepeatedViews

SIGMA = 0.005  # rad


def deviations(ticks, bias_share: float = 0.7) -> np.ndarray:
    """Return the deviation of the first gate's corners, in units of SIGMA, in images at ticks of the race."""
    views, truth = RepeatedViews(bias_share, 1.0, CAMERA.p_body_camera), race()
    match = Match(0, TRACK.corners[0], np.zeros((4, 3)), SIGMA, 0.0, "")
    poses = [PoseEstimate(truth.p_map[i], truth.q_map_body[i], np.eye(6)) for i in ticks]
    return np.array([views.weighed(match, pose).sigma_rad for pose in poses]) / SIGMA


@pytest.mark.parametrize("count", [1, 2, 10, 100])
def test_the_images_of_a_vehicle_at_rest_add_up_to_the_mean_of_biased_corners(count):
    information = np.sum(deviations([0] * count) ** -2.0)
    assert 1.0 / information == pytest.approx(0.7 + 0.3 / count)


def test_a_new_view_counts_in_full():
    assert deviations(range(150, 160, 3)) == pytest.approx(1.0, abs=0.3)
    assert deviations([0] * 100)[-1] > 20.0


def test_without_a_bias_all_images_count_in_full():
    assert deviations([0] * 5, bias_share=0.0) == pytest.approx(1.0)


@pytest.mark.slow
def test_the_filter_is_not_certain_of_what_a_bias_shifts():
    """Corners with a bias of 0.6 px: the error after a second at rest is within the filter's covariance."""
    detector = Detector(sigma_px=0.15, bias_px=0.6, outliers=0.0, false_gates=0.0)

    def squared_error(bias_share: float) -> float:
        drift = Drift(start_yaw_deg=0.5)
        flown = [estimate(drift, detector, seed, ticks=96, corner_bias_share=bias_share) for seed in range(1, 6)]
        rest = [(one.errors[95], one.states[95].covariance_pose[:3, :3]) for one in flown]
        return float(np.mean([error @ np.linalg.solve(covariance, error) for error, covariance in rest]))

    assert squared_error(0.7) < 0.7 * squared_error(0.0)
    assert squared_error(0.7) < 8.0
