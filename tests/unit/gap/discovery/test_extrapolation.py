"""Whether a summand is used beyond its recorded range: only where the inner half of it predicts the rest."""

import jax
import numpy as np
import pytest
from known_motion import motion
from known_residuals import residual_model, vehicle

from swift_ros import geometry
from swift_sim_bridge.gap.discovery import extrapolation
from swift_sim_bridge.gap.discovery.polynomial_search import Found, Residuals
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.filters import apply

NOISE, COEFFICIENT = 0.1, 0.02


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def range_before_and_after(force_y, noise: float = NOISE) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the range of COEFFICIENT v_x v_z before and after the test, where the flight shows `force_y` of it (N)."""
    one = residual_model()
    moving = motion(one.recording.t)
    v = geometry.rotate_inverse(moving.q_world_body, moving.v_world)
    product = v[:, 0] * v[:, 2]
    left = apply(one.filter.smooth, (force_y(product) - COEFFICIENT * product)[:, None])[:, 0] / vehicle().mass
    channels = [channel.id for channel in one.channels]
    residual = noise * np.random.default_rng(5).standard_normal((len(one.t), len(channels)))
    residual[:, channels.index("specific_force_y")] += left
    line = Linearisation(one.t, residual, np.zeros((0, *residual.shape)), one.good)
    residuals = Residuals((one,), [line], (np.full(len(channels), noise),))
    summand = Found("force_y", "v_x v_z", (float(product.min()), float(product.max())), 0.5)
    (tested,) = extrapolation.with_tested_ranges(residuals, vehicle(), [summand], {summand.name: COEFFICIENT})
    return summand.range, tested.range


def test_a_product_that_holds_from_half_of_its_range_on_is_used_twice_as_far():
    before, after = range_before_and_after(lambda product: COEFFICIENT * product)
    assert after == pytest.approx((2.0 * before[0], 2.0 * before[1]))


def test_a_force_that_saturates_ends_at_the_recorded_range():
    before, after = range_before_and_after(lambda product: COEFFICIENT * 8.0 * np.tanh(product / 8.0))
    assert after == before


def test_what_noise_hides_ends_at_the_recorded_range():
    before, after = range_before_and_after(lambda product: COEFFICIENT * product, noise=20.0)
    assert after == before
