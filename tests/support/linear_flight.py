"""Linearised flights whose true parameters are known, and selection problems of them; no flight is simulated."""

import numpy as np

from swift_sim_bridge.gap.inference.normal_equations import accumulate
from swift_sim_bridge.gap.inference.null_distribution import estimate_null_distribution
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.inference.stepwise import SelectionProblem

SECONDS, RATE = 20, 50
SLICES = {"drag": slice(0, 1), "lift": slice(1, 3), "similar drag": slice(3, 4), "idle": slice(4, 5)}


def sensitivity_of(rng, similarity=1.0):
    """Return sensitivities (5, m, 2): the fourth is the first but for a share, the fifth is zero."""
    found = rng.standard_normal((5, SECONDS * RATE, 2))
    found[3] = similarity * found[0] + (1.0 - similarity) * found[3]
    found[4] = 0.0
    return found


def flight(seed, parameters=(0.0,) * 5, similarity=1.0):
    """Return a linearised recording in unit noise: residual = noise - sensitivity x parameters."""
    rng = np.random.default_rng([seed, 7])
    x = sensitivity_of(np.random.default_rng(3), similarity)
    residual = rng.standard_normal(x.shape[1:]) - np.einsum("p,pmc->mc", np.array(parameters), x)
    return Linearisation(np.arange(SECONDS * RATE) / RATE, residual, x, np.ones(SECONDS * RATE, bool))


def null_of(references, **options):
    return estimate_null_distribution(references, SLICES, **options)


def problem_of(parameters, similarity=1.0):
    null = null_of([flight(seed, similarity=similarity) for seed in range(24)])
    return SelectionProblem(accumulate(flight(100, parameters, similarity), null.sigma), SLICES, null)
