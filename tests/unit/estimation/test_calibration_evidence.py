"""Wrong calibrations of the camera, planted in the file that the stack reads: which error the estimator names."""

import re
from dataclasses import replace

import pytest
from synthetic_flight import CAMERA, TRACK, Detector, Drift, odometry, poses_seen, race, settings

from swift_ros.camera.model import Camera
from swift_ros.estimation.estimator import StateEstimator
from swift_ros.estimation.settings import EstimatorSettings

DETECTOR = Detector()
DRIFT = Drift(walk=0.03, rate_share=0.02, scale=0.01, yaw_walk_deg=0.6, start_yaw_deg=1.0, coupled=True)
REST_S = 1.5  # on the podium
REST = 149  # ticks of it
SLOW = pytest.mark.slow


def warnings(camera=CAMERA, detector=DETECTOR, seed: int = 1, track=TRACK, ticks=None, kind="corners") -> list[str]:
    """Return what an estimator that assumes `camera` and `track` says in the one-lap race, or in its first ticks."""
    core = StateEstimator(settings("state_estimator", EstimatorSettings, filter=kind), track, camera, lockstep=True)
    seen, found = poses_seen(detector, seed, camera, REST_S), []
    for i, sample in enumerate(odometry(race(at_rest_s=REST_S), DRIFT, seed)[:ticks]):
        outputs = [core.odometry(sample)]
        if i in seen:
            outputs.append(core.gates(sample.stamp_ns, seen[i]))
        found += [warning for output in outputs for warning in output.warnings]
    return found


def of_lens(**changes) -> Camera:
    return replace(CAMERA, **changes)


def assert_named(found: list[str], said: str, value: float) -> None:
    """Assert that the only sentence is this one, its number right within noise and the error of one linearisation."""
    assert len(found) == 1, found
    matched = re.search(said, found[0])
    assert matched, found
    deviation = float(found[0].rpartition(" ")[2])
    assert abs(float(matched[1]) - value) < 4.0 * deviation + 0.1 * value, found
    assert deviation < 0.3 * value


@pytest.mark.parametrize("seed", (1, pytest.param(2, marks=SLOW)))
def test_nothing_is_said_about_a_right_calibration(seed):
    assert warnings(seed=seed) == []


def test_biased_corners_are_no_wrong_calibration():
    """A detector whose corners are off by 0.5 px in the same way in all images."""
    assert warnings(detector=Detector(sigma_px=0.3, bias_px=0.5), seed=2) == []


@pytest.mark.parametrize(
    ("camera", "said", "value"),
    [
        (of_lens(fx=1.07 * CAMERA.fx, fy=1.07 * CAMERA.fy), r"focal length (.*) % shorter \(fx, fy\)", 6.5),
        pytest.param(
            of_lens(fx=0.93 * CAMERA.fx, fy=0.93 * CAMERA.fy), r"focal length (.*) % longer \(fx, fy\)", 7.5, marks=SLOW
        ),
        (of_lens(pitch_deg=25.0), r"optical axis (.*) degrees lower \(pitch_deg", 5.0),
        pytest.param(of_lens(yaw_deg=7.0), r"optical axis (.*) degrees further right \(yaw_deg", 7.0, marks=SLOW),
        (of_lens(roll_deg=4.0), r"rolled by (.*) degrees less", 4.0),
        (of_lens(distortion=(0.05, 0.037, -0.036, 0.006)), r"57 degrees (.*) degrees further in \(distortion\)", 3.2),
    ],
)
def test_an_error_of_lens_or_mount_is_named_before_take_off(camera, said, value):
    assert_named(warnings(camera, ticks=REST), said, value)


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        (of_lens(pitch_deg=-20.0), "pitch_deg 20 in camera.yaml"),
        pytest.param(of_lens(roll_deg=90.0), "roll_deg 0 in camera.yaml", marks=SLOW),
        pytest.param(of_lens(roll_deg=180.0), "roll_deg 0 in camera.yaml", marks=SLOW),
        pytest.param(of_lens(pitch_deg=0.0, roll_deg=20.0), "pitch_deg 20 and roll_deg 0 in camera.yaml", marks=SLOW),
        pytest.param(of_lens(pitch_deg=0.0, roll_deg=-20.0), "pitch_deg 20 and roll_deg 0 in camera.yaml", marks=SLOW),
        pytest.param(of_lens(pitch_deg=0.0, yaw_deg=20.0), "pitch_deg 20 and yaw_deg 0 in camera.yaml", marks=SLOW),
    ],
)
def test_a_mount_with_exchanged_axes_is_named_before_take_off(camera, said):
    found = warnings(camera, ticks=REST)
    assert len(found) == 1, found
    assert said in found[0]


def test_an_exchanged_mount_is_named_beside_the_drift_filter_too():
    found = warnings(of_lens(pitch_deg=-20.0), ticks=REST, kind="drift")
    assert len(found) == 1 and "pitch_deg 20 in camera.yaml" in found[0]


@pytest.mark.parametrize(
    ("detector", "said", "value"),
    [
        pytest.param(Detector(readout_s=0.02), r"reads the rows in (\d+) ms, top row first", 20, marks=SLOW),
        pytest.param(Detector(readout_s=-0.02), r"reads the rows in (\d+) ms, bottom row first", 20, marks=SLOW),
        (Detector(delay_s=0.012), r"images exposed (\d+) ms after their stamps", 12),
    ],
)
def test_an_error_of_time_is_named_in_flight(detector, said, value):
    assert_named(warnings(detector=detector), said, value)


def test_a_small_tilt_is_named_in_flight():
    assert_named(warnings(of_lens(pitch_deg=23.0)), r"optical axis (.*) degrees lower", 3.0)


def test_openings_of_another_size_are_no_error_of_the_lens():
    """All gates are 8 % smaller than track.yaml says: in flight this is another error than a shorter focal length."""
    found = warnings(track=replace(TRACK, inner_side=1.08 * TRACK.inner_side))
    assert_named(found, r"openings of the gates (.*) % smaller \(inner_side\)", 7.4)
