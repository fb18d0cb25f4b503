"""What the repaired vehicle file gets of a pack whose plug opens with the current, from a second implementation."""

from functools import cache

import jax
import numpy as np
import pytest
from motor_log import VEHICLE, log

from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect, Unexplained
from swift_sim_bridge.gap.attribution.gauss_newton import gauss_newton_fit, with_effects
from swift_sim_bridge.gap.discovery.polynomial_search import Found, equation_effects
from swift_sim_bridge.gap.pipeline import prepare, references
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.residuals.channels import VOLTAGE
from swift_sim_bridge.gap.residuals.propulsion import MAX_ABOVE_FULL_V, voltage_above_full
from swift_sim_bridge.gap.validation import repair_choice, repair_trials
from swift_sim_bridge.physics.terms.quantities import Load, product_of

PLUG = 6e-5  # ohm/A^2
SEED = 4


@cache
def evidence() -> Evidence:
    """Return the evidence of a log in which the pack loses PLUG times the cube of the current, beside its own sag."""
    current = log(SEED)["current"].values
    with jax.enable_x64(True), pytest.MonkeyPatch.context() as patched:
        patched.setattr(references, "REFERENCE_FLIGHTS", 6)
        table = log(SEED, resistance=0.012 + PLUG * current**2)
        return prepare.prepare_evidence([table], VEHICLE, Options(lambda text: None))


def sag() -> SelectedEffect:
    """Return the sag that imitates it, fitted to the log."""
    (effect,) = (one for one in evidence().effects if one.id == "battery_sag")
    values, covariance = gauss_newton_fit(evidence(), VEHICLE, [effect], {})
    return SelectedEffect(effect, values[effect.key], covariance[effect.key], 50.0)


def repair(*unexplained: Unexplained) -> repair_choice.Repair:
    """Return the repair where a search has found the sag, and left this unexplained."""
    found = SearchResult((sag(),), (), evidence(), unexplained=unexplained)
    return repair_choice.choose_repair(VEHICLE, found, lambda text: None)


def test_a_sag_that_needs_a_pack_fuller_than_full_gives_way_to_a_product_of_the_current():
    (channel,) = (one for one in evidence().residual_models[0].channels if one.quantity == VOLTAGE)
    recording = evidence().residual_models[0].recording
    with jax.enable_x64(True):
        named = with_effects(VEHICLE, [sag().effect], {sag().effect.key: sag().values})
        assert voltage_above_full(recording, VEHICLE) < 0.0 < MAX_ABOVE_FULL_V < voltage_above_full(recording, named)
        chosen = repair(Unexplained(channel, 0.1, 9.0, ""))
        assert not chosen.names and [one.effect.id for one in chosen.left_out] == ["battery_sag"]
        effects = [one.effect for one in chosen.equation]
        flown = with_effects(VEHICLE, effects, {one.effect.key: one.values for one in chosen.equation})
        assert voltage_above_full(recording, flown) < MAX_ABOVE_FULL_V
    (parameter,) = effects[0].parameters
    product, (coefficient,) = parameter.name.removeprefix("voltage: "), chosen.equation[0].values
    drawn = np.quantile(recording.current, 0.9)
    at = product_of(product, "supply").value(Load(drawn, 0.0, ()))
    assert "current" in product and coefficient * at == pytest.approx(-PLUG * drawn**3, rel=0.2)


def test_summands_that_were_chosen_stay_however_many_others_remove_more(monkeypatch):
    known = Found("voltage", "current", (0.0, 80.0), 0.1)
    others = [Found("voltage", f"current^{k}", (0.0, 80.0), 0.9) for k in range(2, 12)]
    monkeypatch.setattr(repair_trials.polynomial_search, "search", lambda *_: [*others, known])
    (channel,) = (one for one in evidence().residual_models[0].channels if one.quantity == VOLTAGE)
    found = SearchResult((), (), evidence(), unexplained=(Unexplained(channel, 0.1, 9.0, ""),))
    judge = repair_trials.Judge(evidence(), VEHICLE, found)
    with jax.enable_x64(True):
        chosen = judge._summands(judge.trial(()), 0.7, (known,))
    assert chosen == [known, *others[: repair_trials.MAX_SUMMANDS - 1]]


def test_a_sag_stays_where_nothing_is_unexplained():
    with jax.enable_x64(True):
        chosen = repair()
    assert [one.effect.id for one in chosen.names] == ["battery_sag"] and not chosen.equation
    assert np.isfinite(chosen.names[0].values).all()


def test_a_summand_that_is_zero_within_its_error_leaves_the_repair_for_good(monkeypatch):
    """Beside the cube of the current, which the plug takes, the charge explains nothing; it is tried all the same."""
    true, idle = Found("voltage", "current^3", (0.0, 6e5), 0.9), Found("voltage", "charge", (0.0, 2e3), 0.1)
    monkeypatch.setattr(repair_trials.polynomial_search, "search", lambda *_: [true, idle])
    (channel,) = (one for one in evidence().residual_models[0].channels if one.quantity == VOLTAGE)
    found = SearchResult((), (), evidence(), unexplained=(Unexplained(channel, 0.1, 9.0, ""),))
    with jax.enable_x64(True):
        judge = repair_trials.Judge(evidence(), VEHICLE, found)
        trial = judge.trial((), equation_effects(VEHICLE, [true, idle]), (true, idle))
        chosen = repair_choice._on_whole_flights(judge, trial, (), ())
    (equation,) = chosen.equation
    (name,) = (one.name for one in equation.effect.parameters)
    assert name == true.name
    assert equation.values == pytest.approx([-PLUG], rel=0.2)
