"""Least squares with correct standard errors in correlated noise, and refusals with their reason."""

from dataclasses import replace

import numpy as np
import pytest

from swift_sim_bridge.identification.regression import Coefficient, Problem, fit

SECONDS, A_SECOND = 60, 20
N = SECONDS * A_SECOND
RNG = np.random.default_rng(5)
T = np.arange(N) / A_SECOND
CLUSTER = T.astype(int)
SLOW, QUICK = np.repeat(RNG.standard_normal((2, SECONDS)), A_SECOND, axis=1)


def coefficient(name, tolerance=0.5, **more):
    return Coefficient(name, "N", 0.0, tolerance, "loops", (name,), **more)


def linear(measured, **columns):
    """Return the problem of a sum of columns (N,)."""
    matrix = np.stack([*columns.values()], axis=-1)
    coefficients = tuple(map(coefficient, columns))
    arrays = (measured, np.zeros(len(measured), int), CLUSTER, T)
    return Problem("sum", coefficients, (("force", "N"),), *arrays, lambda theta: (matrix @ theta, matrix))


def correlated_noise(rng, seconds=1.0):
    """Return noise (N,) of variance 1 that is constant for some seconds."""
    return np.repeat(rng.standard_normal(int(SECONDS / seconds)), int(A_SECOND * seconds))


def test_intervals_contain_the_planted_values_in_correlated_noise():
    inside = []
    for seed in range(80):
        noise = correlated_noise(np.random.default_rng(seed))
        found = fit(linear(2.0 * SLOW - 1.0 * QUICK + noise, slow=SLOW, quick=QUICK))
        inside.append(np.abs(found.theta - [2.0, -1.0]) < found.half_interval95)
    assert 0.9 < np.mean(inside) <= 1.0
    assert found.standard_error[0] == pytest.approx(1 / np.sqrt(SECONDS), rel=0.5)  # seconds count, not samples


def test_of_two_nearly_collinear_coefficients_one_is_refused_with_the_name_of_the_other():
    parallel = SLOW + 1e-4 * QUICK
    found = fit(linear(2.0 * SLOW + correlated_noise(RNG), slow=SLOW, parallel=parallel, quick=QUICK))
    (name,) = {"slow", "parallel"} & set(found.refused)
    assert "does not distinguish it from " + ({"slow", "parallel"} - {name}).pop() in found.refused[name]
    assert found.theta[found.free].sum() == pytest.approx(2.0, abs=0.5) and found.free.sum() == 2


def test_a_coefficient_that_the_flight_does_not_excite_is_refused_and_keeps_its_value():
    problem = linear(2.0 * SLOW + correlated_noise(RNG), slow=SLOW, faint=1e-3 * QUICK, absent=0.0 * QUICK)
    problem = replace(problem, coefficients=tuple(replace(c, start=0.3) for c in problem.coefficients))
    found = fit(problem)
    assert "hardly excites" in found.refused["faint"] and "nothing that was measured" in found.refused["absent"]
    assert found.theta[1] == 0.3 and found.theta[0] == pytest.approx(2.0, abs=0.5)
    assert found.held_out["force"][1] < 0.8 * found.held_out["force"][0]


def test_a_coefficient_that_does_not_predict_held_out_blocks_is_refused():
    sign = np.repeat([1.0, -1.0, 1.0, -1.0, 1.0], N // 5)  # changes sign from one held-out block to the next
    found = fit(linear(SLOW * sign + 0.01 * correlated_noise(RNG), slow=SLOW))
    assert "held-out blocks of time no better" in found.refused["slow"] and found.theta[0] == 0.0


def test_a_nuisance_coefficient_that_the_flight_does_not_excite_keeps_its_prior():
    problem = linear(2.0 * SLOW + correlated_noise(RNG), slow=SLOW, offset=0.0 * T)
    known = Coefficient("offset", "N", 0.7, np.inf, prior=0.1)
    found = fit(replace(problem, coefficients=(problem.coefficients[0], known)))
    assert found.theta[1] == pytest.approx(0.7) and found.standard_error[1] == pytest.approx(0.1)


def test_a_crash_in_the_recording_does_not_change_the_estimates():
    crash = 300.0 * (RNG.random(N) < 0.01) * SLOW
    found = fit(linear(2.0 * SLOW + 0.1 * RNG.standard_normal(N) + crash, slow=SLOW, quick=QUICK))
    np.testing.assert_allclose(found.theta, [2.0, 0.0], atol=0.1)


def test_a_time_constant_is_recovered_from_ten_times_its_value():
    def linearise(theta):
        size, time = theta
        decay = np.exp(-T / time)
        return size * decay, np.stack([decay, size * decay * T / time**2], axis=-1)

    measured = linearise(np.array([3.0, 4.0]))[0] + 0.05 * RNG.standard_normal(N)
    coefficients = (replace(coefficient("size"), start=1.0), replace(coefficient("time"), start=40.0, low=0.01))
    arrays = (measured, np.zeros(N, int), CLUSTER, T)
    found = fit(Problem("decay", coefficients, (("force", "N"),), *arrays, linearise))
    assert np.abs(found.theta - [3.0, 4.0]) == pytest.approx(0.0, abs=0.1)


def test_a_few_seconds_identify_nothing():
    problem = linear(SLOW, slow=SLOW, quick=QUICK)
    short = slice(0, 5 * A_SECOND)
    matrix = np.stack([SLOW, QUICK], axis=-1)[short]
    cut = {name: getattr(problem, name)[short] for name in ("measured", "channel", "cluster", "t")}
    found = fit(replace(problem, **cut, linearise=lambda theta: (matrix @ theta, matrix)))
    assert "only 5 s" in found.refused["slow"] and not found.free.any()
