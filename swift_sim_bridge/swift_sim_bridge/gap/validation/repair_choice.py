"""What the repaired vehicle file gets, judged on a part of each flight that no fit between which it chooses has used.

A name stays unless the unseen part gets better without it, whatever an equation explains of the whole flight. An
equation of what the names leave joins them if it makes the unseen part better. Names that stand beside something
unexplained must predict fast flight from slow flight, too. The last part of each flight, on which
the repair is reported, has no part in this.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import gauss_newton_fit
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.validation.repair_trials import SIMILAR, Judge, Trial, kinds_without_name

MIN_ERRORS = 2.0  # standard errors of a summand's coefficient below which it leaves the repair
CLEARLY_BETTER = 0.5  # of `error_beyond`: by which names beside something unexplained must predict fast flight better


@dataclass(frozen=True)
class Repair:
    """The repair of a vehicle.

    Attributes:
        names: the named effects, with their values from the whole flights.
        left_out: named effects without which the unseen part is better.
        equation: effects of the equation's summands, with their values; empty without an equation.
        shares: by name of a new summand, the share of the squares of its left side's error that it removes.
    """

    names: tuple[SelectedEffect, ...] = ()
    left_out: tuple[SelectedEffect, ...] = ()
    equation: tuple[SelectedEffect, ...] = ()
    shares: dict[str, float] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[SelectedEffect, ...]:
        """All effects of the repair."""
        return (*self.names, *self.equation)


def choose_repair(vehicle: Vehicle, found: SearchResult, progress) -> Repair:
    """Return the names and the equation that make the unseen parts of the flights better.

    Args:
        vehicle: the vehicle of the file.
        found: what the search has found, with the names that it gave up for an equation.
        progress: called with a line of text.
    """
    fixed = tuple(one for one in found.selected if one.effect.id == "gust")  # random: no fit estimates it
    selected = tuple(one for one in found.selected if one.effect.id != "gust")
    all_names = (*selected, *found.withdrawn)
    if not all_names and not kinds_without_name(found):
        return Repair(fixed)
    judge = Judge(found.evidence, with_effect_terms(vehicle, tuple(one.effect for one in all_names)), found)
    trials = [judge.best_of(all_names)]
    if found.withdrawn:
        trials.append(judge.best_of(selected))
    layers = {one.channel.layer for one in found.unexplained}
    if doubtful := {one.effect.key for one in all_names if one.effect.layer in layers}:
        trials.append(judge.best_of(tuple(one for one in all_names if one.effect.key not in doubtful)))
    best = min(trials, key=lambda one: one.error)
    # Of names and the equation that replaces them, which are similar, the one with fewer numbers, or else the names.
    best = min((one for one in trials if one.error < best.error + SIMILAR), key=lambda one: one.numbers)
    fewer = [one for one in trials if set(one.names) < set(best.names)]
    if fewer:  # names that stand beside something unexplained may resemble it only as far as this flight went
        other, error = min(((one, judge.error_beyond(one)) for one in fewer), key=lambda pair: pair[1])
        best = best if judge.error_beyond(best) < error - CLEARLY_BETTER else other
    kept = {effect.key for effect in best.names}
    for one in all_names:
        if one.effect.key not in kept:
            progress(f"{one.effect.key}: not in the repair, unseen or faster parts of the flight are better without it")
    if kinds_without_name(found):
        best = judge.with_more_summands(best)
    return _on_whole_flights(judge, best, all_names, fixed)


def _on_whole_flights(
    judge: Judge, trial: Trial, names: tuple[SelectedEffect, ...], fixed, refused: frozenset[str] = frozenset()
) -> Repair:
    """Return the repair of a trial with the values of the whole flights.

    Others join in the place of summands whose coefficient differs from one half of the flights to the other. None joins
    in the place of one that is zero within its error beside the rest of the repair.
    """
    kept = [one for one in names if one.effect in trial.names]
    left_out = tuple(one for one in names if one.effect not in trial.names)
    if not trial.equation and not left_out and not judge.found.withdrawn:
        return Repair((*kept, *fixed))
    effects = [*trial.names, *trial.equation]
    if not effects:
        return Repair(fixed, left_out)
    values, covariance = gauss_newton_fit(judge.evidence, judge.vehicle, effects, trial.values)
    whole = replace(trial, values=values)
    if unstable := judge.disagreeing(whole, 1.0) if trial.equation else set():
        stable, refused = trial, refused | unstable
        for item in unstable:
            stable = judge.without(stable, item)
        return _on_whole_flights(judge, judge.with_more_summands(stable, refused), names, fixed, refused)
    if weakest := _weakest(whole, covariance):
        return _on_whole_flights(judge, judge.without(trial, weakest), names, fixed, refused | {weakest})
    idle = [one for one in kept if np.array_equal(values[one.effect.key], file_values(one.effect, judge.vehicle))]
    if idle:
        # At a bound, beside what else is in the repair: nothing of it is left to repair.
        kept, left_out = [one for one in kept if one not in idle], (*left_out, *idle)
    if trial.equation:
        whole = judge.with_tested_ranges(whole)
    refitted = (one.fitted_again(values[one.effect.key], covariance[one.effect.key]) for one in kept)
    summands = (SelectedEffect(one, values[one.key], covariance[one.key], 0.0) for one in whole.equation)
    shares = {one.name: one.removed_share for one in trial.found}
    return Repair((*refitted, *fixed), left_out, tuple(summands), shares)


def _weakest(trial: Trial, covariance) -> str | None:
    """Return the new summand whose coefficient is the fewest standard errors, if these are less than MIN_ERRORS."""
    new, sizes = {one.name for one in trial.found}, {}
    for effect in trial.equation:
        errors = np.sqrt(np.diag(covariance[effect.key]))
        sizes |= dict(
            zip((one.name for one in effect.parameters), np.abs(trial.values[effect.key]) / errors, strict=True)
        )
    weak = {name: size for name, size in sizes.items() if name in new and not size >= MIN_ERRORS}  # or not a number
    return min(weak, key=weak.__getitem__, default=None)


def reported(found: SearchResult, chosen: Repair) -> SearchResult:
    """Return the result of a search with the effects that are reported.

    Names that an equation replaced stay, tentative, if the repair has them; a name without which the unseen part is
    better is tentative, too.
    """
    in_repair = {one.effect.key: one for one in chosen.names}
    selected = tuple(in_repair.get(one.effect.key) or replace(one, is_certain=False) for one in found.selected)
    withdrawn = tuple(in_repair[one.effect.key] for one in found.withdrawn if one.effect.key in in_repair)
    return replace(found, selected=(*selected, *withdrawn))
