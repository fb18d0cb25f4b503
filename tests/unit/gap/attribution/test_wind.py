"""The search for local winds weighs each residual by the scatter of the reference flights at its time."""

import numpy as np
import pytest

from swift_sim_bridge.gap.attribution.wind import local_sigma
from swift_sim_bridge.gap.inference.sensitivity import Linearisation

ROWS, RATE = 1500, 50


def test_sigma_is_larger_where_reference_flights_scatter_more():
    rng, lines = np.random.default_rng(3), []
    for shift in range(12):
        residual = rng.standard_normal((ROWS, 2))
        residual[200:220, 0] *= 1.0 + 4.0 * rng.random()  # a wake, crossed at random
        t, sensitivity = (np.arange(ROWS) + shift) / RATE, np.zeros((0, ROWS, 2))
        lines.append(Linearisation(t, residual, sensitivity, np.ones(ROWS, bool)))
    sigma = local_sigma(lines, np.array([0.5, 2.0]), lines[0].t)
    assert np.median(sigma, axis=0) == pytest.approx([0.5, 2.0], rel=0.05)
    assert sigma[205:215, 0].min() > 1.0 and sigma[205:215, 1].max() < 3.0 and np.all(sigma >= [0.5, 2.0])
