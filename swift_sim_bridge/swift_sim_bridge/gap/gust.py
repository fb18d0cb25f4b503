"""Air that wanders: gusts have no footprint, but the wind that each half second calls for goes on into the next.

Noise of the instruments and of the rotors is forgotten within a tenth of a second, so that neighbouring half seconds
agree by chance only.
"""

import numpy as np

from swift_sim_bridge.gap.footprints import Linearisation
from swift_sim_bridge.physics import gust

WINDOW_S = 0.5
LEAST_DEVIATIONS, MORE_THAN_ANY = 5.0, 1.5  # of the agreement by chance, and times the most that any twin shows
KEPT = 0.6  # share of the agreement that must be left beside what goes with known quantities
AXES_LEAST = 0.02  # information of a wind's axis against the best one, below which a window does not tell it


def agreement(line: Linearisation, wind, sigma) -> tuple[float, float, int]:
    """Return how much the winds of neighbouring half seconds agree: mean product, m^2/s^2; the same in standard
    deviations of chance; of how many pairs. wind (3, m, c): what a wind of 1 m/s along each axis does; sigma (c,)."""
    x, r = wind / sigma, line.residual / sigma
    window = np.floor((line.t - line.t[0]) / WINDOW_S).astype(int)
    winds = np.full((window[-1] + 1, 3), np.nan)
    for k in range(len(winds)):
        rows = (window == k) & line.good
        matrix = np.einsum("imc,jmc->ij", x[:, rows], x[:, rows])
        values = np.linalg.eigvalsh(matrix)
        if values[0] > AXES_LEAST * values[-1] > 0:
            winds[k] = -np.linalg.solve(matrix, np.einsum("imc,mc->i", x[:, rows], r[rows]))
    if np.isfinite(winds).sum() < 30:
        return 0.0, 0.0, 0
    winds = winds - np.nanmean(winds, axis=0)
    products = np.nansum(winds[1:] * winds[:-1], axis=1)[~np.isnan(winds[1:] * winds[:-1]).any(axis=1)]
    scatter = np.sqrt(np.sum(np.square(products))) + 1e-12
    return float(products.mean()), float(products.sum() / scatter), len(products)


def wind_of(product: float, pairs: int) -> tuple[float, float]:
    """Return the mean wind (m/s) of gusts whose half seconds agree so much, and its standard error."""
    one = gust.Gust(1.0)
    (sigmas, lengths), share = gust.scales(one), 0.0
    independent = 0.0
    for sigma, length in zip(sigmas, lengths, strict=True):
        time = float(length) / one.airspeed
        share += float(sigma) ** 2 * np.exp(-WINDOW_S / time)
        independent += pairs * WINDOW_S / (2 * time + WINDOW_S)
    wind = np.sqrt(max(product, 0.0) / share)
    return float(wind), float(wind * np.sqrt(0.5 / max(independent, 1.0)))
