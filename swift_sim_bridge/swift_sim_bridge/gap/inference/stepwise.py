"""Stepwise selection of the effects that a recording calls for, on the normal equations alone.

An effect is added with all its parameters, and only if it passes three tests: its gain exceeds what reference flights
show, its estimate is consistent over the seconds of the flight, and it predicts blocks of the flight that the fit has
not used. A gain is the decrease of the sum of squares, in independent samples.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, fit_gain, solve
from swift_sim_bridge.gap.inference.null_distribution import MAX_BIAS_SHARE, NullDistribution

BLOCKS = 8  # of the flight, for cross-validation; more leave less of the flight in each
MIN_VALIDATION_ERRORS = 1.5  # standard errors that the blocks' mean gain must exceed; chance does so in 9 % (8 blocks)
FALSE_SELECTION_RATE = 1e-3  # probability that the test over seconds alone passes any false effect of the catalogue
PRIOR_INFORMATION_SHARE = 0.005  # of the flight's information, added in cross-validation: bounds poorly known estimates
MIN_BLOCK_INFORMATION_SHARE = 0.01  # of an effect's information; a block with less does not show the effect
BOUND_TOLERANCE_ERRORS = 2.0  # standard errors by which an estimate may exceed its physical bounds
MIN_OBSERVABLE_GAIN = 1.0  # squares that a parameter must change at the far end of its range to be observable
MIN_SPREAD_SHARE = 1e-12  # of the variance of independent samples; less over seconds is that of no data


@dataclass(frozen=True)
class SelectionProblem:
    """The data of a selection, to first order about the vehicle of the file.

    Attributes:
        equations: normal equations of the recording, with the bias gradient of the pipeline subtracted.
        slices: positions of each effect's parameters, by its key.
        null_distribution: null distribution of the reference flights.
        uncorrected: the normal equations without this subtraction; None if there is no bias.
        low: (p,) lower physical bounds, in steps from the value of the file; None for no bounds.
        high: (p,) upper physical bounds, likewise.
    """

    equations: NormalEquations
    slices: dict[str, slice]
    null_distribution: NullDistribution
    uncorrected: NormalEquations | None = None
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def rows(self, keys: Iterable[str]) -> np.ndarray:
        """Return the positions of the parameters of these effects."""
        return np.concatenate(
            [np.arange(s.start, s.stop) for s in (self.slices[key] for key in keys)] or [np.empty(0, int)]
        ).astype(int)

    def parameter_count(self, key: str) -> int:
        """Return the number of parameters of an effect."""
        return self.slices[key].stop - self.slices[key].start

    def gain(self, keys: Iterable[str]) -> float:
        """Return the gain of these effects together."""
        rows = self.rows(keys)
        return fit_gain(self.equations, rows) if len(rows) else 0.0

    def score(self, key: str, gain: float) -> float:
        """Return the score of an effect: the log-likelihood of its gain minus the penalty of its parameters."""
        return 0.5 * gain / self.null_distribution.variance_inflation(key) - self.penalty(key)

    def penalty(self, key: str) -> float:
        """Return the penalty of an effect's parameters in log-likelihoods (Schwarz criterion)."""
        return 0.5 * self.parameter_count(key) * np.log(max(self.equations.samples.sum(), 2.0))


@dataclass(frozen=True)
class Fit:
    """A least-squares fit.

    Attributes:
        rows: (k,) positions of the fitted parameters.
        estimate: (k,) their changes, in steps.
        covariance: (k, k) covariance of the estimate, robust to correlation within seconds.
    """

    rows: np.ndarray
    estimate: np.ndarray
    covariance: np.ndarray


def fit(equations: NormalEquations, rows, variance_inflation: float = 1.0) -> Fit:
    """Return the fit of the parameters `rows`.

    The covariance is the sandwich estimate over seconds (Liang and Zeger 1986), at least that of independent samples
    times `variance_inflation`.
    """
    information = equations.total_information[np.ix_(rows, rows)]
    estimate = -solve(information, equations.total_gradient[rows])
    inverse = solve(information, np.eye(len(rows)))
    score = equations.gradient[:, rows] + equations.information[:, rows][:, :, rows] @ estimate
    seconds = np.count_nonzero(equations.samples)
    meat = score.T @ score * seconds / max(seconds - len(rows), 1)
    sandwich, plain = inverse @ meat @ inverse, variance_inflation * inverse
    spread, least = np.diag(sandwich), np.diag(plain)
    shown = spread > MIN_SPREAD_SHARE * least  # others have no score in any second, as a place that is never passed
    wider = np.sqrt(np.maximum(1.0, np.divide(least, spread, out=np.ones_like(least), where=shown)))
    return Fit(rows, estimate, sandwich * np.outer(wider, wider) + np.diag(np.where(shown, 0.0, least)))


def bounded_step(equations: NormalEquations, damping: float, low, high) -> np.ndarray:
    """Return the step (p,) that lowers the sum of squares most, between bounds.

    A parameter that reaches its bound stays there, and the others are solved for again.

    Args:
        equations: normal equations.
        damping: share of each parameter's information that is added to it; it shortens the step most in directions of
            little information (Levenberg and Marquardt).
        low: (p,) lower bounds of the step.
        high: (p,) upper bounds of the step.
    """
    information, gradient = equations.total_information, equations.total_gradient
    information = information + damping * np.diag(np.diag(information))
    found, free = np.zeros(len(gradient)), np.ones(len(gradient), bool)
    while free.any():
        rows = np.flatnonzero(free)
        slope = gradient[rows] + information[np.ix_(rows, ~free)] @ found[~free]
        found[rows] = -solve(information[np.ix_(rows, rows)], slope)
        beyond = free & ((found < low) | (found > high))
        if not beyond.any():
            break
        found, free = np.clip(found, low, high), free & ~beyond
    return found


def observable(equations: NormalEquations, low, high) -> np.ndarray:
    """Return which parameters (p,) the flight shows: not the scale of an axis that measures nothing, for example.

    Args:
        equations: normal equations of the flight.
        low, high: (p,) range of each parameter's change, in steps.
    """
    reach = np.maximum(np.abs(low), np.abs(high))
    with np.errstate(invalid="ignore"):
        return ~(reach**2 * equations.parameter_information < MIN_OBSERVABLE_GAIN)


def restricted_to(equations: NormalEquations, kept: np.ndarray) -> NormalEquations:
    """Return normal equations in which only the parameters `kept` (p,) have an effect."""
    return replace(
        equations, gradient=equations.gradient * kept, information=equations.information * np.outer(kept, kept)
    )


def accepts(problem: SelectionProblem, selected: list[str], key: str) -> tuple[bool, float]:
    """Return whether an effect may be added to those selected, and its significance in standard deviations."""
    gain = problem.gain([*selected, key]) - problem.gain(selected)
    size, inflation = problem.parameter_count(key), problem.null_distribution.variance_inflation(key)
    accepted = (
        _exceeds_references(problem, selected, key)
        and not _may_be_chance(problem, selected, key)
        and passes_cross_validation(problem, selected, key)  # last: it takes longest
    )
    return accepted, significance(gain / inflation, size)


def explains(problem: SelectionProblem, selected: list[str], key: str) -> bool:
    """Return whether an effect, added to those selected, explains more than reference flights show.

    It must be physical, and it must predict blocks that its fit has not used. This alone does not show that it is
    there, as each of many effects may do so by chance.
    """
    return _exceeds_references(problem, selected, key) and passes_cross_validation(problem, selected, key)


def _exceeds_references(problem: SelectionProblem, selected: list[str], key: str) -> bool:
    """Return whether an effect, added to those selected, is physical and has a gain that reference flights lack."""
    gain = problem.gain([*selected, key]) - problem.gain(selected)
    if gain < problem.null_distribution.threshold(key) or not _exceeds_bias(problem, selected, key):
        return False
    return within_bounds(problem, _fit_beside(problem, selected, key), problem.parameter_count(key))


def _may_be_chance(problem: SelectionProblem, selected: list[str], key: str) -> bool:
    """Return whether the scatter over the seconds makes one of all effects as significant as this one."""
    size, found = problem.parameter_count(key), _fit_beside(problem, selected, key)
    return chance(problem.equations, found, size) > FALSE_SELECTION_RATE / len(problem.slices)


def chance(equations: NormalEquations, found: Fit, size: int) -> float:
    """Return the probability that the scatter over the seconds makes the last `size` parameters of a fit as large."""
    wald = found.estimate[-size:] @ solve(found.covariance[-size:, -size:], found.estimate[-size:])
    seconds = np.count_nonzero(equations.samples)
    free = max(seconds - size, 0)
    return float(special.fdtrc(size, max(free, 1), wald / size * free / max(seconds - 1, 1)))


def _fit_beside(problem: SelectionProblem, selected: list[str], key: str) -> Fit:
    """Return the fit of the selected effects and, last, one more."""
    return fit(problem.equations, problem.rows([*selected, key]), problem.null_distribution.variance_inflation(key))


def within_bounds(problem: SelectionProblem, found: Fit, size: int) -> bool:
    """Return whether the last `size` parameters of a fit are within their physical bounds, except for their errors."""
    if problem.low is None:
        return True
    rows, estimate = found.rows[-size:], found.estimate[-size:]
    tolerance = BOUND_TOLERANCE_ERRORS * np.sqrt(np.diag(found.covariance)[-size:])
    return bool(np.all((estimate > problem.low[rows] - tolerance) & (estimate < problem.high[rows] + tolerance)))


def _exceeds_bias(problem: SelectionProblem, selected: list[str], key: str) -> bool:
    """Return whether an effect is clearly larger than the bias of the pipeline, as it is not in a quiet hover."""
    if problem.uncorrected is None:
        return True
    rows, size = problem.rows([*selected, key]), problem.parameter_count(key)
    corrected, uncorrected = (fit(equations, rows) for equations in (problem.equations, problem.uncorrected))
    information = problem.equations.total_information[np.ix_(rows, rows)]
    inverse = solve(information, np.eye(len(rows)))[-size:, -size:]
    estimate = corrected.estimate[-size:]
    bias = uncorrected.estimate[-size:] - corrected.estimate[-size:]
    return bool(bias @ solve(inverse, bias) < MAX_BIAS_SHARE * (estimate @ solve(inverse, estimate)))


def significance(gain: float, size: int) -> float:
    """Return the significance of the gain of `size` parameters, as standard deviations of a normal variable."""
    if gain < 1000.0:
        return float(max(-special.ndtri(0.5 * special.chdtrc(size, max(gain, 0.0))), 0.0))
    half = 0.5 * size
    log_tail = (half - 1.0) * np.log(0.5 * gain) - 0.5 * gain - special.gammaln(half)  # of the chi-squared distribution
    return float(np.sqrt(-2.0 * log_tail - np.log(-np.pi * log_tail)))  # with the same tail of the normal distribution


def passes_cross_validation(problem: SelectionProblem, selected: list[str], key: str) -> bool:
    """Return whether an effect that is added to those selected predicts held-out blocks, at least two of them."""
    gains = cross_validation_gains(problem, selected, key)
    if len(gains) < 2:
        return False
    return bool(gains.mean() > MIN_VALIDATION_ERRORS * gains.std(ddof=1) / np.sqrt(len(gains)))


def cross_validation_gains(problem: SelectionProblem, selected: list[str], key: str) -> np.ndarray:
    """Return the gain of an effect on each block that shows it, with the estimate of the other blocks.

    The seconds beside a block are used by neither. A weak prior keeps estimates near zero that the other blocks hardly
    determine, as those of a local wind, which is met at one place alone.
    """
    equations, seconds, found = problem.equations, np.arange(len(problem.equations.samples)), []
    diagonal = np.einsum("spp->sp", equations.information)
    prior, own = np.diag(diagonal.sum(axis=0)), problem.rows([key])
    for block in np.array_split(seconds, min(BLOCKS, len(seconds))):
        if np.all(diagonal[block][:, own].sum(axis=0) <= MIN_BLOCK_INFORMATION_SHARE * diagonal[:, own].sum(axis=0)):
            continue
        training = (seconds < block[0] - 1) | (seconds > block[-1] + 1)
        losses = []
        for keys in (selected, [*selected, key]):
            rows = problem.rows(keys)
            information = equations.information[training].sum(axis=0)[np.ix_(rows, rows)]
            information = information + PRIOR_INFORMATION_SHARE * prior[np.ix_(rows, rows)]
            estimate = -solve(information, equations.gradient[training].sum(axis=0)[rows])
            held_out = equations.information[block].sum(axis=0)[np.ix_(rows, rows)]
            losses.append(2 * estimate @ equations.gradient[block].sum(axis=0)[rows] + estimate @ held_out @ estimate)
        found.append(losses[0] - losses[1])
    return np.array(found)


def best_addition(
    problem: SelectionProblem, selected: list[str], excluded: Iterable[str] = ()
) -> tuple[str | None, float]:
    """Return the effect with the highest score that may be added, and its significance; None if none may be."""
    excluded = set(excluded) | set(selected)
    base = problem.gain(selected)
    scores = {
        key: problem.score(key, problem.gain([*selected, key]) - base) for key in problem.slices if key not in excluded
    }
    for key in sorted(scores, key=scores.get, reverse=True):
        if scores[key] <= 0:
            break
        accepted, sigma = accepts(problem, selected, key)
        if accepted:
            return key, sigma
    return None, 0.0


def without_parameters(equations: NormalEquations, rows, change) -> NormalEquations:
    """Return the normal equations, to first order, with the parameters `rows` lower by `change` (k,), in steps."""
    moved = np.einsum("spk,k->sp", equations.information[:, :, rows], change)
    squares = equations.squares - 2 * equations.gradient[:, rows] @ change + moved[:, rows] @ change
    return replace(equations, squares=squares, gradient=equations.gradient - moved)


def backward_elimination(problem: SelectionProblem, selected: list[str]) -> list[str]:
    """Return the selected effects without those that the others make superfluous."""
    kept = list(selected)
    while len(kept) > 1:
        weak = [key for key in kept if not accepts(problem, [other for other in kept if other != key], key)[0]]
        if not weak:
            break
        kept.remove(min(weak, key=lambda key: problem.score(key, problem.gain(kept) - problem.gain(set(kept) - {key}))))
    return kept
