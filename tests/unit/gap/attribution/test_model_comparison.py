"""Comparison of selected effects with equations, on explanations whose losses are given."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.model_comparison import (
    Explanation,
    _absorbs_unknown_cause,
    _clearly_better,
    _equally_plausible,
    is_physical,
)
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import sensitivity

NOISE = np.random.default_rng(1).standard_normal((500, 1))
WITH_EFFECT = Explanation(("body_drag",), {}, (), 500.0 + 31.0, 31.0, 3, 0.0, [NOISE])
WAVE = 0.4 * np.sin(np.arange(500))[:, None]
VEHICLE = load(Vehicle, configuration_folder() / "drone.yaml")
KEYS = ("com_offset", "drag_center", "thrust_coefficient")


def test_an_effect_is_uncertain_if_a_distinct_equation_of_the_same_size_explains_as_much():
    other = replace(WITH_EFFECT, keys=(), loss=498.0 + 63.0, penalty=63.0, residuals=[NOISE + WAVE])
    worse = replace(other, loss=520.0 + 63.0)
    assert _equally_plausible(WITH_EFFECT, other, 0.0)
    assert not _equally_plausible(WITH_EFFECT, replace(other, residuals=[NOISE]), 0.0)  # the same, written differently
    assert not _equally_plausible(WITH_EFFECT, replace(other, parameter_count=4), 0.0)
    assert not _equally_plausible(WITH_EFFECT, worse, 0.0)
    assert _equally_plausible(WITH_EFFECT, worse, 20.0)  # within the error of the simulator
    assert not _equally_plausible(WITH_EFFECT, other, 30.0)  # but so is the difference of the residuals
    lower_loss = replace(other, loss=520.0, parameter_count=4, residuals=[-NOISE])
    assert _equally_plausible(WITH_EFFECT, lower_loss, 0.0)


def test_an_effect_is_rejected_for_an_equation_of_lower_loss_or_of_no_more_parameters_that_explains_more():
    other = replace(WITH_EFFECT, keys=(), loss=480.0 + 63.0, penalty=63.0)
    assert other.loss > WITH_EFFECT.loss and _clearly_better(other, WITH_EFFECT, 0.0)
    assert not _clearly_better(other, WITH_EFFECT, 10.0)  # within the error of the simulator
    assert not _clearly_better(replace(other, parameter_count=4), WITH_EFFECT, 0.0)
    assert _clearly_better(replace(other, parameter_count=4, loss=440.0 + 47.0, penalty=47.0), WITH_EFFECT, 0.0)


def test_an_equation_that_leaves_larger_residuals_is_not_better_unless_the_difference_may_be_bias():
    other = replace(WITH_EFFECT, keys=(), loss=400.0, parameter_count=9, residuals=[1.2 * NOISE])
    assert not _clearly_better(other, WITH_EFFECT, 0.0) and not _equally_plausible(WITH_EFFECT, other, 0.0)
    biased = replace(WITH_EFFECT, bias_gain=200.0)
    assert _clearly_better(other, biased, 0.0) and _equally_plausible(biased, other, 0.0)


@pytest.mark.parametrize("keys", [KEYS, KEYS[:2]])
@pytest.mark.parametrize(
    ("gain", "parameter_count", "kept"), [(60.0, 3, False), (20.0, 3, True), (60.0, 9, True), (500.0, 9, False)]
)
def test_several_effects_are_rejected_together_if_one_short_equation_explains_more(
    keys, gain, parameter_count, kept, monkeypatch
):
    """None of the effects can be left out alone: each compensates the errors of the others."""

    def explain(evidence, vehicle, some, values, initial):
        loss = 1e5 if 0 < len(some) < len(keys) else 1000.0 if some else 1000.0 - gain
        return Explanation(tuple(some), {}, (), loss, 50.0, 9 if some else parameter_count, 0.0, [NOISE])

    monkeypatch.setattr(model_comparison, "explain", explain)
    monkeypatch.setattr(model_comparison, "normalised_squares", lambda evidence, lines: 1e5)
    monkeypatch.setattr(model_comparison, "is_physical", lambda evidence, effect, values: True)
    monkeypatch.setattr(model_comparison.gauss_newton, "residuals_at", lambda evidence, vehicle: [])
    evidence = SimpleNamespace(effects=[SimpleNamespace(key=key, retimes=False) for key in keys])
    best = model_comparison.best_explanation(evidence, None, list(keys), {}, lambda text: None)
    assert best.keys == (keys if kept else ())


@pytest.mark.parametrize(
    ("keys", "terms", "absorbed"), [(KEYS, 1, True), (KEYS[:2], 1, False), (KEYS, 2, False), (KEYS, 0, False)]
)
def test_one_term_replaces_three_effects_if_it_is_better_by_little(keys, terms, absorbed):
    """A fin was a drag centre with two drags that took away the moment about the other axis."""
    effects = replace(WITH_EFFECT, keys=keys, parameter_count=3)
    term = SimpleNamespace(gain=100.0, net_gain=90.0)  # of which the bias may be a tenth
    equation = replace(WITH_EFFECT, keys=(), terms=(term,) * terms, parameter_count=1, loss=WITH_EFFECT.loss + 5.0)
    assert _absorbs_unknown_cause(effects, equation, 0.0) == absorbed
    assert not _absorbs_unknown_cause(effects, replace(equation, loss=WITH_EFFECT.loss + 11.0), 0.0)


def test_a_local_wind_is_not_physical_at_the_bounds_of_its_radius_position_or_speed():
    effect, values = catalogue.draught(), np.array([2.0, 0.0, 0.0, 1.0, 2.0, 1.0, 10.0])
    assert not is_physical(None, effect, {effect.key: values})
    assert is_physical(None, effect, {effect.key: np.append(values[:-1], 3.0)})
    far = np.array([2.0, 0.0, 0.0, 1.0, 2.0, 2.9999, 3.0])  # as far from the initial position as the bounds allow
    assert not is_physical(None, effect, {effect.key: far})
    storm = np.array([2.0, 0.0, 9.0, 1.0, 2.0, 1.0, 3.0])  # what a raised place with its own ground effect looks like
    assert not is_physical(None, effect, {effect.key: storm})


@pytest.mark.parametrize(("steps", "bias_gain"), [(5.0, -96.0), (-5.0, 96.0), (0.1, 0.0)])
def test_the_bias_of_the_pipeline_counts_neither_for_nor_against_an_effect(steps, bias_gain, monkeypatch):
    """A bias gradient of 10 raises the squares of an effect of the same sign by 2 x 10 per step. With an information of
    25 it has a gain of 4 alone."""
    equations = SimpleNamespace(samples=np.full(10, 50.0), information=np.full((10, 1, 1), 2.5))
    monkeypatch.setattr(model_comparison.gauss_newton, "normal_equations_at", lambda *_: equations)
    mass = next(one for one in catalogue.catalogue(VEHICLE) if one.key == "mass")
    null = SimpleNamespace(slices={"mass": slice(0, 1)}, bias_gradient=np.array([1.0]))
    values = {"mass": file_values(mass, VEHICLE) + steps * sensitivity.parameter_steps((mass,))}
    gains = model_comparison._bias_gains(SimpleNamespace(null_distribution=null), VEHICLE, [mass], values)
    assert gains == pytest.approx((bias_gain, 4.0))
