"""The likeliest of the effects that a recording cannot distinguish stands for all of them.

The search selects by gain and number of parameters. Between small effects the number of parameters decides nothing (see
`inference.confounders`), and another effect of the set may be likelier than the one that was selected.
"""

from dataclasses import replace

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import (
    gauss_newton_fit,
    residuals_at,
    selection_problem_at,
    with_effects,
)
from swift_sim_bridge.gap.attribution.model_comparison import MIN_IMPROVEMENT, is_physical, normalised_squares
from swift_sim_bridge.gap.attribution.search import beyond_rows, widened_covariance
from swift_sim_bridge.gap.attribution.stepwise_search import other_variants
from swift_sim_bridge.gap.attribution.used_pack import used_pack
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.confounders import MIN_CONFOUNDER_WEIGHT
from swift_sim_bridge.gap.inference.marginal import rivals_beside
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps


def with_likeliest_first(found: SearchResult, vehicle: Vehicle, progress) -> SearchResult:
    """Return the result of a search in which each ambiguous effect is the likeliest one of its set.

    Args:
        found: the result, with the evidence after the search.
        vehicle: the vehicle with the terms of all effects.
        progress: called with a line of text.
    """
    selected = found.selected
    for key in [one.effect.key for one in selected]:
        one = next(one for one in selected if one.effect.key == key)
        rest = tuple(other for other in selected if other is not one)
        one = one.without_confounders({other.effect.key for other in (*rest, *found.withdrawn)})
        selected = (one, *rest)
        while one.likeliest != one.effect.key:
            headed = _headed(found.evidence, vehicle, selected, one)
            if headed:
                progress(f"{one.likeliest}: likelier than {key}, from which these recordings do not distinguish it")
                selected = headed
                break
            one = one.without_confounders({one.likeliest})
            selected = (one, *rest)
    return replace(found, selected=tuple(sorted(selected, key=lambda one: -one.significance)))


def _headed(
    evidence: Evidence, vehicle: Vehicle, selected: tuple[SelectedEffect, ...], one: SelectedEffect
) -> tuple[SelectedEffect, ...]:
    """Return the selected effects with the likeliest effect of a set in place of `one`, all fitted together.

    Empty if it is no explanation after all: weights hold to first order, and in the simulation it may be unphysical,
    clearly worse, or smaller than what the rows of the recordings leave open.
    """
    effects, key = {effect.key: effect for effect in evidence.effects}, one.likeliest
    fixed = [other for other in selected if other.effect.id == "gust"]  # random: no fit estimates it
    fitted = {other.effect.key: other for other in selected if other not in fixed}
    initial = {other.effect.key: other.values for other in fitted.values()}
    before = _squares(evidence, vehicle, initial)
    initial = {**initial, key: file_values(effects[key], vehicle) + one.changes[key]}
    del initial[one.effect.key]
    values, covariance = gauss_newton_fit(evidence, vehicle, [effects[other] for other in initial], initial)
    if (
        not is_physical(evidence, effects[key], values)
        or _squares(evidence, vehicle, values) > before + MIN_IMPROVEMENT
    ):
        return ()
    problem = selection_problem_at(evidence, vehicle, effects, list(values), values)
    unlikely = {other for other, weight in one.confounders.items() if weight < MIN_CONFOUNDER_WEIGHT}
    unlikely -= {one.effect.key}  # in the simulation it explains as much as the likeliest one
    head = replace(
        one,
        effect=effects[key],
        values=values[key],
        covariance=widened_covariance(evidence, problem, effects[key], values, covariance),
        significance=stepwise.accepts(problem, [other for other in values if other != key], key)[1],
        changes={**one.changes, key: values[key] - file_values(effects[key], vehicle)},
        is_certain=False,
        beside=used_pack(evidence, vehicle, [effects[other] for other in values], values, covariance)[key]
        + rivals_beside(
            problem, list(values), key, other_variants(list(values), effects), parameter_steps((effects[key],))
        ),
    ).without_confounders(unlikely)
    if not (heads := beyond_rows(evidence, vehicle, [head])):
        return ()
    others = (replace(other, values=values[other.effect.key]) for other in fitted.values() if other is not one)
    return (*heads, *others, *fixed)


def _squares(evidence: Evidence, vehicle: Vehicle, values: dict) -> float:
    """Return the squares that effects with these values, by key, leave in the simulation."""
    effects = [effect for effect in evidence.effects if effect.key in values]
    return normalised_squares(evidence, residuals_at(evidence, with_effects(vehicle, effects, values)))
