"""What another effect may hide of an effect's size: intervals over all explanations, not under one of them.

The fit of an effect holds if no further effect acts. Another one may act in its place, where a recording does not
distinguish them, or beside it, too weak or too similar to be detected there. The parameters are then distributed as a
mixture over these explanations, weighted by likelihood and prior (Bayesian model averaging, Hoeting et al. 1999).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.confounders import FITTED_NOISE, SIMULATOR_ERROR_SHARE
from swift_sim_bridge.gap.inference.stepwise import SelectionProblem

MIN_WEIGHT = 1e-3  # relative to an effect alone; explanations with less do not change an interval of 95 %
MIN_REACH_ERRORS = 2.0  # standard errors alone that shift and error must exceed; less hides nothing of the size
REACH_ERRORS = 8.0  # standard errors about the means within which quantiles are sought
BISECTIONS = 60


@dataclass(frozen=True)
class Rival:
    """An explanation of the recordings other than an effect alone.

    Attributes:
        weight: its probability relative to that of the effect alone.
        shift: (k,) by how much the effect's parameters differ in it.
        errors: (k,) standard errors of the parameters in it.
    """

    weight: float
    shift: np.ndarray
    errors: np.ndarray


def rivals_beside(
    problem: SelectionProblem, selected: list[str], key: str, excluded: Iterable[str], size: np.ndarray
) -> tuple[Rival, ...]:
    """Return the explanations in which one more effect acts beside the selected ones.

    Each effect of the catalogue is as likely as the others to be that one, before the recordings are seen. As it was
    not selected it is small, and its parameters count by the noise that they fit.

    Args:
        problem: the data.
        selected: the selected effects.
        key: the selected effect whose parameters are described.
        excluded: effects that must not be selected.
        size: (k,) steps of its parameters.
    """
    base, rows = problem.gain(selected), problem.rows(selected)
    candidates = set(problem.slices) - {*selected, *excluded}
    own = np.isin(rows, problem.rows([key]))
    found = []
    for candidate in sorted(candidates):
        gain = problem.gain([*selected, candidate]) - base - SIMULATOR_ERROR_SHARE * base
        inflation = problem.null_distribution.variance_inflation(candidate)
        score = 0.5 * gain / inflation - FITTED_NOISE * problem.parameter_count(candidate)
        weight = float(np.exp(min(score - np.log(len(candidates)), 0.0)))  # no likelier: the search has tried it
        if weight < MIN_WEIGHT:
            continue
        alone = stepwise.fit(problem.equations, rows, inflation)
        joint = stepwise.fit(problem.equations, problem.rows([*selected, candidate]), inflation)
        if not stepwise.within_bounds(problem, joint, problem.parameter_count(candidate)):
            continue
        shift = (joint.estimate[: len(rows)] - alone.estimate)[own]
        errors, own_errors = (np.sqrt(np.diag(one.covariance)[: len(rows)][own]) for one in (joint, alone))
        if np.any(np.abs(shift) + errors > MIN_REACH_ERRORS * own_errors):
            found.append(Rival(weight, shift * size, errors * size))
    return tuple(found)


def mixture_quantile(share: float, weights: np.ndarray, means: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return the quantile (k,) of each of k mixtures of n normal distributions.

    Args:
        share: of the mixture that lies below, 0 to 1.
        weights: (n,) of the distributions; they add up to one.
        means: (n, k) their means.
        errors: (n, k) their standard deviations; zero for a known value.
    """
    errors = np.maximum(errors, 1e-12 * np.maximum(np.abs(means).max(), 1e-300))
    low, high = (means - REACH_ERRORS * errors).min(axis=0), (means + REACH_ERRORS * errors).max(axis=0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = weights @ ndtr((middle - means) / errors)
        low, high = np.where(below < share, middle, low), np.where(below < share, high, middle)
    return 0.5 * (low + high)
