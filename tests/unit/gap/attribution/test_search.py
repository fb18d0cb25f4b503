"""The stepwise search tries each effect once."""

from types import SimpleNamespace

import pytest

from swift_sim_bridge.gap.attribution import search

LEFT = {"linear_drag": 10.0, "body_drag": 50.0}  # squares that each leaves in the simulation


@pytest.mark.parametrize("dropped, best", [(set(), "linear_drag"), ({"linear_drag"}, "body_drag")])
def test_an_effect_that_was_superfluous_is_no_rival_of_one_that_looks_like_it(monkeypatch, dropped, best):
    effects = tuple(SimpleNamespace(key=key, id=key, exclusive=False) for key in LEFT)
    evidence, problem = SimpleNamespace(effects=effects), SimpleNamespace(gain=lambda keys: 100.0 * len(keys))
    monkeypatch.setattr(search.stepwise, "accepts", lambda *_: (True, 9.0))
    monkeypatch.setattr(search, "_left_in_simulation", lambda evidence, vehicle, keys, values: LEFT[keys[-1]])
    assert search._best_in_simulation(evidence, None, problem, [], "body_drag", {}, dropped) == best
