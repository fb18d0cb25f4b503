"""The judge of repairs: fits effects to the first part of each flight and judges them on the one that follows."""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import (
    gauss_newton_fit,
    normal_equations_at,
    residuals_at,
    with_effects,
)
from swift_sim_bridge.gap.discovery import extrapolation, polynomial_search
from swift_sim_bridge.gap.discovery.half_regression import ONE_HALF_SHARE
from swift_sim_bridge.gap.discovery.polynomial_search import Found, equation_effects
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, solve
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps
from swift_sim_bridge.gap.residuals.channels import (
    ACCELEROMETER,
    ANGULAR_ACCELERATION,
    ROTOR_SPEED,
    SPECIFIC_FORCE,
    VOLTAGE,
)
from swift_sim_bridge.gap.validation.parts import CHOICE_SHARE, TRAINING_SHARE, rows_by_pace, rows_of_choice
from swift_sim_bridge.gap.validation.trial import Trial
from swift_sim_bridge.gap.validation.unseen_errors import linear_problem, unseen_error
from swift_sim_bridge.physics.terms import equation

MAX_SUMMANDS = 8  # of an equation
# Differences of `unseen_error`, a sum of logarithms of the channels' errors.
MIN_BETTER = 0.005  # by which an equation must make the unseen part better
KINDS = {  # left sides of an equation that describe a channel, by its quantity
    SPECIFIC_FORCE: "force",
    ACCELEROMETER: "force",
    ANGULAR_ACCELERATION: "moment",
    ROTOR_SPEED: "rotor_speed",
    VOLTAGE: "voltage",
}
SIMILAR = 0.03  # within which the one with fewer numbers is better
MIN_WORSE = 1e-4  # by which a name or summand must make it worse to be left out
MAX_LINEAR_ERROR = 0.02  # of an error to first order
MAX_TRIED = 3  # names or summands that are left out in trials before the rest is taken to be needed
MAX_DISAGREEMENT = 0.5  # of the mean of two halves' coefficients, by which they may differ
MAX_FACTOR = 2.0  # by which a coefficient may change when further summands join
DISAGREEMENT_ERRORS = 3.0  # standard errors by which they may differ where that is more


@dataclass(frozen=True)
class Judge:
    """Fits effects to the first part of each flight and judges them on the rest.

    Attributes:
        evidence: the recordings.
        vehicle: the vehicle of the file, with the terms of all names.
        found: what the search has found.
    """

    evidence: Evidence
    vehicle: Vehicle
    found: SearchResult

    def trial(self, names, equation_effects=(), summands=(), initial=None) -> Trial:
        """Return the trial of some effects."""
        effects, values = [*names, *equation_effects], {}
        if effects:
            values, _ = gauss_newton_fit(self.evidence, self.vehicle, effects, initial or {}, CHOICE_SHARE)
        file = self.vehicle if "voltage" in kinds_without_name(self.found) else None
        error = unseen_error(self.evidence, with_effects(self.vehicle, effects, values), file)
        return Trial(tuple(names), tuple(equation_effects), tuple(summands), values, error)

    def best_of(self, names: tuple[SelectedEffect, ...]) -> Trial:
        """Return the best trial of these names: without those that make it worse, with an equation if that is better.

        Names are left out one after the other, the one first without which the unseen part is best.
        """
        initial = {one.effect.key: one.values for one in names}
        best = self._without_worse(self.trial([one.effect for one in names], initial=initial))
        if not kinds_without_name(self.found):
            return best
        with_equation = self._with_equation(best)
        if with_equation is best:
            return best
        with_equation = self._without_worse(with_equation)
        if best.error - with_equation.error >= MIN_BETTER:
            return with_equation
        found = self._not_shown(with_equation)
        return self._beside_names(best, found) if found else best

    def _not_shown(self, trial: Trial) -> list[Found]:
        """Return the summands that the judging part does not show, as at a place that it does not pass."""
        if not trial.found:
            return []
        effects, models = trial.effects, self.evidence.residual_models
        repaired = with_effects(self.vehicle, list(effects), trial.values)
        lines = self.evidence.cache.linearisations(models, repaired, effects, True)
        squares = np.zeros((2, lines[0].sensitivity.shape[0]))
        for one, line, sigma in zip(models, lines, self.evidence.sigmas, strict=True):
            for i, part in enumerate(rows_of_choice(one)):
                squares[i] += np.sum((line.sensitivity * (part[:, None] & one.measured) / sigma) ** 2, axis=(1, 2))
        names = [parameter.name for effect in effects for parameter in effect.parameters]
        shown = dict(zip(names, squares[1] > ONE_HALF_SHARE * squares[0], strict=True))
        return [one for one in trial.found if not shown[one.name]]

    def _without_worse(self, best: Trial) -> Trial:
        """Return a trial without the names and summands that make the unseen part worse.

        To first order it is known for each what the unseen part is without it; those that may be better are tried.
        """
        while best.names or best.equation:
            changes = self._changes_without(best)
            likely = sorted((one for one in changes if changes[one] < MAX_LINEAR_ERROR), key=changes.get)
            others = (self.without(best, item) for item in likely[:MAX_TRIED])
            other = next((one for one in others if one.error < best.error - MIN_WORSE), None)
            if other is None:
                return best
            best = other
        return best

    def without(self, trial: Trial, item: str) -> Trial:
        """Return the trial without one name, by its key, or without one summand, by its name."""
        names = [one for one in trial.names if one.key != item]
        found = [one for one in trial.found if one.name != item]
        effects = equation_effects(self.vehicle, found) if found else ()
        values = dict(trial.values)
        for effect in effects:
            values[effect.key] = np.array([trial.coefficients[parameter.name] for parameter in effect.parameters])
        return self.trial(names, effects, found, values)

    def _changes_without(self, trial: Trial) -> dict[str, float]:
        """Return what `unseen_error` grows by without each name, by key, and new summand, by name, to first order."""
        effects = trial.effects
        rows = [rows_of_choice(one) for one in self.evidence.residual_models]
        problem = linear_problem(self.evidence, self.vehicle, trial, rows)
        change = np.concatenate([file_values(one, self.vehicle) - trial.values[one.key] for one in effects])
        change = change / parameter_steps(effects)
        found, now = {}, problem.error(np.zeros(len(change)))
        for item, own in trial.items.items():
            others = np.setdiff1d(np.arange(len(change)), own)
            step = np.zeros(len(change))
            step[own] = change[own]
            right = problem.gradient[others] + problem.information[np.ix_(others, own)] @ change[own]
            step[others] = -solve(problem.information[np.ix_(others, others)], right)
            found[item] = problem.error(step) - now
        return found

    def error_beyond(self, trial: Trial) -> float:
        """Return the error of a trial where the flight is fast if its values are fitted where it is slow.

        To first order, and for the speeds of vehicle and rotors together, see `rows_by_pace`.
        """
        paces, total = [rows_by_pace(one) for one in self.evidence.residual_models], 0.0
        for name in set.intersection(*(set(one) for one in paces)):
            problem = linear_problem(self.evidence, self.vehicle, trial, [one[name] for one in paces])
            total += problem.error(-solve(problem.information, problem.gradient))
        return total

    def _with_equation(self, trial: Trial) -> Trial:
        """Return the trial with the equation of what its names leave, without summands that disagree; itself without.

        Force and moment may come from the rotors' thrusts, or not: the equation with fewer numbers is taken unless the
        other one makes the unseen part better.
        """
        plain = self._with_summands(trial, self._summands(trial, CHOICE_SHARE))
        if equation.AT_ROTORS not in kinds_without_name(self.found):
            return plain
        summands = self._summands(trial, CHOICE_SHARE, at_rotors=True)
        if all(one.side != equation.AT_ROTORS for one in summands):
            return plain
        found = [one for one in (plain, self._with_summands(trial, summands)) if one is not trial]
        least = min((one.error for one in found), default=0.0)
        similar = [one for one in found if one.error < least + SIMILAR]
        return min(similar, key=lambda one: (one.numbers, one.error), default=trial)

    def _with_summands(self, trial: Trial, found: list[Found]) -> Trial:
        """Return the trial with summands beside its names, without those that disagree; itself without any."""
        while found:
            new = self._beside_names(trial, found)
            unstable = self.disagreeing(new, CHOICE_SHARE)
            if not unstable:
                return new
            found = [one for one in found if one.name not in unstable]
        return trial

    def with_more_summands(self, trial: Trial, refused: frozenset[str] = frozenset()) -> Trial:
        """Return a trial with the summands that join those of its equation in all that fits use, none of the refused.

        The part from which the trial was chosen is short: of a weak cause it shows the strongest summand alone, and
        none of a place that is passed later. Where the others change its coefficient much, they cancel it and do not
        join. An equation that this part shows, but what follows refused, does not come back.
        """
        if not trial.found and self._summands(trial, CHOICE_SHARE):
            return trial
        at_rotors = not trial.found or any(one.side == equation.AT_ROTORS for one in trial.found)
        found = self._summands(trial, TRAINING_SHARE, trial.found, at_rotors, refused)
        if len(found) == len(trial.found):
            return trial
        more = self._beside_names(trial, found)
        before, after = trial.coefficients, more.coefficients
        factors = [after[one.name] / before[one.name] for one in trial.found if before[one.name]]
        return more if all(1.0 / MAX_FACTOR < factor < MAX_FACTOR for factor in factors) else trial

    def _summands(
        self,
        trial: Trial,
        share: float,
        known: tuple[Found, ...] = (),
        at_rotors: bool = False,
        refused: frozenset[str] = frozenset(),
    ) -> list[Found]:
        """Return the summands of what the names of a trial leave of a share of each flight, those known first."""
        repaired = with_effects(self.vehicle, list(trial.names), trial.values)
        kinds = kinds_without_name(self.found)
        found = polynomial_search.search(self._residuals(repaired), repaired, share, known, at_rotors, refused)
        new = [one for one in found if equation.kind_of(one.side) in kinds and one not in known]
        return [*known, *new][:MAX_SUMMANDS]

    def with_tested_ranges(self, trial: Trial) -> Trial:
        """Return a trial with the ranges of its summands as far as the flights show that they hold."""
        repaired = with_effects(self.vehicle, [*trial.names, *trial.equation], trial.values)
        found = extrapolation.with_tested_ranges(self._residuals(repaired), repaired, trial.found, trial.coefficients)
        return replace(trial, found=found, equation=equation_effects(self.vehicle, found))

    def _residuals(self, vehicle: Vehicle) -> polynomial_search.Residuals:
        """Return the residuals of the recordings against a vehicle."""
        evidence, places = self.evidence, self.found.evidence.library.places
        lines = residuals_at(evidence, vehicle)
        return polynomial_search.Residuals(evidence.residual_models, lines, evidence.sigmas, places)

    def _beside_names(self, trial: Trial, found: list[Found]) -> Trial:
        """Return the trial of the names of a trial and an equation."""
        names = [one for one in trial.names if not one.id.startswith(equation.PREFIX)]
        values = {one.key: trial.values[one.key] for one in names}
        return self.trial(names, equation_effects(self.vehicle, found), found, values)

    def disagreeing(self, trial: Trial, share: float) -> set[str]:
        """Return the new summands whose coefficient differs from the first half of the flights to the second."""
        joint = trial.effects
        repaired = with_effects(self.vehicle, list(joint), trial.values)
        equations = normal_equations_at(self.evidence, repaired, joint, share)
        parameters = [parameter for effect in joint for parameter in effect.parameters]
        now = np.concatenate([trial.values[effect.key] for effect in joint])
        steps, rows = parameter_steps(joint), np.arange(len(parameters))
        halves = np.array_split(np.arange(len(equations.squares)), 2)
        parts = [NormalEquations(*(part[half] for part in vars(equations).values())) for half in halves]
        fits = [stepwise.fit(part, rows) for part in parts]
        shown = np.min([part.parameter_information for part in parts], axis=0)
        in_both = shown > ONE_HALF_SHARE * equations.parameter_information
        (first, second) = (now + one.estimate * steps for one in fits)
        errors = np.sqrt(sum(np.diag(one.covariance) for one in fits)) * steps
        apart = in_both & (
            np.abs(first - second)
            > np.maximum(DISAGREEMENT_ERRORS * errors, MAX_DISAGREEMENT * 0.5 * np.abs(first + second))
        )
        new = {one.name for one in trial.found}
        return {one.name for one, differs in zip(parameters, apart, strict=True) if differs and one.name in new}


def kinds_without_name(found: SearchResult) -> set[str]:
    """Return the kinds of left sides (see KINDS) in which a search has found an equation or something unexplained."""
    channels = [one.channel for one in (*found.equation_terms, *found.unexplained)]
    kinds = {KINDS[channel.quantity] for channel in channels if channel.quantity in KINDS}
    return kinds | {"force", "moment", equation.AT_ROTORS} if kinds & {"force", "moment"} else kinds
