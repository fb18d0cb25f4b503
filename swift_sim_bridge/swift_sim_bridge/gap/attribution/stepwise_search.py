"""The stepwise search for effects, with a joint fit through the simulator after each step."""

from typing import NamedTuple

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.attribution.gauss_newton import gauss_newton_fit, selection_problem_at
from swift_sim_bridge.gap.inference import confounders, stepwise
from swift_sim_bridge.gap.inference.stepwise import SelectionProblem

MAX_RIVALS = 2  # effects that explain nearly as much to first order as the best, which the simulation compares with it
MAX_ROUNDS = 8  # additions and replacements of effects; bounds the time of the search


def select_stepwise(evidence: Evidence, vehicle: Vehicle, keys, values, progress) -> tuple[list[str], dict]:
    """Add effects to those selected, one after the other, with a joint fit after each.

    If none can be added, one is replaced by a better one, or two by a simpler one. Superfluous ones are removed.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        keys: effects that are selected already.
        values: their values, by key.
        progress: called with a line of text.

    Returns:
        The selected effects and their values.
    """
    effects = {effect.key: effect for effect in evidence.effects}
    dropped: set[str] = set()
    tried: set[frozenset] = set()
    now = _Selected(list(keys), values, selection_problem_at(evidence, vehicle, effects, keys, values))
    for _ in range(MAX_ROUNDS):
        base = now
        key, sigma = stepwise.best_addition(now.problem, now.keys, other_variants(now.keys, effects) | dropped)
        if key is None:
            old, key = _replacement(evidence, vehicle, *now)
            if key is None or frozenset(now.keys) in tried:
                break
            replaced = [one for one in now.keys if one not in old] + [key]
            before, after = (_left_in_simulation(evidence, vehicle, one, now.values) for one in (now.keys, replaced))
            # What is better to first order alone replaces no effect; one in place of two may leave a little more.
            if after > before + (model_comparison.MIN_IMPROVEMENT if len(old) > 1 else 0.0):
                break
            progress(f"{key} replaces {', '.join(old)}")
            tried.add(frozenset(now.keys))
            now, base = _fitted(evidence, vehicle, replaced, now.values), None
        else:
            rivals = _rivals(now.problem, now.keys, key, other_variants(now.keys, effects) | dropped)
            key = _best_in_simulation(evidence, vehicle, now.keys, now.values, [key, *rivals])
            progress(f"{key}: {sigma:.1f} standard deviations")
            now = _fitted(evidence, vehicle, [*now.keys, key], now.values)
        kept = stepwise.backward_elimination(now.problem, now.keys)
        if len(kept) < len(now.keys):
            removed = set(now.keys) - set(kept)
            fewer = _fitted(evidence, vehicle, kept, now.values)
            if base and removed - {key}:
                fewer = _least_left(evidence, vehicle, base, now, fewer)
                removed = set(now.keys) - set(fewer.keys)
            if removed:
                progress(f"{', '.join(removed)}: superfluous now")
            dropped |= removed if key in removed else set()
            now = fewer
    return now.keys, now.values


class _Selected(NamedTuple):
    """Effects that are selected.

    Attributes:
        keys: the effects.
        values: their values, fitted together, by key.
        problem: the selection problem about the vehicle with them.
    """

    keys: list[str]
    values: dict
    problem: SelectionProblem


def _fitted(evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict) -> _Selected:
    """Return effects, fitted together from their values or those of the vehicle."""
    effects = {effect.key: effect for effect in evidence.effects}
    initial = {key: values[key] for key in keys if key in values}
    found, _ = gauss_newton_fit(evidence, vehicle, [effects[key] for key in keys], initial)
    return _Selected(keys, found, selection_problem_at(evidence, vehicle, effects, keys, found))


def _least_left(
    evidence: Evidence, vehicle: Vehicle, before: _Selected, added: _Selected, fewer: _Selected
) -> _Selected:
    """Return which of three selections to go on with, where an addition makes earlier effects superfluous.

    To first order it may only seem so: a parameter that is far from the file's is not where its tangent says, and
    the whole effect is refused with it. Then the simulation is worse with fewer effects than before the addition, and
    nothing is removed.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        before: without the addition.
        added: with the addition.
        fewer: with the addition, without what seems superfluous.
    """
    left = []
    for one in (before, added, fewer):
        effects = [effect for effect in evidence.effects if effect.key in one.keys]
        left.append(model_comparison.penalised_squares(evidence, vehicle, effects, one.values))
    if left[2] < left[0] + model_comparison.MIN_IMPROVEMENT:
        return fewer
    return added if left[1] + model_comparison.MIN_IMPROVEMENT < left[0] else before


def _rivals(problem: SelectionProblem, keys: list[str], key: str, excluded: set[str]) -> list[str]:
    """Return the effects that explain nearly as much to first order as the one that explains most.

    Args:
        problem: the selection problem about the vehicle with the selected effects.
        keys: effects that are selected already.
        key: the effect that explains most.
        excluded: effects that cannot be added, or were superfluous as soon as they were.
    """
    base, others = problem.gain(keys), set(problem.slices) - {*keys, key} - excluded
    gains = {other: problem.gain([*keys, other]) - base for other in (key, *others)}
    least = (1.0 - confounders.MAX_CONFOUNDER_LOSS) * gains[key]
    similar = sorted((other for other in others if gains[other] > least), key=gains.__getitem__)
    return [other for other in similar[::-1] if stepwise.accepts(problem, keys, other)[0]][:MAX_RIVALS]


def _best_in_simulation(
    evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, candidates: list[str]
) -> str:
    """Return the candidate that explains most in the simulation, the first one unless another is clearly better.

    To first order a strong effect may explain less than another that only looks like it.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        keys: effects that are selected already.
        values: values of the selected effects, by key.
        candidates: keys of effects, first the one that explains most to first order.
    """
    first, *rivals = candidates
    if not rivals:
        return first
    left = {one: _left_in_simulation(evidence, vehicle, [*keys, one], values) for one in candidates}
    best = min(left, key=left.__getitem__)
    return best if left[best] + model_comparison.MIN_IMPROVEMENT < left[first] else first


def _left_in_simulation(evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict) -> float:
    """Return the squares that effects leave in the simulation, fitted together, with their penalties.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        keys: the effects.
        values: their first values, by key; those of the vehicle where it has none.
    """
    effects = [effect for effect in evidence.effects if effect.key in keys]
    fitted, _ = gauss_newton_fit(evidence, vehicle, effects, values)
    return model_comparison.penalised_squares(evidence, vehicle, effects, fitted)


def _replacement(
    evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, problem: SelectionProblem
) -> tuple[list[str], str | None]:
    """Return the selected effects to remove and the one that replaces them; none and None if there is none."""
    effects = {effect.key: effect for effect in evidence.effects}
    problem = problem_without_variants(evidence, vehicle, effects, keys, values) or problem
    found = []
    for key in keys:
        others = [one for one in keys if one != key]
        candidate, lead = confounders.better_replacement(problem, others, key, other_variants(others, effects))
        found += [(lead, [key], candidate)] if candidate else []
    if found:
        return max(found)[1:]
    return confounders.simpler_replacement(problem, keys, lambda others: other_variants(others, effects))


def problem_without_variants(
    evidence: Evidence, vehicle: Vehicle, effects, keys: list[str], values: dict
) -> SelectionProblem | None:
    """Return the selection problem, linearised without the selected effects whose variants exclude each other.

    With one propeller damaged, the sensitivity to the damage of another one would contain the repair of the first. None
    if no such effect is selected.
    """
    kept = [key for key in keys if not effects[key].exclusive]
    if len(kept) == len(keys):
        return None
    return selection_problem_at(evidence, vehicle, effects, kept, {key: values[key] for key in kept})


def other_variants(keys: list[str], effects) -> set[str]:
    """Return the effects that cannot be added to the selected ones: other variants of the same effect."""
    ids = {effects[key].id for key in keys}
    return {key for key, effect in effects.items() if effect.exclusive and effect.id in ids}
