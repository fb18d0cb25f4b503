"""Air that wanders: gusts have no footprint, but the wind that each half second calls for goes on into the next.

Noise of the instruments and of the rotors is forgotten within a tenth of a second, so that neighbouring half seconds
agree by chance only.
"""

from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.physics.terms import gust

WINDOW_S = 0.5
LEAST_DEVIATIONS, REFERENCE_MARGIN = 5.0, 1.5  # of the agreement by chance, and times the most that any twin shows
SCATTERED = 2.0  # times what the products' own scatter allows, an agreement counts at most
KEPT = 0.6  # share of the agreement that must be left beside what goes with known quantities
AXES_LEAST = 0.02  # information of a wind's axis against the best one, below which a window does not tell it


@dataclass(frozen=True)
class WindCorrelation:
    """How much the winds of neighbouring half seconds agree. product: mean, m^2/s^2; by_chance: its standard deviation
    by the residuals' noise alone; deviations: of chance and of the products' own scatter; pairs: how many."""

    product: float = 0.0
    by_chance: float = np.inf
    deviations: float = 0.0
    pairs: int = 0


def agreement(line: Linearisation, wind, sigma) -> WindCorrelation:
    """Return how much the winds agree; wind (3, m, c): what a wind of 1 m/s along each axis does; sigma (c,)."""
    x, r = wind / sigma, line.residual / sigma
    window = np.floor((line.t - line.t[0]) / WINDOW_S).astype(int)
    winds, doubts = np.full((window[-1] + 1, 3), np.nan), np.zeros((window[-1] + 1, 3, 3))
    for k in range(len(winds)):
        rows = (window == k) & line.good
        matrix = np.einsum("imc,jmc->ij", x[:, rows], x[:, rows])
        values = np.linalg.eigvalsh(matrix)
        if values[0] > AXES_LEAST * values[-1] > 0:
            doubts[k] = np.linalg.inv(matrix)
            winds[k] = -doubts[k] @ np.einsum("imc,mc->i", x[:, rows], r[rows])
    if np.isfinite(winds).sum() < 30:
        return WindCorrelation()
    winds = winds - np.nanmean(winds, axis=0)
    known = np.isfinite(winds[1:] * winds[:-1]).all(axis=1)
    products = np.sum(winds[1:] * winds[:-1], axis=1)[known]
    by_chance = np.sqrt(np.sum(np.einsum("kij,kji->k", doubts[1:], doubts[:-1])[known])) + 1e-12
    by_scatter = np.sqrt(np.sum(np.square(products))) + 1e-12
    deviations = min(products.sum() / by_chance, SCATTERED * products.sum() / by_scatter)
    return WindCorrelation(float(products.mean()), float(by_chance / len(products)), float(deviations), len(products))


def wind_of(product: float, pairs: int) -> tuple[float, float]:
    """Return the mean wind (m/s) of gusts whose half seconds agree so much, and its standard error."""
    one = gust.Gust(1.0)
    (sigmas, lengths), share = gust.scales(one), 0.0
    variance = 0.0
    for sigma, length in zip(sigmas, lengths, strict=True):
        time = float(length) / one.airspeed
        part = float(sigma) ** 2 * np.exp(-WINDOW_S / time)
        share, variance = share + part, variance + 2 * part**2 * (2 * time + WINDOW_S) / (pairs * WINDOW_S)
    wind = np.sqrt(max(product, 0.0) / share)
    return float(wind), float(0.5 * wind * np.sqrt(variance) / share)
