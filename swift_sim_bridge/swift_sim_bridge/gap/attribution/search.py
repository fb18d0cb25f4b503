"""Which names the evidence calls for, one after the other, and what an equation must say beside them."""

from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution import gauss_newton, model_comparison, payload, process_noise, wind
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import gauss_newton_fit
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps
from swift_sim_bridge.gap.recording import command_link

ROUNDS = 8
WEAK = 4.0  # times its threshold, a size twice what is detectable: a name that gains less is tentative


def select_effects(evidence: Evidence, vehicle: Vehicle, tell) -> SearchResult:
    """Return what the recordings call for: effects, as long as they are worth more than an equation, and what is left
    beside them. vehicle: with all effects' terms."""
    if not evidence.effects:
        return SearchResult((), (), evidence)
    keys, values = names(evidence, vehicle, [], {}, tell)
    with_noise_ratio = process_noise.with_recorded_noise(evidence, vehicle, keys, values)
    if with_noise_ratio is not evidence:
        evidence = with_noise_ratio
        keys, values = names(evidence, vehicle, *pruned(evidence, vehicle, keys, values), tell)
    evidence, keys, values = wind.with_draught(evidence, vehicle, keys, values, tell)
    evidence, keys, values = payload.with_payload(evidence, vehicle, keys, values, tell)
    evidence = _with_place(evidence, vehicle, keys, values)
    explanation = model_comparison.best_explanation(evidence, vehicle, keys, values, tell)
    if len(explanation.keys) < len(keys):  # what stood beside a wrong name may have been there because of it
        draught_gone = "local_draught" in keys and "local_draught" not in explanation.keys
        keys, values = pruned(evidence, vehicle, list(explanation.keys), explanation.values)
        if draught_gone:  # something pushes there all the same
            evidence = _with_place(evidence, vehicle, keys, values)
        explanation = model_comparison.best_explanation(evidence, vehicle, keys, values, tell)
    if not explanation.keys:
        return SearchResult((), explanation.terms, evidence)
    effects = {effect.key: effect for effect in evidence.effects}
    keys, values = list(explanation.keys), explanation.values
    scene = gauss_newton.selection_problem_at(evidence, vehicle, effects, keys, values)
    varied = _without_variants(evidence, vehicle, effects, keys, values, scene)
    _, covariance = gauss_newton_fit(evidence, vehicle, [effects[one] for one in keys], values)
    found = []
    for key in keys:
        others = [one for one in keys if one != key]
        _, sigma = stepwise.passes(scene, others, key)
        own = varied if effects[key].exclusive else scene
        alike = stepwise.find_confounders(own, keys, key, _excluded(others, effects))
        changes = changes_of(own, others, alike, effects) | {key: values[key] - file_values(effects[key], vehicle)}
        certain = (
            len(keys) < model_comparison.MIN_UNCERTAIN_COUNT
            and key not in explanation.doubtful
            and not explanation.terms
        )
        strong = scene.gain(keys) - scene.gain(others) > WEAK * evidence.null_distribution.threshold(key)
        if effects[key].layer == "camera" or "rate_loop" in effects[key].channels:
            # seconds scatter less than what lasts: a detector's bias in a view, how often a loop passes
            covariance[key] = widened(scene, keys, effects[key])
        lines = [one.recording.command_link for one in evidence.residual_models]
        if effects[key].layer == "command" and all(lines):
            covariance[key][0, 0] += command_link.chance_variance(effects[key].id, values[key], lines)
        found.append(
            SelectedEffect(effects[key], values[key], covariance[key], sigma, alike, changes, strong and certain)
        )
    return SearchResult(tuple(sorted(found, key=lambda one: -one.significance)), explanation.terms, evidence)


def _with_place(evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict) -> Evidence:
    """Return the evidence with the place among its features, if there is one, that what is left calls for."""
    effects = [effect for effect in evidence.effects if effect.key in keys]
    lines = gauss_newton.residuals_at(evidence, gauss_newton.with_effects(vehicle, effects, values))
    return replace(
        evidence,
        library=equation_search.with_local_features(evidence.library, evidence.residual_models, lines, evidence.sigmas),
    )


def widened(scene, keys: list[str], effect: Effect) -> np.ndarray:
    """Return the covariance (k, k) of one of several effects, at least as wide as twins scatter it."""
    rows, own, size = scene.rows(keys), scene.slices[effect.key], parameter_steps((effect,))
    inside = (rows >= own.start) & (rows < own.stop)
    wide = stepwise.fit(scene.whole, rows, scene.null_distribution.variance_inflation(effect.key)).covariance
    return wide[np.ix_(inside, inside)] * np.outer(size, size)


def changes_of(scene, others: list[str], alike, effects) -> dict:
    """Return by key what each of several effects would change of its parameters (k,) in the place of one."""
    found = {}
    for key in alike:
        size = scene.slices[key].stop - scene.slices[key].start
        fitted = stepwise.fit(scene.sums, scene.rows([*others, key]))
        found[key] = fitted.sizes[-size:] * parameter_steps((effects[key],))
    return found


def pruned(evidence: Evidence, vehicle: Vehicle, keys, values) -> tuple[list[str], dict]:
    """Return those of the names, with their values, that the evidence still calls for."""
    effects = {effect.key: effect for effect in evidence.effects}
    if not keys:
        return keys, values
    scene = gauss_newton.selection_problem_at(evidence, vehicle, effects, keys, values)
    kept = [key for key in stepwise.backward(scene, keys) if len(keys) > 1 or stepwise.passes(scene, [], key)[0]]
    values = {key: values[key] for key in kept}
    return kept, gauss_newton_fit(evidence, vehicle, [effects[key] for key in kept], values)[0] if kept else {}


def names(evidence: Evidence, vehicle: Vehicle, keys, values, tell) -> tuple[list[str], dict]:
    """Return the effects, by key, that the recordings call for one after the other beside `keys`, and their values."""
    effects = {effect.key: effect for effect in evidence.effects}
    keys = list(keys)
    dropped: set[str] = set()
    seen: set[frozenset] = set()
    scene = gauss_newton.selection_problem_at(evidence, vehicle, effects, keys, values)
    for _ in range(ROUNDS):
        key, sigma = stepwise.forward(scene, keys, _excluded(keys, effects) | dropped)
        if key is None:
            varied = _without_variants(evidence, vehicle, effects, keys, values, scene)
            old, key = _exchanged(varied, keys, effects)
            if key is None:
                old, key = stepwise.simpler(varied, keys, lambda others: _excluded(others, effects))
            if key is None or frozenset(keys) in seen:
                break
            tell(f"{key} in the place of {', '.join(old)}")
            seen.add(frozenset(keys))
            keys = [one for one in keys if one not in old]
        else:
            tell(f"{key}: {sigma:.1f} standard deviations")
        keys.append(key)
        values, _ = gauss_newton_fit(evidence, vehicle, [effects[one] for one in keys], values)
        scene = gauss_newton.selection_problem_at(evidence, vehicle, effects, keys, values)
        kept = stepwise.backward(scene, keys)
        if len(kept) < len(keys):
            gone = set(keys) - set(kept)
            tell(f"{', '.join(gone)}: superfluous now")
            dropped |= gone if key in gone else set()
            keys = kept
            values = {one: values[one] for one in kept}
            values, _ = gauss_newton_fit(evidence, vehicle, [effects[one] for one in keys], values)
            scene = gauss_newton.selection_problem_at(evidence, vehicle, effects, keys, values)
    return keys, values


def _exchanged(scene, keys: list[str], effects) -> tuple[list[str], str | None]:
    """Return which of the effects taken should give its place to which other, none and None where none should."""
    found = []
    for key in keys:
        others = [one for one in keys if one != key]
        rival, by = stepwise.better(scene, others, key, _excluded(others, effects))
        found += [(by, [key], rival)] if rival else []
    return max(found)[1:] if found else ([], None)


def _without_variants(evidence: Evidence, vehicle: Vehicle, effects, keys: list[str], values: dict, scene):
    """Return the scene with footprints as they are without those effects taken whose variants exclude each other: with
    one propeller damaged, the footprint of another's damage would be of the first one's mending as well."""
    kept = [key for key in keys if not effects[key].exclusive]
    if len(kept) == len(keys):
        return scene
    return gauss_newton.selection_problem_at(evidence, vehicle, effects, kept, {key: values[key] for key in kept})


def _excluded(keys: list[str], effects) -> set[str]:
    """Return the effects that cannot stand beside those taken: other variants of the same one."""
    ids = {effects[key].id for key in keys}
    return {key for key, effect in effects.items() if effect.exclusive and effect.id in ids}
