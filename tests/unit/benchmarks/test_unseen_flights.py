"""Unseen flights: a correct diagnosis has small errors, black-box models larger ones; table and picture show them."""

from types import SimpleNamespace

import numpy as np
import pytest

from swift_ros.configuration import build
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.benchmarks import unseen_flights, unseen_flights_picture
from swift_sim_bridge.referee.simulator import paths


@pytest.fixture(scope="module")
def record():
    """Return the record of a seed with a perfect diagnosis."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(unseen_flights, "SECONDS", 8.0)
        true = build(Vehicle, unseen_flights.fly(5).true, "test")
        right = SimpleNamespace(vehicle=true, selected=(), report={"findings": [{"effect": "body_drag"}]})
        patch.setattr(unseen_flights, "diagnose", lambda *_, **__: right)
        return unseen_flights.evaluate(5, lambda _: None)


@pytest.mark.slow
def test_a_perfect_diagnosis_predicts_as_the_true_vehicle_and_black_boxes_do_not(record):
    for horizons in record["flights"].values():
        row = horizons["0.5"]
        assert row["after"] == row["true"] < 0.1 * row["before"]
        assert row["after"] < 0.5 * min(row["knn"], row["gp"])
        assert horizons["0.1"]["before"] < row["before"] < horizons["1.0"]["before"]
    assert record["speeds_m_s"]["25 % faster"] == pytest.approx(1.25 * record["speeds_m_s"]["recording"], rel=0.05)


@pytest.mark.slow
def test_ratios_follow_from_the_errors_and_the_smaller_one_decides(record, tmp_path):
    row = {"before": 1.0, "after": 0.01, "with_remainder": 0.01, "knn": 0.3, "gp": 0.25, "true": 0.01}
    records = [record | {"flights": {name: {"0.5": row} for name in unseen_flights.UNSEEN}}] * 2
    assert unseen_flights.ratios(records, "another path", "0.5", "gp") == pytest.approx([25.0, 25.0])
    assert unseen_flights.met(records)
    records[0]["flights"]["25 % faster"]["0.5"] = row | {"gp": 0.15}
    assert not unseen_flights.met(records)
    assert "30.0 (30.0 to 30.0)" in unseen_flights.table(records)
    unseen_flights_picture.draw([record], tmp_path / "rollouts.png")
    assert (tmp_path / "rollouts.png").stat().st_size > 1000


def test_a_path_flown_faster_passes_the_same_positions():
    slow = paths.draw_path(np.random.default_rng(1), "gates", 12.0, 25.0, 8.0, 0.3)
    fast = paths.paced(slow, 1.25, 9.0)
    np.testing.assert_allclose(fast.p[400], slow.p[500], atol=1e-6)
    np.testing.assert_allclose(np.gradient(fast.p, paths.TICK_S, axis=0)[300:-1], fast.v[300:-1], atol=0.05)
    np.testing.assert_allclose(np.gradient(fast.v, paths.TICK_S, axis=0)[300:-1], fast.a[300:-1], atol=0.5)
