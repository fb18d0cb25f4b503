"""Local winds and gusts in residuals with known sensitivity to the wind."""

import numpy as np
import pytest

from swift_sim_bridge.gap.inference.gust_correlation import wind_correlation
from swift_sim_bridge.gap.inference.local_wind_search import find_local_wind, refined
from swift_sim_bridge.gap.inference.sensitivity import Linearisation

ROWS, RATE = 1500, 50


def line_of(residual) -> Linearisation:
    sensitivity, good = np.zeros((0, *residual.shape)), np.ones(len(residual), bool)
    return Linearisation(np.arange(len(residual)) / RATE, residual, sensitivity, good)


def sensitivity_to_wind(rng):
    """Return the change (3, m, 3) of three residuals per 1 m/s of wind."""
    return 0.4 * np.eye(3)[:, None, :] + 0.05 * rng.standard_normal((3, ROWS, 3))


def test_a_local_wind_is_found_where_it_is_with_its_velocity():
    rng, t = np.random.default_rng(1), np.arange(ROWS) / RATE
    path = 8.0 * np.stack([np.cos(0.8 * t), np.sin(0.8 * t), 0.1 * np.sin(0.5 * t)], axis=1)  # laps of a circle
    wind = sensitivity_to_wind(rng)
    center, velocity = path[10], np.array([0.0, 2.0, 0.0])  # between two centres that the search tries
    weight = np.maximum(1.0 - np.sum((path - center) ** 2, axis=1) / 2.2**2, 0.0) ** 2
    residual = 0.1 * rng.standard_normal((ROWS, 3)) - np.einsum("i,imc->mc", velocity, wind) * weight[:, None]
    place = find_local_wind(line_of(residual), wind, path, np.full(3, 0.1))
    assert np.linalg.norm(place.center - center) < 1.5 and place.velocity == pytest.approx(velocity, abs=0.5)
    closer = refined(place, line_of(residual), wind, path, np.full(3, 0.1))
    assert np.linalg.norm(closer.center - center) < 0.2 and closer.radius == pytest.approx(2.2, abs=0.25)
    assert closer.velocity == pytest.approx(velocity, abs=0.1) and closer.gain > place.gain


def test_gusts_are_distinguished_from_noise_by_their_correlation_over_half_a_second():
    rng = np.random.default_rng(2)
    wind = sensitivity_to_wind(rng)
    noise = 0.2 * rng.standard_normal((ROWS, 3))
    white = wind_correlation(line_of(noise), wind, np.full(3, 0.2))
    keep, air = np.exp(-1.0 / (2.0 * RATE)), np.zeros((ROWS, 3))
    for i in range(1, ROWS):
        air[i] = keep * air[i - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    gusty = wind_correlation(line_of(noise - np.einsum("mi,imc->mc", air, wind)), wind, np.full(3, 0.2))
    assert abs(white.significance) < 4.0 < 5.0 < gusty.significance
    assert gusty.covariance == pytest.approx(3 * 0.78, rel=0.6)
