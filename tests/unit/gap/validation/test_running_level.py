"""The level of a flight: slow errors are followed, from the past alone, and what is fast stays."""

import numpy as np
import pytest

from swift_sim_bridge.gap.validation.running_level import DELAY_S, TIME_S, running_level

STEP_S = 0.02
T = STEP_S * np.arange(3000)  # a minute
BIAS = np.array([0.4, -0.2, 0.0])


def test_a_bias_is_found_within_seconds_and_then_gone():
    errors = np.broadcast_to(BIAS, (len(T), 3))
    left = errors - running_level(T, errors)
    assert np.array_equal(left[0], BIAS)
    assert np.abs(left[T > 8.0]).max() < 0.1 * np.abs(BIAS).max()
    assert np.abs(left[-1]).max() < 1e-4


def test_the_level_has_no_part_in_what_comes_later():
    errors = np.random.default_rng(1).standard_normal((len(T), 3))
    changed, at = errors.copy(), 1500
    changed[at:] += 100.0
    shift = np.abs(running_level(T, changed) - running_level(T, errors))
    delay = round(DELAY_S / STEP_S)
    assert not shift[: at + delay].any()
    assert (shift[at + delay + 2 :] > 0.0).all()


def test_a_load_that_is_dropped_is_followed_and_the_motion_of_the_vehicle_is_not():
    load, motion = np.where(T < 30.0, 0.0, 1.0), 0.5 * np.sin(2.0 * np.pi * T)
    left = (load + motion)[:, None] - running_level(T, (load + motion)[:, None])
    late = T > 30.0 + 3.0 * TIME_S
    assert abs(left[late].mean()) < 0.05
    assert np.std(left[late, 0]) == pytest.approx(np.std(motion), rel=0.05)


def test_the_level_lasts_through_a_gap_and_while_nothing_is_measured():
    kept = (T < 20.0) | (T > 25.0)
    errors = np.where(T[:, None] < 15.0, BIAS, np.nan)
    np.testing.assert_allclose(running_level(T[kept], errors[kept])[-1], BIAS, rtol=0.05)
