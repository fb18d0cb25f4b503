"""Normal equations of weighted least squares, summed over seconds of flight."""

from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.gap.inference.sensitivity import Linearisation

LEAST_EIGENVALUE = 1e-9


@dataclass(frozen=True)
class NormalEquations:
    """Weighted sums over s seconds of flight: squares (s,) of the residual, products (s, p) of columns and residual,
    matrix (s, p, p) of columns; samples (s,)."""

    squares: np.ndarray
    products: np.ndarray
    matrix: np.ndarray
    samples: np.ndarray


def accumulate(one: Linearisation, sigma) -> NormalEquations:
    """Return the sums of a linearisation, its channels weighted by one over `sigma` (c,) squared."""
    weight = 1.0 / np.asarray(sigma)
    second = np.floor(one.t - one.t[0]).astype(int)
    bounds = np.searchsorted(second, np.arange(second[-1] + 2))
    residual, count, seconds = one.residual * weight, len(one.sensitivity), len(bounds) - 1
    products, matrix = np.zeros((seconds, count)), np.zeros((seconds, count, count))
    for channels, rows in _blocks(one.sensitivity):
        x = one.sensitivity[np.ix_(rows, np.arange(len(one.t)), channels)] * weight[channels]
        square = np.ix_(rows, rows)
        for i, (begin, end) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
            part = x[:, begin:end].reshape(len(rows), -1)
            products[i, rows] += part @ residual[begin:end, channels].ravel()
            matrix[i][square] += part @ part.T
    squares = np.add.reduceat(np.sum(residual**2, axis=1), bounds[:-1]) * (np.diff(bounds) > 0)
    samples = np.add.reduceat(one.good.astype(int), bounds[:-1]) * (np.diff(bounds) > 0)
    return NormalEquations(squares, products, matrix, samples)


def _blocks(columns) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return channels with the rows of columns (p, m, c) that show in them, alike ones together: most show nowhere
    else."""
    shown = np.any(columns != 0, axis=1).T
    kinds, kind = np.unique(shown, axis=0, return_inverse=True)
    kind = kind.ravel()
    return [(np.flatnonzero(kind == i), np.flatnonzero(rows)) for i, rows in enumerate(kinds) if rows.any()]


def concatenate(many: list[NormalEquations]) -> NormalEquations:
    """Return the sums of several recordings one after the other."""
    return NormalEquations(
        *(np.concatenate(parts) for parts in zip(*(vars(one).values() for one in many), strict=True))
    )


def fit_gain(sums: NormalEquations, rows) -> float:
    """Return by how much the parameters `rows` together lower the sum of squares."""
    matrix, products = sums.matrix.sum(axis=0)[rows][:, rows], sums.products.sum(axis=0)[rows]
    return float(products @ solve(matrix, products))


def solve(matrix, right) -> np.ndarray:
    """Return the least solution of a normal equation; directions that nothing determines stay at zero."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    inverse = np.where(values > LEAST_EIGENVALUE, 1.0 / np.maximum(values, LEAST_EIGENVALUE), 0.0)
    turned = vectors.T @ (right.T / scale).T
    return ((vectors @ (inverse * turned.T).T).T / scale).T
