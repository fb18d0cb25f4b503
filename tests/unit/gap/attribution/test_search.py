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


def test_an_addition_that_drives_out_a_better_effect_is_taken_back(monkeypatch):
    effects = tuple(SimpleNamespace(key=key, id=key, exclusive=False) for key in ("motor_map", "rotor_gain"))
    evidence, squares = SimpleNamespace(effects=effects), {("motor_map",): 10.0, ("rotor_gain",): 500.0}
    additions = iter(["rotor_gain", None])
    steps = search.stepwise
    monkeypatch.setattr(steps, "best_addition", lambda problem, keys, excluded: (next(additions), 9.0))
    monkeypatch.setattr(steps, "backward_elimination", lambda problem, keys: ["rotor_gain"])
    monkeypatch.setattr(search, "_best_in_simulation", lambda evidence, vehicle, problem, keys, key, *_: key)
    monkeypatch.setattr(search, "_replacement", lambda *_: ([], None))
    monkeypatch.setattr(search, "selection_problem_at", lambda *_: None)
    monkeypatch.setattr(search, "gauss_newton_fit", lambda evidence, vehicle, effects, values: ({**values}, {}))
    monkeypatch.setattr(search, "_squares", lambda evidence, vehicle, keys, values: squares[tuple(keys)])
    lines: list[str] = []
    first = {"motor_map": 1.0}
    keys, values = search.select_stepwise(evidence, None, ["motor_map"], {**first, "rotor_gain": 2.0}, lines.append)
    assert keys == ["motor_map"] and values["motor_map"] == 1.0
    assert lines[-1] == "rotor_gain: taken back, less is explained with it"
