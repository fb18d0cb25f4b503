"""Search for the effects that the evidence calls for, and for the equation of what they leave."""

from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import (
    gauss_newton_fit,
    residuals_at,
    selection_problem_at,
    with_effects,
)
from swift_sim_bridge.gap.attribution.model_comparison import Explanation
from swift_sim_bridge.gap.attribution.payload import select_payload
from swift_sim_bridge.gap.attribution.process_noise import with_recorded_noise
from swift_sim_bridge.gap.attribution.stepwise_search import other_variants, problem_without_variants, select_stepwise
from swift_sim_bridge.gap.attribution.unexplained import unexplained_channels
from swift_sim_bridge.gap.attribution.used_pack import is_of_used_pack, used_pack
from swift_sim_bridge.gap.attribution.wind import may_be_thrust, select_local_wind
from swift_sim_bridge.gap.discovery import feature_library
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.confounders import find_confounders, is_large
from swift_sim_bridge.gap.inference.marginal import rivals_beside
from swift_sim_bridge.gap.inference.row_sampling import row_bounds
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps
from swift_sim_bridge.gap.inference.stepwise import SelectionProblem
from swift_sim_bridge.gap.recording import command_link
from swift_sim_bridge.gap.residuals.channels import VOLTAGE
from swift_sim_bridge.gap.residuals.propulsion import excess_above_full


def select_effects(evidence: Evidence, vehicle: Vehicle, progress) -> SearchResult:
    """Return the effects that explain the recordings better than an equation, and the equation of what they leave.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        progress: called with a line of text.
    """
    if not evidence.effects:
        return SearchResult((), (), evidence)
    keys, values = select_stepwise(evidence, vehicle, *_started(evidence, vehicle), progress)
    with_noise = with_recorded_noise(evidence, vehicle, keys, values)
    if with_noise is not evidence:
        evidence = with_noise
        keys, values = select_stepwise(evidence, vehicle, *pruned(evidence, vehicle, keys, values), progress)
    evidence, keys, values = select_local_wind(evidence, vehicle, keys, values, progress)
    evidence, keys, values = select_payload(evidence, vehicle, keys, values, progress)
    evidence = _with_local_features(evidence, vehicle, keys, values)
    called_for = {key: values[key] for key in model_comparison.physical_keys(evidence, keys, values)}
    explanation = model_comparison.best_explanation(evidence, vehicle, keys, values, progress)
    if len(explanation.keys) < len(keys):  # an effect beside a rejected one may be a consequence of it
        keys, values = pruned(evidence, vehicle, list(explanation.keys), explanation.values)
        explanation = model_comparison.best_explanation(evidence, vehicle, keys, values, progress)
    selected = described(evidence, vehicle, explanation) if explanation.keys else []
    selected = beyond_rows(evidence, vehicle, selected)
    left = unexplained_channels(evidence, residuals_at(evidence, vehicle), explanation.residuals)
    doubtful = {one.channel.layer for one in left}  # an effect there may stand for a part of what is left
    no_pack = _needs_fuller_pack(evidence, vehicle, selected)
    selected = [
        replace(one, is_certain=False) if one.effect.layer in doubtful or (no_pack and _is_of_pack(one.effect)) else one
        for one in selected
    ]
    return SearchResult(
        selected=tuple(sorted(selected, key=lambda one: -one.significance)),
        equation_terms=explanation.terms,
        evidence=evidence,
        withdrawn=_withdrawn(evidence, vehicle, called_for, explanation.keys),
        unexplained=left,
    )


def _needs_fuller_pack(evidence: Evidence, vehicle: Vehicle, selected: list[SelectedEffect]) -> bool:
    """Return whether the vehicle with these effects gives a measured voltage only from a pack fuller than full.

    Its sag is then too steep: a plug that opens with the load, for example, takes more the larger the current.
    """
    effects = [one.effect for one in selected]
    if not any(map(_is_of_pack, effects)):
        return False
    repaired = with_effects(vehicle, effects, {one.effect.key: one.values for one in selected})
    return any(
        excess_above_full(one.recording, repaired, vehicle) > 0.0
        for one in evidence.residual_models
        if any(channel.quantity == VOLTAGE for channel in one.channels)
    )


def _is_of_pack(effect: Effect) -> bool:
    return any(parameter.path[0] == "battery" for parameter in effect.parameters)


def _started(evidence: Evidence, vehicle: Vehicle) -> tuple[list[str], dict]:
    """Return the effects with which the search starts, and their values, fitted together."""
    effects = [effect for effect in evidence.effects if effect.key in evidence.start]
    if not effects:
        return [], {}
    return [effect.key for effect in effects], gauss_newton_fit(evidence, vehicle, effects, evidence.start)[0]


def _withdrawn(evidence: Evidence, vehicle: Vehicle, called_for: dict, kept) -> tuple[SelectedEffect, ...]:
    """Return the effects that the evidence calls for and that are not kept, with their values beside all others."""
    if not set(called_for) - set(kept):
        return ()
    effects = {effect.key: effect for effect in evidence.effects}
    keys = list(called_for)
    values, covariance = gauss_newton_fit(evidence, vehicle, [effects[key] for key in keys], called_for)
    problem = selection_problem_at(evidence, vehicle, effects, keys, values)
    found = []
    for key in (key for key in keys if key not in kept):
        _, significance = stepwise.accepts(problem, [other for other in keys if other != key], key)
        found.append(SelectedEffect(effects[key], values[key], covariance[key], significance, is_certain=False))
    return tuple(sorted(found, key=lambda one: -one.significance))


def beyond_rows(evidence: Evidence, vehicle: Vehicle, selected: list[SelectedEffect]) -> list[SelectedEffect]:
    """Return the effects without those that what the recordings leave open between two rows may cause.

    The interval of the others is as much wider.
    """
    bounds, found = [row_bounds(one.recording) for one in evidence.residual_models], []
    for one in selected:
        bound = np.max([each.get(one.effect.id, np.zeros(len(one.values))) for each in bounds], axis=0)
        others = [other for other in selected if other is not one]  # of the motors' lags one follows the other
        beside = with_effects(
            vehicle, [other.effect for other in others], {other.effect.key: other.values for other in others}
        )
        if bound.any() and np.all(np.abs(one.values - file_values(one.effect, beside)) < bound):
            continue
        covariance = one.covariance + np.diag(bound**2 / 3.0)  # of a uniform distribution
        found.append(replace(one, covariance=covariance))
    return found


def described(evidence: Evidence, vehicle: Vehicle, explanation: Explanation) -> list[SelectedEffect]:
    """Return the effects of an explanation with their covariances, significances and confounders."""
    effects = {effect.key: effect for effect in evidence.effects}
    keys, values = list(explanation.keys), explanation.values
    problem = selection_problem_at(evidence, vehicle, effects, keys, values)
    bare = problem_without_variants(evidence, vehicle, effects, keys, values) or problem
    _, covariance = gauss_newton_fit(evidence, vehicle, [effects[key] for key in keys], values)
    lower_pack = used_pack(evidence, vehicle, [effects[key] for key in keys], values, covariance)
    driven = any(one.recording.driven for one in evidence.residual_models)
    found = []
    for key in keys:
        others, effect = [other for other in keys if other != key], effects[key]
        change = values[key] - file_values(effect, vehicle)
        if is_of_used_pack(change, covariance[key], lower_pack[key]):
            continue
        _, significance = stepwise.accepts(problem, others, key)
        own = bare if effect.exclusive else problem
        # without rotor speeds thrust, motors and pack act through the same modelled ones: parameters decide less
        variants, is_vector = other_variants(others, effects), len({one.unit for one in effect.parameters}) == 1
        confounders = find_confounders(own, keys, key, variants, all_count=not driven, is_vector=is_vector)
        changes = changes_of(own, others, confounders, effects) | {key: change}
        few = len(keys) < model_comparison.MIN_UNCERTAIN_COUNT
        certain = few and key not in explanation.uncertain and not explanation.terms
        if effect.id in model_comparison.LOCATED_EFFECTS:  # crossed once, neither it nor its place may be known
            certain = certain and model_comparison.changed_count(effect, vehicle, values, covariance) > 0
        if effect.id == "local_draught" and certain:
            certain = not may_be_thrust(evidence, vehicle, [effects[one] for one in keys], values)
        beside = rivals_beside(problem, keys, key, other_variants(keys, effects), parameter_steps((effect,)))
        one = SelectedEffect(
            effect=effect,
            values=values[key],
            covariance=widened_covariance(evidence, problem, effect, values, covariance),
            significance=significance,
            confounders=confounders,
            changes=changes,
            beside=lower_pack[key] + beside,
        )
        shown = np.any(one.excludes_file(evidence.seconds) & ~model_comparison.places(effect))
        found.append(replace(one, is_certain=bool(certain and shown and is_large(problem, others, key))))
    return found


def _with_local_features(evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict) -> Evidence:
    """Return the evidence with features of a force at one place, if the residuals of these effects call for it.

    A local draught does not count: an equation must be able to explain in its place what acts there.
    """
    effects = [effect for effect in evidence.effects if effect.key in keys and effect.id != "local_draught"]
    lines = residuals_at(evidence, with_effects(vehicle, effects, values))
    library = feature_library.with_local_features(evidence.library, evidence.residual_models, lines, evidence.sigmas)
    return replace(evidence, library=library)


def widened_covariance(
    evidence: Evidence, problem: SelectionProblem, effect: Effect, values: dict, covariance: dict
) -> np.ndarray:
    """Return the covariance (k, k) of one of several effects, with what the seconds of a flight do not show.

    Args:
        evidence: the recordings.
        problem: the selection problem about the vehicle with the effects.
        effect: the effect.
        values: values of the effects, by key.
        covariance: their covariances from the fit, by key.
    """
    own, links = covariance[effect.key], [one.recording.command_link for one in evidence.residual_models]
    if effect.layer == "camera" or "rate_loop" in effect.channels:
        # errors that last longer than a second: a detector's bias in a view, the frequency of a rate loop
        own = inflated_covariance(problem, list(values), effect)
    if effect.layer == "command" and all(links):
        own = own.copy()
        own[0, 0] += command_link.chance_variance(effect.id, values[effect.key], links)
    return own


def inflated_covariance(problem: SelectionProblem, keys: list[str], effect: Effect) -> np.ndarray:
    """Return the covariance (k, k) of one of several effects, with the variance inflation of the reference flights."""
    rows, own, size = problem.rows(keys), problem.slices[effect.key], parameter_steps((effect,))
    inside = (rows >= own.start) & (rows < own.stop)
    inflation = problem.null_distribution.variance_inflation(effect.key)
    covariance = stepwise.fit(problem.uncorrected, rows, inflation).covariance
    return covariance[np.ix_(inside, inside)] * np.outer(size, size)


def changes_of(problem: SelectionProblem, others: list[str], keys, effects) -> dict:
    """Return, by key, the change (k,) that each of several effects would have in its parameters, beside others."""
    found = {}
    for key in keys:
        size = problem.parameter_count(key)
        fitted = stepwise.fit(problem.equations, problem.rows([*others, key]))
        found[key] = fitted.estimate[-size:] * parameter_steps((effects[key],))
    return found


def pruned(evidence: Evidence, vehicle: Vehicle, keys, values) -> tuple[list[str], dict]:
    """Return the selected effects that the evidence still calls for, and their values."""
    effects = {effect.key: effect for effect in evidence.effects}
    if not keys:
        return keys, values
    problem = selection_problem_at(evidence, vehicle, effects, keys, values)
    kept = stepwise.backward_elimination(problem, keys)
    kept = [key for key in kept if len(keys) > 1 or stepwise.accepts(problem, [], key)[0]]
    values = {key: values[key] for key in kept}
    return kept, gauss_newton_fit(evidence, vehicle, [effects[key] for key in kept], values)[0] if kept else {}
