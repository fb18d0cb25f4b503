"""Errors injected into a clean recording are found at their times; clean recordings have no rejection."""

import numpy as np
import pytest

from swift_ros.recording.checks import SensorChannel, check_channel, check_time, true_runs

N, DT = 2000, 0.01
T = 1.7e9 + DT * np.arange(N)


def gyro(seed=0):
    """Return a gyro (n, 3), rad/s, of a turning vehicle, with noise."""
    random = np.random.default_rng(seed)
    turning = np.sin(np.outer(T - T[0], (1.0, 2.3, 0.4)))
    return turning + random.normal(scale=0.01, size=(N, 3))


def found(values, t=T, **how):
    channel = SensorChannel("gyro", values, -35.0, 35.0, "rad/s", **how)
    good, rejections = check_channel(t, channel)
    return good, [(round((r.begin_s - t[0]) / DT), round((r.end_s - t[0]) / DT), r.reason) for r in rejections]


def test_a_clean_recording_has_no_rejection():
    for seed in range(5):
        good, rejections = found(gyro(seed))
        assert good.all() and not rejections


def test_nan_and_impossible_values_are_reported_with_their_time():
    values = gyro()
    values[100:103, 1] = np.nan
    values[500:510, 2] = -4.8e6
    good, rejections = found(values)
    assert [(first, last) for first, last, _ in rejections] == [(100, 102), (500, 509)]
    assert "not a number" in rejections[0][2] and "-4.8e+06 rad/s" in rejections[1][2]
    assert np.flatnonzero(~good).tolist() == [100, 101, 102, *range(500, 510)]


def test_a_gap_filled_by_a_straight_line_is_found():
    values = gyro()
    values[300:341] = np.linspace(values[300], values[340], 41)
    _, rejections = found(values)
    assert [(first, last) for first, last, _ in rejections] == [(300, 340)]
    assert "straight line" in rejections[0][2]


def test_a_log_extrapolated_after_its_end_has_one_rejection_for_any_final_value():
    values = gyro()
    values[1500:] = values[1499] + np.outer(np.arange(1, N - 1499), (0.2, -0.1, 0.03))
    _, rejections = found(values)
    assert len(rejections) == 1 and rejections[0][0] in (1498, 1499) and rejections[0][1] == N - 1
    assert "straight line" in rejections[0][2] and "outside of -35 to 35" in rejections[0][2]


@pytest.mark.parametrize("round_to", [np.float32, lambda values: np.round(values, 9)])
def test_rounding_does_not_hide_a_straight_line(round_to):
    values = gyro()
    values[300:341] = np.linspace(values[300], values[340], 41)
    _, rejections = found(np.asarray(round_to(values), dtype=float))
    assert [(first, last) for first, last, _ in rejections] == [(300, 340)]


def test_a_frozen_sensor_is_found_and_a_constant_motor_is_valid():
    values = gyro()
    values[700:760] = values[700]
    assert [(first, last) for first, last, _ in found(values)[1]] == [(700, 759)]
    assert found(values, noisy=False)[1] == []


def test_a_channel_resampled_from_a_slower_one_has_only_its_gaps_rejected():
    random = np.random.default_rng(1)
    knots = np.arange(0.0, N * DT + 1.0, 0.1) + random.uniform(-0.01, 0.01, size=210)
    knots = np.delete(knots, range(100, 109))  # the radio link was lost for a second
    values = np.interp(T - T[0], knots, random.normal(size=len(knots)))
    _, rejections = found(values)
    assert len(rejections) == 1
    first, last, reason = rejections[0]
    assert abs(first - knots[99] / DT) <= 1 and abs(last - knots[100] / DT) <= 1 and "straight line" in reason


def test_decreasing_times_and_gaps_are_reported():
    t = T.copy()
    t[400:410] -= 5.0
    t[1000:] += 0.8
    good, rejections = check_time(t)
    assert np.flatnonzero(~good).tolist() == list(range(400, 410))
    assert "10 times do not increase" in rejections[0].reason
    assert [r.reason for r in rejections[1:]] == [f"no data for {s} s" for s in (0.11, 0.81)]
    assert check_time(T)[0].all() and not check_time(T)[1]


def test_true_runs_are_first_and_last_indices():
    assert true_runs(np.array([1, 1, 0, 0, 1, 0, 1], bool)) == [(0, 1), (4, 4), (6, 6)]
    assert true_runs(np.zeros(3, bool)) == []
