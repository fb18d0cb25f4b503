"""Nuisance parameters of a recording, taken out of its residuals.

With the sensitivity N of the residuals to nuisance parameters, in their standard deviations, and noise S of the
residuals, their covariance is S S' + N N'. The residuals and all sensitivities are multiplied by the root of its
inverse, in the units of S: least squares on them is then least squares with the whole covariance. A nuisance parameter
of unlimited variance takes its direction out.
"""

import numpy as np


def without_nuisance(values, nuisance, noise) -> np.ndarray:
    """Return residuals or sensitivities without what nuisance parameters may explain.

    Args:
        values: (..., m, c).
        nuisance: (k, m, c) change of the residuals per standard deviation of each nuisance parameter.
        noise: (c,) standard deviation of the residuals.
    """
    columns = np.flatnonzero(np.any(nuisance != 0, axis=(0, 1)))
    if not len(columns):
        return values
    scaled = (nuisance[:, :, columns] / noise[columns]).reshape(len(nuisance), -1)
    variance, vectors = np.linalg.eigh(scaled @ scaled.T)
    kept = variance > 1e-12 * variance[-1]
    directions = (vectors.T[kept] @ scaled) / np.sqrt(variance[kept])[:, None]
    taken = 1.0 - 1.0 / np.sqrt(1.0 + variance[kept])
    own = (values[..., columns] / noise[columns]).reshape(*values.shape[:-2], -1)
    own = own - (taken * (own @ directions.T)) @ directions
    found = values.copy()
    found[..., columns] = own.reshape(*values.shape[:-1], len(columns)) * noise[columns]
    return found


def step_noise(residual, good) -> np.ndarray:
    """Return the noise (c,) of residuals (m, c) from their steps where `good` (m,), without slow changes."""
    return np.std(np.diff(residual[good], axis=0), axis=0) / np.sqrt(2.0) + 1e-12
