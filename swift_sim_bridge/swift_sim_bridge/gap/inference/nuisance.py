"""Nuisance parameters of a recording, taken out of its residuals.

With the sensitivity N of the residuals to nuisance parameters, in standard deviations of both, the covariance of the
residuals is I + N N'. Residuals and all sensitivities are multiplied by the root of its inverse: least squares on them
is then least squares with the whole covariance. A nuisance parameter of unlimited variance takes its direction out.
"""

import numpy as np

MIN_VARIANCE = 1e-12  # of the largest: smaller ones are rounding errors


def without_nuisance(values, nuisances) -> np.ndarray:
    """Return residuals or sensitivities without what nuisance parameters may explain.

    Args:
        values: (..., m, c).
        nuisances: (k, m, c) change of the residuals per standard deviation of each parameter, over their noise.
            The channels that a parameter changes have the same noise, and parameters that share a channel share all.
    """
    found = values
    for rows, columns in _groups(nuisances):
        scaled = nuisances[rows][:, :, columns].reshape(len(rows), -1)
        variance, vectors = np.linalg.eigh(scaled @ scaled.T)
        kept = variance > MIN_VARIANCE * variance[-1]
        directions = (vectors.T[kept] @ scaled) / np.sqrt(variance[kept])[:, None]
        taken = 1.0 - 1.0 / np.sqrt(1.0 + variance[kept])
        own = values[..., columns].reshape(-1, scaled.shape[1])
        found = values.copy() if found is values else found
        found[..., columns] = (own - (taken * (own @ directions.T)) @ directions).reshape(
            *values.shape[:-1], len(columns)
        )
    return found


def _groups(nuisances) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the parameters (k,) that change the same channels, with these channels."""
    changes = np.any(nuisances != 0, axis=1)
    patterns, pattern = np.unique(changes, axis=0, return_inverse=True)
    return [(np.flatnonzero(pattern.ravel() == i), np.flatnonzero(row)) for i, row in enumerate(patterns) if row.any()]


def step_noise(residual, good) -> np.ndarray:
    """Return the noise (c,) of residuals (m, c) from their steps where `good` (m,), without slow changes."""
    return np.std(np.diff(residual[good], axis=0), axis=0) / np.sqrt(2.0) + 1e-12
