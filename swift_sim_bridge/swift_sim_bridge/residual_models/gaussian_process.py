"""Gaussian-process regression with a squared-exponential kernel of one length scale for all normalised inputs."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

MAX_SAMPLES = 800  # of the training set; the fit takes time in proportion to the cube of their number
LENGTHS = (1.0, 2.0, 4.0, 8.0)  # length scales that are tried, in standard deviations of the inputs
NOISES = (0.03, 0.1, 0.3, 1.0)  # noise variances that are tried, relative to the variance of the targets


@dataclass(frozen=True)
class GaussianProcess:
    """A fitted process: its mean at a query is the kernel between query and inputs, times the coefficients.

    Attributes:
        inputs: (n, d) training inputs, divided by `scale`.
        scale: (d,) standard deviation of each input times the length scale.
        coefficients: (n, k) weights of the training inputs.
    """

    inputs: np.ndarray
    scale: np.ndarray
    coefficients: np.ndarray


def fit(inputs, targets) -> GaussianProcess:
    """Return the process of the length scale and the noise with the largest marginal likelihood.

    Args:
        inputs: (n, d) inputs; at most MAX_SAMPLES of them are used, evenly spaced.
        targets: (n, k) targets.
    """
    chosen = np.unique(np.linspace(0, len(inputs) - 1, min(len(inputs), MAX_SAMPLES)).astype(int))
    inputs, targets = np.asarray(inputs)[chosen], np.asarray(targets)[chosen]
    deviation = np.maximum(np.std(inputs, axis=0), 1e-9)
    variance = np.maximum(np.var(targets, axis=0).mean(), 1e-30)
    best = (-np.inf, None)
    for length in LENGTHS:
        scaled = inputs / (deviation * length)
        values, vectors = np.linalg.eigh(_kernel(scaled, scaled))
        turned = vectors.T @ targets
        for noise in NOISES:
            eigen = np.maximum(values, 0.0) + noise
            fitted = np.sum(turned**2 / eigen[:, None]) / variance
            score = -0.5 * fitted - 0.5 * targets.shape[1] * np.sum(np.log(eigen))
            if score > best[0]:
                coefficients = vectors @ (turned / eigen[:, None])
                best = (score, GaussianProcess(scaled, deviation * length, coefficients))
    return best[1]


def _kernel(a, b) -> np.ndarray:
    """Return the kernel (m, n) between rows of a (m, d) and b (n, d)."""
    squared = np.sum(a * a, axis=1)[:, None] + np.sum(b * b, axis=1) - 2.0 * a @ b.T
    return np.exp(-0.5 * np.maximum(squared, 0.0))


def weights(squared_distance):
    """Return the kernel (..., n) at squared normalised distances (..., n)."""
    return jnp.exp(-0.5 * squared_distance)


def predict(model: GaussianProcess, queries):
    """Return the mean (m, k) at queries (m, d)."""
    return _kernel(np.asarray(queries) / model.scale, model.inputs) @ model.coefficients
