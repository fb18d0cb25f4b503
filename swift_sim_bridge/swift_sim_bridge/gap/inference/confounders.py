"""Effects that explain the same residuals as a selected one: its replacements, and its confounders."""

from collections.abc import Callable, Iterable
from itertools import combinations

import numpy as np

from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, fit_gain, solve
from swift_sim_bridge.gap.inference.stepwise import SelectionProblem, accepts, explains, fit, within_bounds

MIN_CONFOUNDER_WEIGHT = 0.05  # relative likelihood above which a confounder is reported
MIN_LEAD = 3.0  # log-likelihood by which a replacement must be better; "strong" evidence (Kass and Raftery 1995)
SIMULATOR_ERROR_SHARE = 0.002  # of an effect's gain by which candidates may differ because the simulation is inexact
# Of the bias in a difference of two gains: the share by which its correction may be wrong, and a bound, since the bias
# of a strong effect is large. In hovers, where mass and thrust coefficient cannot differ, up to 0.2 was wrong.
BIAS_ERROR_SHARE, MAX_BIAS_ERROR = 0.5, 60.0
MIN_LARGE_CHANGE = 2.0  # times the minimum detectable one, four times its gain
FITTED_NOISE = 1.0  # log-likelihood that a parameter of a small effect gains without predicting anything (Akaike 1974)
MAX_REST_SHARE = 0.1  # of an effect's largest change, in steps, up to which others are a small error of their own
MAX_CONFOUNDER_LOSS = 0.25  # share of the gain that a confounder may lack; larger reports more confounders


def better_replacement(
    problem: SelectionProblem, others: list[str], key: str, excluded: Iterable[str] = ()
) -> tuple[str | None, float]:
    """Return the effect that explains clearly more than a selected one in its place, and its lead.

    An effect that was selected early may have absorbed one that was selected later.

    Args:
        problem: the data.
        others: the other selected effects.
        key: the selected effect.
        excluded: effects that must not be selected.

    Returns:
        Key and log-likelihood ratio; None and 0 if there is no such effect.
    """
    excluded = {*others, *excluded, key}
    leads = {
        candidate: _lead(problem, others, candidate, key) for candidate in problem.slices if candidate not in excluded
    }
    for candidate in sorted(leads, key=leads.get, reverse=True):
        if leads[candidate] < MIN_LEAD:
            break
        if accepts(problem, others, candidate)[0]:
            return candidate, leads[candidate]
    return None, 0.0


def simpler_replacement(
    problem: SelectionProblem, selected: list[str], excluded: Callable[[list[str]], set[str]]
) -> tuple[list[str], str | None]:
    """Return two selected effects and the single one that explains as much in their place; none and None if none does.

    A damaged propeller, for example, produces less thrust and a moment, as a mass and a centre of mass together do.

    Args:
        problem: the data.
        selected: the selected effects.
        excluded: function from selected effects to those that must not be added to them.
    """
    found, total = [], problem.gain(selected)
    for pair in combinations(selected, 2):
        others = [key for key in selected if key not in pair]
        base = problem.gain(others)
        for candidate in set(problem.slices) - {*selected, *excluded(others)}:
            loss = total - problem.gain([*others, candidate]) - SIMULATOR_ERROR_SHARE * (total - base)
            saved = sum(problem.penalty(key) for key in pair) - problem.penalty(candidate)
            inflation = problem.null_distribution.variance_inflation(candidate)
            found.append((saved - 0.5 * max(loss, 0.0) / inflation, list(pair), candidate))
    for lead, pair, candidate in sorted(found, reverse=True):
        if lead < MIN_LEAD:
            break
        if accepts(problem, [key for key in selected if key not in pair], candidate)[0]:
            return pair, candidate
    return [], None


def find_confounders(
    problem: SelectionProblem,
    selected: list[str],
    key: str,
    excluded: Iterable[str] = (),
    all_count: bool = True,
    is_vector: bool = False,
) -> dict[str, float]:
    """Return the effects that could replace a selected one, with their relative likelihoods, itself included.

    A confounder lowers the squares nearly as much, explains them in the effect's place, and makes it superfluous. It
    need not be significant by itself: the selected effect shows that something is there. The penalties of parameters
    count between large effects alone. They hold that few parameters differ from the file; but by little many do, and a
    small error of the centre of mass is no less likely than a slightly damaged propeller. Between small effects a
    parameter counts by the noise that it fits.

    Args:
        problem: the data.
        selected: the selected effects.
        key: the selected effect.
        excluded: effects that must not be selected.
        all_count: whether all parameters of a large effect count against it, or only those that it needs: a pack whose
            resistance alone is wrong is no less likely for the slope of its voltage, which is right.
        is_vector: whether its parameters are of one quantity, so that some may be a small error of the file.
    """
    others = [other for other in selected if other != key]
    base, best = problem.gain(others), problem.gain(selected)
    own, excluded = best - base, set(excluded) | set(selected)
    scores, large = {key: 0.0}, is_large(problem, others, key)
    for candidate in (candidate for candidate in problem.slices if candidate not in excluded):
        gain = problem.gain([*others, candidate]) - base
        if own - gain > MAX_CONFOUNDER_LOSS * own or gain < problem.null_distribution.threshold(candidate):
            continue
        if explains(problem, others, candidate) and not accepts(problem, [*others, candidate], key)[0]:
            scores[candidate] = _lead(problem, others, candidate, key)
            if not (large and is_large(problem, others, candidate)):
                more = problem.parameter_count(candidate) - problem.parameter_count(key)
                scores[candidate] += problem.penalty(candidate) - problem.penalty(key) - FITTED_NOISE * more
            elif not all_count:
                scores[candidate] += _unneeded(problem, others, candidate) - _unneeded(problem, others, key)
    if is_vector:
        scores |= _beside_small_rest(problem, others, key, excluded | scores.keys())
    highest = max(scores.values())
    weights = {name: float(np.exp(score - highest)) for name, score in scores.items()}
    total = sum(weights.values())
    likely = {
        name: weight / total
        for name, weight in weights.items()
        if weight / total > MIN_CONFOUNDER_WEIGHT or name == key
    }
    return dict(sorted(likely.items(), key=lambda item: -item[1]))


def _unneeded(problem: SelectionProblem, others: list[str], key: str) -> float:
    """Return the penalty of those parameters of an effect without which it explains as much, less the gain they add."""
    base, own = problem.rows(others), problem.rows([key])
    each, inflation = problem.penalty(key) / len(own), problem.null_distribution.variance_inflation(key)
    gains = {
        kept: fit_gain(problem.equations, np.concatenate([base, kept]))
        for size in range(1, len(own) + 1)
        for kept in combinations(own, size)
    }
    scores = [0.5 * gain / inflation + each * (len(own) - len(kept)) for kept, gain in gains.items()]
    return max(scores) - 0.5 * gains[tuple(own)] / inflation


def _beside_small_rest(problem: SelectionProblem, others: list[str], key: str, excluded: set[str]) -> dict[str, float]:
    """Return the effects that could replace a selected one but for its smallest parameters, with their leads.

    A centre of mass that is off by 8 mm along one axis and by 0.06 mm along the others may be a flapping moment in a
    vehicle file whose centre of mass is wrong by 0.06 mm.
    """
    own, size = problem.rows([key]), problem.parameter_count(key)
    change = np.abs(fit(problem.equations, problem.rows([*others, key])).estimate[-size:])
    small = change < MAX_REST_SHARE * change.max()
    if not small.any():
        return {}
    base, total, found = problem.rows(others), problem.gain([*others, key]), {}
    rest = np.concatenate([base, own[small]])
    gain_of_rest = fit_gain(problem.equations, rest)
    main, main_penalty = total - gain_of_rest, problem.penalty(key) * np.mean(~small)
    for candidate in (one for one in problem.slices if one not in excluded):
        rows = np.concatenate([rest, problem.rows([candidate])])
        gain = fit_gain(problem.equations, rows) - gain_of_rest
        if main - gain > MAX_CONFOUNDER_LOSS * main or gain < problem.null_distribution.threshold(candidate):
            continue
        inflation = problem.null_distribution.variance_inflation(candidate)
        if within_bounds(problem, fit(problem.equations, rows, inflation), problem.parameter_count(candidate)):
            more = _more_explained(problem, others, rows[len(base) :], key)
            found[candidate] = more - problem.penalty(candidate) + main_penalty
    return found


def is_large(problem: SelectionProblem, others: list[str], key: str) -> bool:
    """Return whether an effect beside others changes by MIN_LARGE_CHANGE times its minimum detectable magnitude."""
    known, size = problem.null_distribution, problem.parameter_count(key)
    gain = problem.gain([*others, key]) - problem.gain(others)
    change = fit(problem.equations, problem.rows([*others, key])).estimate[-size:]
    needed = MIN_LARGE_CHANGE**2 * known.threshold(key)
    return gain > needed and known.is_exceeded(key, change, MIN_LARGE_CHANGE)


def _lead(problem: SelectionProblem, others: list[str], candidate: str, key: str) -> float:
    """Return the log-likelihood by which a candidate explains more than an effect beside others, less its penalty."""
    more = _more_explained(problem, others, problem.rows([candidate]), key)
    return more - problem.penalty(candidate) + problem.penalty(key)


def _more_explained(problem: SelectionProblem, others: list[str], rows, key: str) -> float:
    """Return the log-likelihood by which parameters `rows` explain more than an effect beside others.

    Three things reduce it: differences between seconds beyond the noise (Vuong 1989: neither is the truth), the error
    of the simulator as a share of a strong effect, and the error of the pipeline's bias, which was estimated with the
    vehicle of the reference flights and is another one for the candidates.
    """
    base, own = problem.rows(others), problem.rows([*others, key])
    rows = np.concatenate([base, rows])
    difference = _gain_by_second(problem.equations, rows) - _gain_by_second(problem.equations, own)
    bias_error = 0.0
    if problem.uncorrected is not None:
        uncorrected = _gain_by_second(problem.uncorrected, rows) - _gain_by_second(problem.uncorrected, own)
        bias_error = min(BIAS_ERROR_SHARE * abs(np.sum(uncorrected - difference)), MAX_BIAS_ERROR)
    seconds = np.count_nonzero(problem.equations.samples)
    scatter = np.var(difference) * seconds / max(4.0 * abs(difference.sum()), 1e-300)
    inflation = max(scatter, problem.null_distribution.variance_inflation(key))  # both explain the same noise
    explained = max(fit_gain(problem.equations, rows), problem.gain([*others, key])) - problem.gain(others)
    errors = SIMULATOR_ERROR_SHARE * explained + bias_error
    return 0.5 * np.sign(difference.sum()) * max(abs(difference.sum()) - errors, 0.0) / inflation


def _gain_by_second(equations: NormalEquations, rows) -> np.ndarray:
    """Return the gain of the fit of the parameters `rows` in each second (s,)."""
    estimate = -solve(equations.total_information[np.ix_(rows, rows)], equations.total_gradient[rows])
    information = equations.information[:, rows][:, :, rows]
    return -2.0 * equations.gradient[:, rows] @ estimate - np.einsum("i,sij,j->s", estimate, information, estimate)
