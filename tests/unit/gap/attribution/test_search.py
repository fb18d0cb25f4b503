"""The stepwise search tries each effect once."""

from types import SimpleNamespace

from swift_sim_bridge.gap.attribution import search

LEFT = {"linear_drag": 10.0, "body_drag": 50.0}  # squares that each leaves in the simulation


def test_an_effect_that_was_superfluous_is_no_rival_of_one_that_looks_like_it(monkeypatch):
    problem = SimpleNamespace(gain=lambda keys: 100.0 * len(keys), slices=LEFT)
    monkeypatch.setattr(search.stepwise, "accepts", lambda *_: (True, 9.0))
    monkeypatch.setattr(search, "_left_in_simulation", lambda evidence, vehicle, keys, values: LEFT[keys[-1]])
    rivals = search._rivals(problem, [], "body_drag", set())
    assert rivals == ["linear_drag"] and not search._rivals(problem, [], "body_drag", {"linear_drag"})
    assert search._best_in_simulation(None, None, [], {}, ["body_drag", *rivals]) == "linear_drag"
    assert search._best_in_simulation(None, None, [], {}, ["body_drag"]) == "body_drag"
