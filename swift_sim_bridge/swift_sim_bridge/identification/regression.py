"""Weighted least squares that knows what it does not know. Pure.

Samples of a flight are copies of their neighbours, so standard errors come from the scatter of whole seconds (clusters)
and errors are told on blocks of time that the fit has not seen. A coefficient that the flights do not determine is
refused and keeps its value, and the others are fitted anew.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

ITERATIONS = 25
LEAST_DAMPING = 1e-3
LARGEST_SHARE = 0.7
FLAT = 1e-7
CONVERGED = 1e-3  # of a standard error
LEAST_CLUSTERS = 8
FOLDS = 5
STRAINED = 3.0  # standard deviations of what is known beforehand
USUAL = 1.4826  # standard deviation of normal errors over their median size
OUTLYING = 3.0  # standard deviations, beyond which an error counts in proportion to its size alone (Huber): a crash
CORRELATED = 0.9  # the more two coefficients are, the less a flight can tell which of them it was
WORSE = 1.1  # by so much may errors on unseen blocks grow: values that were right already can only get worse


class NotMeasured(Exception):
    """A problem cannot be put: its text says what the flights lack."""


@dataclass(frozen=True)
class Coefficient:
    """One number to be found.

    path: where it stands in the vehicle file, empty for what only the recording has (a sensor's bias); start: its value
    before; tolerance: the largest standard error worth reporting; prior: standard deviation about `start` of what is
    known beforehand, infinite for nothing; systematic: by how much what was not recorded puts it off (standard
    deviation), and doubt: what that is; low, high: what is physical; fly: what would tell it.
    """

    name: str
    unit: str
    start: float
    tolerance: float
    fly: str = ""
    path: tuple = ()
    low: float = -np.inf
    high: float = np.inf
    prior: float = np.inf
    systematic: float = 0.0
    doubt: str = ""


@dataclass(frozen=True)
class Problem:
    """What was measured, and how it follows from k coefficients.

    channels: (name, unit) of each; measured (N,); channel (N,): index into channels; cluster (N,): whole numbers, one a
    second of flight, growing; t (N,) s of flight; linearise(theta (k,)) -> predicted (N,), its derivative (N, k).
    """

    name: str
    coefficients: tuple[Coefficient, ...]
    channels: tuple[tuple[str, str], ...]
    measured: np.ndarray
    channel: np.ndarray
    cluster: np.ndarray
    t: np.ndarray
    linearise: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    notes: tuple[str, ...] = ()

    @property
    def start(self) -> np.ndarray:
        return np.array([c.start for c in self.coefficients])

    @property
    def nuisance(self) -> np.ndarray:
        """Which coefficients (k,) are the recording's own."""
        return np.array([not c.path for c in self.coefficients])


@dataclass(frozen=True)
class Fit:
    """theta, standard_error (k,); freedom: clusters less one; free (k,): what was fitted; refused: why, by name;
    condition: number of the scaled normal matrix; held_out: by channel, RMS error on unseen blocks before and after;
    before, after (N,): predictions with the values of the file and with those found."""

    problem: Problem
    theta: np.ndarray
    standard_error: np.ndarray
    freedom: int
    free: np.ndarray
    refused: dict[str, str]
    condition: float
    held_out: dict[str, tuple[float, float]]
    before: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)

    @property
    def half_interval95(self) -> np.ndarray:
        """Half the width (k,) of the 95 % interval."""
        return stats.t.ppf(0.975, self.freedom) * self.standard_error


@dataclass(frozen=True)
class _Normal:
    """The weighted normal equations of some rows: matrix (k, k) scaled to a unit diagonal, scale (k,), weight (n,)."""

    matrix: np.ndarray
    gradient: np.ndarray
    scale: np.ndarray
    weight: np.ndarray
    prior: np.ndarray

    def inverse(self, active=None, damping: float = 0.0) -> np.ndarray:
        """Return the inverse (k, k), zero for the inactive; a direction that is not determined at all counts little."""
        rows = np.ones(len(self.scale), bool) if active is None else active
        values, vectors = np.linalg.eigh(self.matrix[np.ix_(rows, rows)])
        inverse = np.zeros_like(self.matrix)
        inverse[np.ix_(rows, rows)] = vectors @ (vectors / np.maximum(values + damping, 1e-14)).T
        return inverse / np.outer(self.scale, self.scale)


def fit(problem: Problem) -> Fit:
    """Return what the flights tell of a problem's coefficients."""
    everything = np.ones(len(problem.measured), bool)
    free, refused = np.ones(len(problem.coefficients), bool), {}
    theta, seconds = problem.start, len(np.unique(problem.cluster))
    if seconds < LEAST_CLUSTERS:
        reason = f"only {seconds} s of the flight can be used, {LEAST_CLUSTERS} s are needed"
        refused = {c.name: reason for c in problem.coefficients}
        free[:] = False
    while free.any():
        theta = solve(problem, everything, free)
        error, correlation, condition = uncertainty(problem, theta, free)
        excess = np.where(free & ~problem.nuisance, error / [c.tolerance for c in problem.coefficients], 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] > 1.0:
            reason = _why(problem, worst, error, correlation, free, excess[worst])
        else:
            worst, reason = _strained(problem, theta, correlation, free)
        if reason is None:
            break
        refused[problem.coefficients[worst].name] = reason
        free[worst] = False
        if not (free & ~problem.nuisance).any():
            free[:] = False
    if free.any():
        held_out = held_out_errors(problem, free, theta)
        if _score(problem, held_out) > WORSE:
            reason = "the fit predicts blocks of time that it has not seen no better than the file's values"
            refused |= {c.name: reason for c, there in zip(problem.coefficients, free, strict=True) if there}
            free[:] = False
    before = problem.linearise(solve(problem, everything, problem.nuisance))[0]
    if not free.any():
        k = len(problem.coefficients)
        return Fit(
            problem, problem.start, np.full(k, np.nan), max(seconds - 1, 1), free, refused, np.nan, {}, before, before
        )
    after = problem.linearise(theta)[0]
    return Fit(problem, theta, error, seconds - 1, free, refused, condition, held_out, before, after)


def solve(problem: Problem, rows, free, start=None) -> np.ndarray:
    """Return the coefficients (k,) that fit the rows (N,) best, the others held at their values.

    Levenberg and Marquardt's steps, undamped as long as they lead down, and along a bound once it is reached.
    """
    theta = problem.start if start is None else start.copy()
    low, high = (np.array([getattr(c, side) for c in problem.coefficients]) for side in ("low", "high"))
    predicted, jacobian = problem.linearise(theta)
    damping = 0.0
    for _ in range(ITERATIONS):
        normal = _normal(problem, theta, predicted, jacobian, rows, free)
        outward = ((theta <= low)[free] & (normal.gradient < 0)) | ((theta >= high)[free] & (normal.gradient > 0))
        inverse = normal.inverse(~outward, damping)
        step = np.zeros(len(theta))
        step[free] = inverse @ normal.gradient
        candidate = np.clip(_stepped(theta, step, low), low, high)
        moved = np.abs(candidate - theta)[free]
        if np.all(moved <= CONVERGED * np.sqrt(np.diag(inverse))):
            break
        cost = _cost(problem, theta, predicted, rows, normal.weight)
        there = problem.linearise(candidate)
        cost_there = _cost(problem, candidate, there[0], rows, normal.weight)
        if cost_there <= cost:
            theta, (predicted, jacobian), damping = candidate, there, 0.1 * damping
            if damping > 0 and cost_there > cost * (1.0 - FLAT):
                break  # along a direction that nothing determines
        else:
            damping = max(10.0 * damping, LEAST_DAMPING)
    return theta


def _stepped(theta, step, low) -> np.ndarray:
    """Return theta (k,) after a step; what must stay positive moves on a logarithmic scale, and not by much at once."""
    positive = low > 0
    share = np.clip(step / np.where(positive, theta, 1.0), -LARGEST_SHARE, LARGEST_SHARE)
    return np.where(positive, theta * np.exp(share), theta + step)


def uncertainty(problem: Problem, theta, free) -> tuple[np.ndarray, np.ndarray, float]:
    """Return standard errors (k,), correlations (k, k) and the condition number of the scaled problem.

    The sandwich of Liang and Zeger over seconds of flight; what is known beforehand adds its own information. It is low
    where few seconds carry a coefficient: then the error of as many independent samples as there are holds instead.
    """
    k, everything = len(theta), np.ones(len(problem.measured), bool)
    predicted, jacobian = problem.linearise(theta)
    normal = _normal(problem, theta, predicted, jacobian, everything, free)
    score = jacobian[:, free] * (normal.weight * (problem.measured - predicted))[:, None]
    _, cluster = np.unique(problem.cluster, return_inverse=True)
    count = cluster.max() + 1
    sums = np.stack([np.bincount(cluster, column, count) for column in score.T], axis=-1)
    inverse = normal.inverse()
    meat = sums.T @ sums * count / max(count - 1, 1) + np.diag(normal.prior)
    covariance = inverse @ meat @ inverse
    model_based = np.sqrt(np.diag(inverse))
    sigma = np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), model_based)
    error, correlation = np.zeros(k), np.zeros((k, k))
    unseen = ~jacobian[:, free].any(axis=0) & (normal.prior == 0)
    systematic = np.array([c.systematic for c in problem.coefficients])[free]
    error[free] = np.where(unseen, np.inf, np.hypot(sigma, systematic))
    correlation[np.ix_(free, free)] = inverse / np.outer(model_based, model_based)
    return error, correlation, float(np.linalg.cond(normal.matrix))


def held_out_errors(problem: Problem, free, theta) -> dict[str, tuple[float, float]]:
    """Return by channel the RMS error on blocks of time that a fit has not seen: of the values before (only what the
    recording itself has fitted), and after. A second on each side of a block is seen by neither."""
    before, after = np.zeros(len(problem.measured)), np.zeros(len(problem.measured))
    seconds = np.unique(problem.cluster)
    for block in np.array_split(seconds, min(FOLDS, len(seconds))):
        unseen = np.isin(problem.cluster, block)
        rows = ~np.isin(problem.cluster, [*block, block[0] - 1, block[-1] + 1])
        without = problem.linearise(solve(problem, rows, free & problem.nuisance))[0]
        fitted = problem.linearise(solve(problem, rows, free, theta))[0]
        before[unseen] = (problem.measured - without)[unseen]
        after[unseen] = (problem.measured - fitted)[unseen]
    return {
        name: (_rms(before[problem.channel == i]), _rms(after[problem.channel == i]))
        for i, (name, _) in enumerate(problem.channels)
    }


def _normal(problem: Problem, theta, predicted, jacobian, rows, free) -> _Normal:
    residual = problem.measured - predicted
    weight, copies = np.zeros(len(residual)), 1.0
    for i in range(len(problem.channels)):
        mine = problem.channel == i
        floor = 1e-12 * np.var(problem.measured[mine]) + 1e-24
        seen = mine & rows
        if seen.any():
            sigma = np.sqrt((USUAL * np.median(np.abs(residual[seen]))) ** 2 + floor)
            weight[mine] = 1.0 / (np.maximum(np.abs(residual[mine]) / (OUTLYING * sigma), 1.0) * sigma**2)
            copies = max(copies, _copies(residual[seen], problem.cluster[seen]))
    weight /= copies  # in all channels alike: one that errs for long would lose its say, and never be put right
    weight[~rows] = 0.0
    prior = np.array([c.prior for c in problem.coefficients]) ** -2.0
    start = problem.start
    weighted = jacobian[:, free] * weight[:, None]
    matrix = jacobian[:, free].T @ weighted + np.diag(prior[free])
    gradient = weighted.T @ residual + (prior * (start - theta))[free]
    scale = np.sqrt(np.diag(matrix))
    unseen = scale == 0
    scale[unseen] = 1.0
    matrix[unseen, unseen] = 1.0  # nothing depends on it: it stays where it is
    return _Normal(matrix / np.outer(scale, scale), gradient, scale, weight, prior[free])


def _copies(residual, cluster) -> float:
    """Return how many samples (n,) say together what one independent sample would: the variance of the sums over whole
    seconds against that of independent samples (Kish's design effect), at least one."""
    _, index = np.unique(cluster, return_inverse=True)
    sums = np.bincount(index, residual)
    return max(1.0, float(np.sum(sums**2) / max(np.sum(residual**2), 1e-300)))


def _cost(problem: Problem, theta, predicted, rows, weight) -> float:
    known = [((value - c.start) / c.prior) ** 2 for value, c in zip(theta, problem.coefficients, strict=True)]
    return float(np.sum((weight * (problem.measured - predicted) ** 2)[rows]) + np.sum(known))


def _score(problem: Problem, held_out) -> float:
    """Mean over the channels of the error after over the error before; what rounding leaves of either is no error."""
    ratios = []
    for i, (before, after) in enumerate(held_out.values()):
        floor = 1e-6 * _rms(problem.measured[problem.channel == i]) + 1e-300
        ratios.append((after + floor) / (before + floor))
    return float(np.mean(ratios))


def _rms(values) -> float:
    return float(np.sqrt(np.mean(values * values))) if len(values) else float("nan")


def _strained(problem: Problem, theta, correlation, free) -> tuple[int, str | None]:
    """Return the coefficient for whose sake something that is known beforehand would have to be far from it, and why it
    is refused; None where nothing is. In a hover an offset of the accelerometer does what thrust should."""
    pull = np.array([abs(value - c.start) / c.prior for value, c in zip(theta, problem.coefficients, strict=True)])
    known = int(np.argmax(pull * free))
    suspects = np.abs(correlation[known]) * (free & ~problem.nuisance)
    worst = int(np.argmax(suspects))
    if pull[known] * free[known] <= STRAINED or not suspects.any():
        return worst, None
    mine = problem.coefficients[known]
    text = f"with it, {mine.name} would be {theta[known]:.2g} {mine.unit}".rstrip()
    return worst, f"{text}, {pull[known]:.2g} times what is likely: the flight does not tell the two apart"


def _why(problem: Problem, j: int, error, correlation, free, excess: float) -> str:
    """Return why a coefficient is refused."""
    mine = problem.coefficients[j]
    if not np.isfinite(error[j]):
        return "nothing that was measured in this flight depends on it"
    text = f"its standard error would be {error[j]:.2g} {mine.unit}".rstrip()
    text += f", {excess:.2g} times what is of use"
    if mine.systematic > mine.tolerance:
        return f"{text}: {mine.doubt}"
    other = np.abs(correlation[j]) * free
    other[j] = 0.0
    twin = int(np.argmax(other))
    if other[twin] >= CORRELATED:
        name = problem.coefficients[twin].name
        return f"{text}: the flight does not tell it from {name} (correlation {correlation[j, twin]:.3f})"
    return f"{text}: the flight hardly excites it"
