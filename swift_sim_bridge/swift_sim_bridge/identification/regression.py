"""Weighted least squares that refuses coefficients which the flights do not determine.

Samples of a flight are correlated with their neighbours, so standard errors come from the scatter of whole seconds
(clusters) and prediction errors from held-out blocks of time. A refused coefficient keeps its value, and the others are
fitted again.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import special

ITERATIONS = 25  # of the solver, at most; CONVERGED or FLAT end it earlier
MIN_DAMPING = 1e-3  # first Levenberg-Marquardt damping after a step that increases the cost
MAX_RELATIVE_STEP = 0.7  # of a positive coefficient in one iteration, on a logarithmic scale: a factor of 2
FLAT = 1e-7  # relative decrease of the cost below which a damped step ends the iteration
CONVERGED = 1e-3  # standard errors; smaller steps end the iteration
MIN_CLUSTERS = 8  # seconds of flight; with fewer, the scatter between them is no estimate of an error
FOLDS = 5  # held-out blocks of time
MAX_PRIOR_PULL = 3.0  # standard deviations of its prior that a nuisance coefficient may move
MAD_TO_SIGMA = 1.4826  # standard deviation of normal errors over their median absolute value
HUBER_LIMIT = 3.0  # standard deviations, beyond which the loss grows linearly (Huber), for example in a crash
MIN_CORRELATION = 0.9  # of two coefficients, from which on they are reported as not distinguished
MAX_GROWTH = 1.1  # of held-out errors by a fit: values that were right already can only get slightly worse


class NotMeasured(Exception):
    """The flights lack a channel that a problem needs; the text names it."""


@dataclass(frozen=True)
class Coefficient:
    """One number to be estimated.

    Attributes:
        name: in reports.
        unit: of its values.
        start: value before the fit.
        tolerance: largest useful standard error.
        manoeuvre: flight that determines it.
        path: in the vehicle file; empty for a nuisance coefficient of the recording, such as a sensor's bias.
        low: smallest physical value.
        high: largest physical value.
        prior: standard deviation of the prior about `start`; infinite for none.
        systematic: standard deviation of the error by what was not recorded.
        systematic_cause: what was not recorded, and the remedy.
    """

    name: str
    unit: str
    start: float
    tolerance: float
    manoeuvre: str = ""
    path: tuple = ()
    low: float = -np.inf
    high: float = np.inf
    prior: float = np.inf
    systematic: float = 0.0
    systematic_cause: str = ""


@dataclass(frozen=True)
class Problem:
    """N measurements and their prediction from k coefficients.

    Attributes:
        name: of the problem.
        coefficients: k of them.
        channels: (name, unit) of each.
        measured: (N,).
        channel: (N,), index into `channels`.
        cluster: (N,), increasing integers, one for each second of flight.
        t: (N,) s of flight.
        linearise: theta (k,) -> (predicted (N,), its derivative (N, k)).
        notes: assumptions that a reader of the result must know.
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
        """Values (k,) before the fit."""
        return np.array([c.start for c in self.coefficients])

    @property
    def nuisance(self) -> np.ndarray:
        """Which coefficients (k,) are nuisance coefficients of the recording."""
        return np.array([not c.path for c in self.coefficients])


@dataclass(frozen=True)
class Fit:
    """Solution of a problem.

    Attributes:
        problem: that was solved.
        theta: (k,) values.
        standard_error: (k,).
        freedom: degrees of freedom: clusters less one.
        free: (k,), which coefficients were fitted.
        refused: reason by name of a refused coefficient.
        condition: condition number of the scaled normal matrix.
        held_out: by channel, RMS error on held-out blocks before and after.
        before: (N,) predictions with the values of the file.
        after: (N,) predictions with the fitted values.
    """

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
        return special.stdtrit(self.freedom, 0.975) * self.standard_error


@dataclass(frozen=True)
class _Normal:
    """The weighted normal equations of some rows.

    Attributes:
        matrix: (k, k), scaled to a unit diagonal.
        gradient: (k,).
        scale: (k,), square root of the diagonal before scaling.
        weight: (N,) of the measurements.
        prior: (k,) information of the priors.
    """

    matrix: np.ndarray
    gradient: np.ndarray
    scale: np.ndarray
    weight: np.ndarray
    prior: np.ndarray

    def inverse(self, active=None, damping: float = 0.0) -> np.ndarray:
        """Return the inverse (k, k), zero for inactive rows; the smallest eigenvalues are bounded from below."""
        rows = np.ones(len(self.scale), bool) if active is None else active
        values, vectors = np.linalg.eigh(self.matrix[np.ix_(rows, rows)])
        inverse = np.zeros_like(self.matrix)
        inverse[np.ix_(rows, rows)] = vectors @ (vectors / np.maximum(values + damping, 1e-14)).T
        return inverse / np.outer(self.scale, self.scale)


def fit(problem: Problem) -> Fit:
    """Return the estimates of a problem's coefficients that the flights determine."""
    everything = np.ones(len(problem.measured), bool)
    free, refused = np.ones(len(problem.coefficients), bool), {}
    theta, seconds = problem.start, len(np.unique(problem.cluster))
    if seconds < MIN_CLUSTERS:
        reason = f"only {seconds} s of the flight can be used, {MIN_CLUSTERS} s are needed"
        refused = {c.name: reason for c in problem.coefficients}
        free[:] = False
    while free.any():
        theta = solve(problem, everything, free)
        error, correlation, condition = uncertainty(problem, theta, free)
        excess = np.where(free & ~problem.nuisance, error / [c.tolerance for c in problem.coefficients], 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] > 1.0:
            reason = _reason(problem, worst, error, correlation, free, excess[worst])
        else:
            worst, reason = _against_prior(problem, theta, correlation, free)
        if reason is None:
            break
        refused[problem.coefficients[worst].name] = reason
        free[worst] = False
        if not (free & ~problem.nuisance).any():
            free[:] = False
    if free.any():
        held_out = held_out_errors(problem, free, theta)
        if _score(problem, held_out) > MAX_GROWTH:
            reason = "the fit predicts held-out blocks of time no better than the file's values"
            refused |= {c.name: reason for c, fitted in zip(problem.coefficients, free, strict=True) if fitted}
            free[:] = False
    before = problem.linearise(solve(problem, everything, problem.nuisance))[0]
    if not free.any():
        k = len(problem.coefficients)
        return Fit(
            problem=problem,
            theta=problem.start,
            standard_error=np.full(k, np.nan),
            freedom=max(seconds - 1, 1),
            free=free,
            refused=refused,
            condition=np.nan,
            held_out={},
            before=before,
            after=before,
        )
    after = problem.linearise(theta)[0]
    return Fit(
        problem=problem,
        theta=theta,
        standard_error=error,
        freedom=seconds - 1,
        free=free,
        refused=refused,
        condition=condition,
        held_out=held_out,
        before=before,
        after=after,
    )


def solve(problem: Problem, rows, free, start=None) -> np.ndarray:
    """Return the coefficients (k,) that fit the rows (N,) best; those that are not free keep their values.

    Levenberg-Marquardt steps, undamped as long as they decrease the cost, and along a bound once it is reached.
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
        at_candidate = problem.linearise(candidate)
        new_cost = _cost(problem, candidate, at_candidate[0], rows, normal.weight)
        if new_cost <= cost:
            theta, (predicted, jacobian), damping = candidate, at_candidate, 0.1 * damping
            if damping > 0 and new_cost > cost * (1.0 - FLAT):
                break  # along a direction that is not determined
        else:
            damping = max(10.0 * damping, MIN_DAMPING)
    return theta


def _stepped(theta, step, low) -> np.ndarray:
    """Return theta (k,) after a step; positive coefficients take bounded steps on a logarithmic scale."""
    positive = low > 0
    share = np.clip(step / np.where(positive, theta, 1.0), -MAX_RELATIVE_STEP, MAX_RELATIVE_STEP)
    return np.where(positive, theta * np.exp(share), theta + step)


def uncertainty(problem: Problem, theta, free) -> tuple[np.ndarray, np.ndarray, float]:
    """Return standard errors (k,), correlations (k, k) and the condition number of the scaled problem.

    Sandwich estimator of Liang and Zeger over seconds of flight; priors add their information. The estimator is too low
    where few seconds determine a coefficient; the model-based standard error is a lower bound.
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
    """Return by channel the RMS error on held-out blocks of time, before and after the fit.

    Before, only the nuisance coefficients are fitted. A second on each side of a block is used by neither.
    """
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
    """Return the normal equations at theta, with weights by the robust scatter of each channel."""
    residual = problem.measured - predicted
    weight, inflation = np.zeros(len(residual)), 1.0
    for i in range(len(problem.channels)):
        mine = problem.channel == i
        floor = 1e-12 * np.var(problem.measured[mine]) + 1e-24
        seen = mine & rows
        if seen.any():
            sigma = np.sqrt((MAD_TO_SIGMA * np.median(np.abs(residual[seen]))) ** 2 + floor)
            weight[mine] = 1.0 / (np.maximum(np.abs(residual[mine]) / (HUBER_LIMIT * sigma), 1.0) * sigma**2)
            inflation = max(inflation, _variance_inflation(residual[seen], problem.cluster[seen]))
    weight /= inflation  # the same in all channels: a channel with a lasting error must keep its weight to be corrected
    weight[~rows] = 0.0
    prior = np.array([c.prior for c in problem.coefficients]) ** -2.0
    start = problem.start
    weighted = jacobian[:, free] * weight[:, None]
    matrix = jacobian[:, free].T @ weighted + np.diag(prior[free])
    gradient = weighted.T @ residual + (prior * (start - theta))[free]
    scale = np.sqrt(np.diag(matrix))
    unseen = scale == 0
    scale[unseen] = 1.0
    matrix[unseen, unseen] = 1.0  # nothing depends on it: it keeps its value
    return _Normal(matrix / np.outer(scale, scale), gradient, scale, weight, prior[free])


def _variance_inflation(residual, cluster) -> float:
    """Return the variance of sums over whole seconds, relative to independent samples (n,); at least one.

    This is Kish's design effect: the number of correlated samples that have the information of one independent sample.
    """
    _, index = np.unique(cluster, return_inverse=True)
    sums = np.bincount(index, residual)
    return max(1.0, float(np.sum(sums**2) / max(np.sum(residual**2), 1e-300)))


def _cost(problem: Problem, theta, predicted, rows, weight) -> float:
    """Return the weighted sum of squares with the priors."""
    known = [((value - c.start) / c.prior) ** 2 for value, c in zip(theta, problem.coefficients, strict=True)]
    return float(np.sum((weight * (problem.measured - predicted) ** 2)[rows]) + np.sum(known))


def _score(problem: Problem, held_out) -> float:
    """Return the mean over the channels of the ratio of errors after and before; rounding errors do not count."""
    ratios = []
    for i, (before, after) in enumerate(held_out.values()):
        floor = 1e-6 * _rms(problem.measured[problem.channel == i]) + 1e-300
        ratios.append((after + floor) / (before + floor))
    return float(np.mean(ratios))


def _rms(values) -> float:
    """Return the root mean square, NaN without values."""
    return float(np.sqrt(np.mean(values * values))) if len(values) else float("nan")


def _against_prior(problem: Problem, theta, correlation, free) -> tuple[int, str | None]:
    """Return the coefficient that would move a nuisance coefficient far from its prior, and the reason for its refusal.

    The reason is None where there is no such coefficient. Example: in a hover, a bias of the accelerometer and a wrong
    thrust have the same effect.
    """
    pull = np.array([abs(value - c.start) / c.prior for value, c in zip(theta, problem.coefficients, strict=True)])
    known = int(np.argmax(pull * free))
    suspects = np.abs(correlation[known]) * (free & ~problem.nuisance)
    worst = int(np.argmax(suspects))
    if pull[known] * free[known] <= MAX_PRIOR_PULL or not suspects.any():
        return worst, None
    mine = problem.coefficients[known]
    text = f"with it, {mine.name} would be {theta[known]:.2g} {mine.unit}".rstrip()
    return worst, f"{text}, {pull[known]:.2g} times its standard deviation: the flight does not distinguish the two"


def _reason(problem: Problem, j: int, error, correlation, free, excess: float) -> str:
    """Return why a coefficient is refused."""
    mine = problem.coefficients[j]
    if not np.isfinite(error[j]):
        return "nothing that was measured in this flight depends on it"
    text = f"its standard error would be {error[j]:.2g} {mine.unit}".rstrip()
    text += f", {excess:.2g} times the largest useful one"
    if mine.systematic > mine.tolerance:
        return f"{text}: {mine.systematic_cause}"
    other = np.abs(correlation[j]) * free
    other[j] = 0.0
    nearest = int(np.argmax(other))
    if other[nearest] >= MIN_CORRELATION:
        name = problem.coefficients[nearest].name
        return f"{text}: the flight does not distinguish it from {name} (correlation {correlation[j, nearest]:.3f})"
    return f"{text}: the flight hardly excites it"
