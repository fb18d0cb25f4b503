"""Trial races: what is counted, and which pilot of two is the better one."""

import numpy as np
import pytest

from swift_sim_bridge.pilot import trial


def test_trials_count_laps_from_gate_one_to_gate_one():
    ticks = np.full((2, 22), -1)
    ticks[0] = 80 + 90 * np.arange(22)
    ticks[1, :9] = 80 + 100 * np.arange(9)
    margins, lines = np.full((2, 22), 0.3), np.zeros((2, 9, 3))
    figures = trial.figures(trial.Trial(ticks, margins, lines[:, 0], lines, lines[..., 0]), 7)
    assert figures["races"] == 2
    assert figures["finish_rate"] == 0.5 and figures["median_race_s"] == pytest.approx(19.7)
    assert figures["best_lap_s"] == pytest.approx(6.3) and figures["median_lap_s"] == pytest.approx(6.3)
    assert figures["mean_lap_s"] == pytest.approx((3 * 6.3 + 7.0) / 4)
    assert figures["passages"] == 15.5


def figures(races: int, finished: int, lap_s: float) -> dict:
    return {"races": races, "finish_rate": finished / races, "mean_lap_s": lap_s, "passages": 22.0}


def test_the_faster_pilot_is_the_better_one_where_the_failures_differ_by_chance():
    slow, fast = figures(100, 100, 5.8), figures(100, 98, 5.7)
    assert trial.merit(fast) > trial.merit(slow)
    assert trial.merit(figures(100, 97, 5.7)) < trial.merit(slow)


def test_more_races_separate_pilots_that_few_do_not():
    assert trial.merit(figures(500, 490, 5.7)) < trial.merit(figures(500, 498, 5.8))
