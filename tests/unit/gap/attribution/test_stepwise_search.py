"""The stepwise search tries each effect once, and removes none without which the simulation is clearly worse."""

from types import SimpleNamespace

import pytest

from swift_sim_bridge.gap.attribution import stepwise_search

LEFT = {"linear_drag": 10.0, "body_drag": 50.0}  # squares that each leaves in the simulation


def test_an_effect_that_was_superfluous_is_no_rival_of_one_that_looks_like_it(monkeypatch):
    problem = SimpleNamespace(gain=lambda keys: 100.0 * len(keys), slices=LEFT)
    monkeypatch.setattr(stepwise_search.stepwise, "accepts", lambda *_: (True, 9.0))
    monkeypatch.setattr(stepwise_search, "_left_in_simulation", lambda evidence, vehicle, keys, values: LEFT[keys[-1]])
    rivals = stepwise_search._rivals(problem, [], "body_drag", set())
    assert rivals == ["linear_drag"] and not stepwise_search._rivals(problem, [], "body_drag", {"linear_drag"})
    assert stepwise_search._best_in_simulation(None, None, [], {}, ["body_drag", *rivals]) == "linear_drag"
    assert stepwise_search._best_in_simulation(None, None, [], {}, ["body_drag"]) == "body_drag"


@pytest.mark.parametrize(
    ("squares", "kept"),
    [
        ({"ab": 900.0, "abc": 400.0, "c": 410.0}, "c"),  # c explains what a and b stood for
        ({"ab": 900.0, "abc": 800.0, "c": 70000.0}, "abc"),  # superfluous to first order alone
        ({"ab": 900.0, "abc": 890.0, "c": 70000.0}, "ab"),  # and what was added explains nothing
    ],
)
def test_effects_that_seem_superfluous_stay_while_the_simulation_is_worse_without_them(monkeypatch, squares, kept):
    def left(evidence, vehicle, effects, values):
        return squares["".join(effect.key for effect in effects)]

    monkeypatch.setattr(stepwise_search.model_comparison, "penalised_squares", left)
    evidence = SimpleNamespace(effects=[SimpleNamespace(key=key) for key in "abc"])
    selections = [stepwise_search._Selected(list(keys), {}, None) for keys in squares]
    assert stepwise_search._least_left(evidence, None, *selections).keys == list(kept)
