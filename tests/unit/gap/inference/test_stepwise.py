"""Selection among effects on normal equations whose true parameters are known; no flight is simulated."""

from dataclasses import replace

import numpy as np
import pytest
from linear_flight import RATE, SECONDS, SLICES, flight, null_of, problem_of

from swift_sim_bridge.gap.inference.normal_equations import accumulate, fit_gain
from swift_sim_bridge.gap.inference.null_distribution import scaled_to_recording
from swift_sim_bridge.gap.inference.stepwise import (
    SelectionProblem,
    backward_elimination,
    best_addition,
    bounded_step,
    fit,
    observable,
    passes_cross_validation,
    restricted_to,
    without_parameters,
)


@pytest.mark.parametrize(("motion", "share"), [(1.0, 0.25), (0.5, 1.0), (3.0, 0.25)])
def test_a_recording_that_is_partly_rejected_or_moves_less_than_the_reference_flights_detects_less(motion, share):
    """A quarter of the samples, or half the motion, doubles the minimum detectable magnitude; more motion than that of
    the reference flights does not lower it."""
    null, own = null_of([flight(seed, similarity=0.3) for seed in range(24)]), flight(50, similarity=0.3)
    finite = np.isfinite(null.minimum_detectable)
    recorded = replace(own, sensitivity=motion * own.sensitivity)
    ratio = null.minimum_detectable[finite] / scaled_to_recording(null, recorded, share).minimum_detectable[finite]
    assert max(ratio) <= 1.0 and np.median(ratio) == pytest.approx(0.5, rel=0.05)


def test_nothing_is_selected_where_no_effect_is_missing():
    assert best_addition(problem_of((0.0,) * 5), []) == (None, 0.0)


def test_planted_effects_are_selected_one_after_the_other_and_then_no_more():
    problem = problem_of((0.5, 0.4, 0.0, 0.0, 0.0), similarity=0.3)
    first, sigma = best_addition(problem, [])
    second, _ = best_addition(problem, [first])
    assert {first, second} == {"drag", "lift"} and sigma > 5
    assert best_addition(problem, [first, second])[0] is None
    found = fit(problem.equations, problem.rows(["drag", "lift"]))
    assert found.estimate == pytest.approx([0.5, 0.4, 0.0], abs=4 * np.sqrt(np.diag(found.covariance)).max())


def test_an_effect_that_others_make_superfluous_is_removed():
    problem = problem_of((0.5, 0.0, 0.0, 0.0, 0.0), similarity=0.3)
    assert backward_elimination(problem, ["similar drag", "drag"]) == ["drag"]


def test_an_estimate_outside_its_physical_bounds_is_not_selected_but_one_at_the_bound_is():
    problem = problem_of((0.5, 0.4, 0.0, 0.0, 0.0), similarity=0.3)
    low, high = np.full(5, -5.0), np.full(5, 5.0)
    assert best_addition(replace(problem, low=low, high=high), [])[0] == best_addition(problem, [])[0]
    at_bound = replace(problem, low=low, high=np.array([0.5, 0.4, 0.0, 5.0, 5.0]))
    outside = replace(problem, low=low, high=np.array([0.5, 0.2, 0.0, 5.0, 5.0]))
    assert best_addition(at_bound, ["drag"])[0] == "lift"
    assert best_addition(outside, ["drag"])[0] != "lift"


def test_a_parameter_that_the_flight_does_not_show_has_no_estimate():
    problem = problem_of((0.5, 0.4, 0.0, 0.0, 0.0), similarity=0.3)
    wide, narrow = np.full(5, 9.0), np.array([9.0, 9.0, 0.01, 9.0, np.inf])
    assert list(observable(problem.equations, -wide, wide)) == [True, True, True, True, False]
    kept = observable(problem.equations, -narrow, narrow)
    assert list(kept) == [True, True, False, True, True]  # without bounds it is not known
    estimate = fit(restricted_to(problem.equations, kept), problem.rows(["lift"])).estimate
    assert estimate[1] == 0.0
    assert estimate[0] == pytest.approx(fit(problem.equations, np.array([1])).estimate[0])


def test_a_parameter_without_any_data_has_a_finite_covariance_beside_others():
    problem = problem_of((0.5, 0.4, 0.0, 0.0, 0.0), similarity=0.3)
    equations, rows = problem.equations, problem.rows(["drag", "lift"])
    alone = fit(equations, rows[:1])
    nothing = np.isin(np.arange(len(equations.gradient[0])), rows[1:])
    seen = np.where(nothing, 1e-160, 1.0)  # as by a place that is far away
    rare = replace(
        equations,
        gradient=equations.gradient * seen,
        information=equations.information * np.outer(seen, seen),
    )
    with np.errstate(all="raise", under="ignore"):
        found = fit(rare, rows)
    assert np.isfinite(found.covariance).all()
    assert found.covariance[0, 0] == pytest.approx(alone.covariance[0, 0], rel=0.2)  # other degrees of freedom


def test_normal_equations_without_a_parameter_are_those_of_a_flight_without_it():
    null = null_of([flight(seed, similarity=0.3) for seed in range(24)])
    planted, unplanted = (
        accumulate(flight(5, parameters, 0.3), null.sigma) for parameters in ((0.7, 0, 0, 0, 0), (0.0,) * 5)
    )
    shifted = without_parameters(unplanted, np.array([0]), np.array([0.7]))
    for one, other in zip(vars(planted).values(), vars(shifted).values(), strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-9)


def test_the_minimum_detectable_magnitude_follows_from_the_noise_of_the_reference_flights():
    null = null_of([flight(seed, similarity=0.3) for seed in range(24)])
    expected = 5.0 / np.sqrt(2 * SECONDS * RATE)
    assert null.minimum_detectable[0] == pytest.approx(expected, rel=0.5)
    assert null.minimum_detectable[4] == np.inf


def test_noise_of_the_sensitivity_raises_the_minimum_detectable_magnitude():
    """As with a time offset in a hover: three quarters of the square of each sensitivity is the noise of the pose."""

    def noisy(seed, parameter=0.0):
        line, rng = flight(seed, (parameter, 0.0, 0.0, 0.0, 0.0), similarity=0.3), np.random.default_rng([seed, 8])
        noise = np.sqrt(3.0) * rng.standard_normal(line.sensitivity.shape)
        return replace(line, sensitivity=line.sensitivity + noise)

    null = null_of([noisy(seed) for seed in range(24)], noise_free=flight(0, similarity=0.3))
    apparent = replace(null, attenuation=np.zeros(5)).minimum_detectable[0]
    assert null.minimum_detectable[0] == pytest.approx(4.0 * apparent, rel=0.1)
    gains = [fit_gain(accumulate(noisy(100, factor * apparent), null.sigma), SLICES["drag"]) for factor in (1.5, 6.0)]
    assert gains[0] < null.threshold("drag") < gains[1]


def test_the_bias_of_the_pipeline_is_not_selected_as_an_effect():
    problem = problem_of((0.5, 0.0, 0.0, 0.0, 0.0), similarity=0.3)
    bias_gradient = 0.8 * problem.equations.gradient.mean(axis=0)
    uncorrected = replace(problem.equations, gradient=problem.equations.gradient - bias_gradient)
    assert best_addition(problem, [])[0] == "drag"
    assert best_addition(replace(problem, uncorrected=uncorrected), [])[0] is None


def two_parameters(problem):
    """Return the normal equations of drag and of the drag that is similar to it."""
    equations, rows = problem.equations, problem.rows(["drag", "similar drag"])
    information = equations.information[:, rows][:, :, rows]
    return replace(equations, gradient=equations.gradient[:, rows], information=information)


def test_a_parameter_that_stops_at_its_bound_leaves_the_rest_to_the_other():
    problem = problem_of((-0.4, 0.0, 0.0, 0.5, 0.0), similarity=0.5)  # drag cannot be negative
    low, high = np.array([0.0, -9.0]), np.array([9.0, 9.0])
    both = two_parameters(problem)
    alone = fit(problem.equations, problem.rows(["similar drag"])).estimate
    assert fit(problem.equations, problem.rows(["drag", "similar drag"])).estimate[0] < -0.05
    assert bounded_step(both, 0.0, -high, high)[0] < -0.05
    assert bounded_step(both, 0.0, low, high) == pytest.approx([0.0, *alone])


def test_damping_shortens_a_step_most_where_the_flight_has_least_information():
    both, far = two_parameters(problem_of((0.5, 0.0, 0.0, 0.5, 0.0), similarity=0.99)), np.full(2, 1e9)
    full, damped = bounded_step(both, 0.0, -far, far), bounded_step(both, 0.01, -far, far)
    assert damped.sum() == pytest.approx(full.sum(), rel=0.05)  # the sum of both is well known
    assert abs(damped[0] - damped[1]) < 0.5 * abs(full[0] - full[1])


@pytest.mark.parametrize("passes", [1, 2])
def test_an_effect_at_one_place_passes_cross_validation_once_the_flight_has_met_it_twice(passes):
    line = flight(100)
    here = np.any([(line.t > begin) & (line.t < begin + 2.0) for begin in (5.0, 15.0)[:passes]], axis=0)
    x = line.sensitivity.copy()
    x[0, ~here] = 0.0
    residual = np.random.default_rng(5).standard_normal(line.residual.shape) - 0.5 * x[0]
    null = null_of([replace(flight(seed), sensitivity=x) for seed in range(24)])
    equations = accumulate(replace(line, residual=residual, sensitivity=x), null.sigma)
    problem = SelectionProblem(equations, SLICES, null)
    assert problem.gain(["drag"]) > null.threshold("drag")
    assert passes_cross_validation(problem, [], "drag") == (passes == 2)
