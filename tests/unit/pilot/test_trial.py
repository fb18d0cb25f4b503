"""Trial races: what is counted, and which pilot of two is the better one."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from swift_sim_bridge.pilot import train as training
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


def test_a_pilot_that_is_a_tenth_faster_may_fail_more_often_but_not_without_limit():
    slow = figures(256, 256, 6.41)
    assert trial.merit(figures(256, 248, 5.83)) > trial.merit(slow)  # so the next training begins with the fast line
    assert trial.merit(figures(256, 236, 5.83)) < trial.merit(slow)


def races_of(finished: int, lap_ticks: int) -> trial.Trial:
    """Return ten races with the same laps, of which some finish."""
    ticks = np.tile(80 + lap_ticks * np.arange(22) // 7, (10, 1))
    ticks[finished:, 15:] = -1
    lines = np.zeros((10, 9, 3))
    return trial.Trial(ticks, np.full((10, 22), 0.3), lines[:, 0], lines, lines[..., 0])


def test_a_policy_is_kept_where_two_trials_together_are_the_best(tmp_path, monkeypatch):
    """Before, a trial in which all races finished by luck was kept."""
    flights, kept, rows = [], [], []
    monkeypatch.setattr(training, "_before_a_trial", lambda *_: (None, jax.random.PRNGKey(0), np.float32(1.0)))
    monkeypatch.setattr(training, "trained_interactions", lambda *_: len(rows))
    job = SimpleNamespace(
        race=lambda *_: flights.pop(0),
        gates=7,
        settings=None,
        export=lambda networks, result: kept.append((networks, result["trials"])),
        out=tmp_path,
        track=None,
        world=SimpleNamespace(guide=None),
    )

    def conclude(name, *trials):
        flights[:] = trials
        training._conclude(job, SimpleNamespace(networks=name), rows, {})
        assert not flights

    conclude("first", races_of(6, 620), races_of(6, 620))
    conclude("lucky", races_of(7, 620), races_of(3, 620))
    conclude("worse", races_of(5, 600))
    conclude("better", races_of(10, 610), races_of(8, 610))
    assert kept == [("first", 2), ("better", 2)]
    assert [row["trials"] for row in rows] == [2, 2, 1, 2]
    assert training.best_of(rows)["finish_rate"] == 0.9
