"""Local winds and gusts: how a residual is weighed, and when gusts are certain."""

import numpy as np
import pytest

from swift_sim_bridge.gap.attribution.evidence import SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.wind import gusts_are_certain, local_sigma
from swift_sim_bridge.gap.effects import catalogue
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


@pytest.mark.parametrize(
    ("significance", "beside", "certain"), [(5.1, False, True), (5.1, True, False), (9.0, True, True)]
)
def test_gusts_that_another_effect_s_error_may_be_are_not_certain(significance, beside, certain):
    """A propeller that has lost 30 % of its thrust left gusts of 5.1 standard deviations in calm air."""
    gusts = SelectedEffect(catalogue.gusts(), np.array([1.1]), np.eye(1), significance)
    other = SelectedEffect(catalogue.payload(), np.zeros(3), np.eye(3), 40.0)
    assert gusts_are_certain(gusts, SearchResult((other,) if beside else (), (), None)) == certain
