"""Detection of gusts by the correlation of the wind between neighbouring windows of half a second.

Gusts are random and have no sensitivity of their own. The wind is estimated in each window. Estimates that contain only
noise of the sensors and the rotors, which is correlated over a tenth of a second, are uncorrelated between windows.
Those of gusts are not.
"""

from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.physics.terms import gust

WINDOW_S = 0.5  # s; longer than the residuals' filter, 0.08 s, shorter than horizontal gusts, 2.3 s (23 m at 10 m/s)
MIN_SIGNIFICANCE = 5.0  # standard deviations that the correlation must have
CERTAIN_SIGNIFICANCE = 7.5  # the same beside another effect, whose own error may look like weak gusts
REFERENCE_MARGIN = 1.5  # factor by which it must exceed that of any reference flight; larger overlooks weaker gusts
MAX_SCATTER_RATIO = 2.0  # factor on the significance that the scatter of the products themselves gives, as upper bound
MIN_REMAINING_SHARE = 0.6  # of the significance, after the equation terms are subtracted; less is no gust
MIN_AXIS_INFORMATION = 0.02  # of the weakest wind axis relative to the best, for a window to be used
MIN_ESTIMATES = 30  # wind components, three for each window; with fewer no correlation is computed


@dataclass(frozen=True)
class WindCorrelation:
    """Correlation of the wind between neighbouring windows.

    Attributes:
        covariance: mean product of the winds of two neighbouring windows, summed over the axes, m^2/s^2.
        standard_error: standard error of `covariance` from the noise of the residuals alone, m^2/s^2.
        significance: standard deviations by which the covariance exceeds zero, from noise and from scatter.
        pairs: number of pairs of windows.
    """

    covariance: float = 0.0
    standard_error: float = np.inf
    significance: float = 0.0
    pairs: int = 0


def wind_correlation(line: Linearisation, wind, sigma) -> WindCorrelation:
    """Return the correlation of the wind between neighbouring windows of a recording.

    Args:
        line: residuals of the recording.
        wind: (3, m, c) change of the residuals per 1 m/s of wind along each axis of the world.
        sigma: (c,) standard deviation of the residuals.
    """
    x, r = wind / sigma, line.residual / sigma
    window = np.floor((line.t - line.t[0]) / WINDOW_S).astype(int)
    winds, covariances = np.full((window[-1] + 1, 3), np.nan), np.zeros((window[-1] + 1, 3, 3))
    for k in range(len(winds)):
        rows = (window == k) & line.good
        information = np.einsum("imc,jmc->ij", x[:, rows], x[:, rows])
        values = np.linalg.eigvalsh(information)
        if values[0] > MIN_AXIS_INFORMATION * values[-1] > 0:
            covariances[k] = np.linalg.inv(information)
            winds[k] = -covariances[k] @ np.einsum("imc,mc->i", x[:, rows], r[rows])
    if np.isfinite(winds).sum() < MIN_ESTIMATES:
        return WindCorrelation()
    winds = winds - np.nanmean(winds, axis=0)
    known = np.isfinite(winds[1:] * winds[:-1]).all(axis=1)
    products = np.sum(winds[1:] * winds[:-1], axis=1)[known]
    noise = np.sqrt(np.sum(np.einsum("kij,kji->k", covariances[1:], covariances[:-1])[known])) + 1e-12
    scatter = np.sqrt(np.sum(np.square(products))) + 1e-12
    significance = min(products.sum() / noise, MAX_SCATTER_RATIO * products.sum() / scatter)
    return WindCorrelation(float(products.mean()), float(noise / len(products)), float(significance), len(products))


def gust_strength(covariance: float, pairs: int) -> tuple[float, float]:
    """Return the mean wind at 20 ft (m/s) of gusts (Dryden) with this covariance of windows, and its standard error."""
    model = gust.Gust(1.0)
    (sigmas, lengths), share = gust.scales(model), 0.0
    variance = 0.0
    for sigma, length in zip(sigmas, lengths, strict=True):
        time = float(length) / model.airspeed
        part = float(sigma) ** 2 * np.exp(-WINDOW_S / time)
        share, variance = share + part, variance + 2 * part**2 * (2 * time + WINDOW_S) / (pairs * WINDOW_S)
    wind = np.sqrt(max(covariance, 0.0) / share)
    return float(wind), float(0.5 * wind * np.sqrt(variance) / share)
