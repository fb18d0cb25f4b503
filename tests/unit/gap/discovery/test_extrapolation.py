"""In which range a summand is used: beyond the recorded one only where the inner half of it predicts the rest."""

import jax
import lissajous_flight
import numpy as np
import pytest
from known_motion import motion
from known_residuals import residual_model, vehicle

from swift_ros import geometry
from swift_sim_bridge.gap.discovery import extrapolation
from swift_sim_bridge.gap.discovery.polynomial_search import Found, Residuals
from swift_sim_bridge.gap.inference.sensitivity import Linearisation, linearise, perturbed_variants
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.filters import apply
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

NOISE, COEFFICIENT = 0.1, 0.02


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def product():
    """Return v_x v_z (n,) of the motion."""
    moving = motion(residual_model().recording.t)
    v = geometry.rotate_inverse(moving.q_world_body, moving.v_world)
    return v[:, 0] * v[:, 2]


def used_ranges(force_y, summands: list[Found], noise: float = NOISE) -> list[tuple[float, float]]:
    """Return the ranges of summands, first of COEFFICIENT v_x v_z, where the flight shows `force_y` of v_x v_z (N)."""
    one = residual_model()
    left = apply(one.filter.smooth, (force_y(product()) - COEFFICIENT * product())[:, None])[:, 0] / vehicle().mass
    channels = [channel.id for channel in one.channels]
    residual = noise * np.random.default_rng(5).standard_normal((len(one.t), len(channels)))
    residual[:, channels.index("specific_force_y")] += left
    line = Linearisation(one.t, residual, np.zeros((0, *residual.shape)), one.good)
    residuals = Residuals((one,), [line], (np.full(len(channels), noise),))
    coefficients = dict.fromkeys((one.name for one in summands), 1e-9) | {summands[0].name: COEFFICIENT}
    return [one.range for one in extrapolation.with_tested_ranges(residuals, vehicle(), summands, coefficients)]


def recorded() -> Found:
    """Return v_x v_z as a summand, with its range in the motion."""
    return Found("force_y", "v_x v_z", (float(product().min()), float(product().max())), 0.5)


def test_a_product_that_holds_from_half_of_its_range_on_is_used_twice_as_far():
    (found,) = used_ranges(lambda x: COEFFICIENT * x, [recorded()])
    assert found == pytest.approx([2.0 * bound for bound in recorded().range])


def test_a_force_that_saturates_ends_at_the_recorded_range():
    assert used_ranges(lambda x: COEFFICIENT * 8.0 * np.tanh(x / 8.0), [recorded()]) == [recorded().range]


def test_what_noise_hides_ends_at_the_recorded_range():
    assert used_ranges(lambda x: COEFFICIENT * x, [recorded()], noise=20.0) == [recorded().range]


def test_a_summand_that_is_alone_vanishes_with_its_product_and_two_that_may_cancel_each_other_do_not():
    alone = Found("force_z", "thrust v_xy^2", (300.0, 900.0), 0.5)
    beside = Found("force_z", "thrust", (6.0, 9.0), 0.1)
    assert used_ranges(lambda x: 0.0 * x, [recorded(), alone], noise=20.0)[1] == (0.0, 900.0)
    assert used_ranges(lambda x: 0.0 * x, [recorded(), alone, beside], noise=20.0)[1:] == [alone.range, beside.range]


def test_a_voltage_that_is_lost_in_proportion_to_the_current_goes_on_to_twice_the_current_and_a_power_of_it_does_not():
    table, file = lissajous_flight.flight(2), lissajous_flight.vehicle()
    one = ResidualModel(read_recording(table, file))
    line = linearise(one, perturbed_variants(file, ()))
    residuals = Residuals((one,), [line], (np.full(len(one.channels), 0.02),))
    most = float(table["current"].values.max())
    for product, high, used in (
        ("current", most, 2.0 * most),
        ("over(current,18.1)", most - 18.1, 2.0 * most - 18.1),
        ("current^3", most**3, most**3),
    ):
        lost = Found("voltage", product, (0.0, high), 0.5)
        (found,) = extrapolation.with_tested_ranges(residuals, file, [lost], {lost.name: -1e-5})
        assert found.range == pytest.approx((0.0, used))
