"""Normal equations of weighted least squares, as sums over each second of flight.

The residuals are r = r_0 + X x, with the sensitivities X and the parameter changes x in their steps. The weighted sum
of squares is r_0' r_0 + 2 g' x + x' A x with the gradient g = X' r_0 and the information matrix A = X' X.
"""

from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.gap.inference.sensitivity import Linearisation

MIN_EIGENVALUE = 1e-9  # of the information scaled to unit diagonal: smaller ones are rounding errors


@dataclass(frozen=True)
class NormalEquations:
    """Weighted sums over each of s seconds of flight, for p parameters.

    Attributes:
        squares: (s,) sum of squares of the normalised residuals.
        gradient: (s, p) products of the sensitivities and the residuals.
        information: (s, p, p) products of the sensitivities.
        samples: (s,) number of times with residuals.
    """

    squares: np.ndarray
    gradient: np.ndarray
    information: np.ndarray
    samples: np.ndarray

    @property
    def total_gradient(self) -> np.ndarray:
        """The gradient (p,) of the whole flight."""
        return self.gradient.sum(axis=0)

    @property
    def total_information(self) -> np.ndarray:
        """The information (p, p) of the whole flight."""
        return self.information.sum(axis=0)

    @property
    def parameter_information(self) -> np.ndarray:
        """The information (p,) of each parameter alone, over the whole flight."""
        return np.einsum("spp->p", self.information)


def accumulate(line: Linearisation, sigma) -> NormalEquations:
    """Return the normal equations of a linearisation.

    Args:
        line: the linearisation.
        sigma: (c,) standard deviation of each channel.
    """
    weight = 1.0 / np.asarray(sigma)
    second = np.floor(line.t - line.t[0]).astype(int)
    bounds = np.searchsorted(second, np.arange(second[-1] + 2))
    residual, count, seconds = line.residual * weight, len(line.sensitivity), len(bounds) - 1
    gradient, information = np.zeros((seconds, count)), np.zeros((seconds, count, count))
    for channels, rows in _blocks(line.sensitivity):
        x = line.sensitivity[np.ix_(rows, np.arange(len(line.t)), channels)] * weight[channels]
        square = np.ix_(rows, rows)
        for i, (begin, end) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
            part = x[:, begin:end].reshape(len(rows), -1)
            gradient[i, rows] += part @ residual[begin:end, channels].ravel()
            information[i][square] += part @ part.T
    squares = np.add.reduceat(np.sum(residual**2, axis=1), bounds[:-1]) * (np.diff(bounds) > 0)
    samples = np.add.reduceat(line.good.astype(int), bounds[:-1]) * (np.diff(bounds) > 0)
    return NormalEquations(squares, gradient, information, samples)


def _blocks(sensitivity) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return groups of channels that depend on the same parameters, and these parameters.

    Most parameters affect few channels: without the zeros the products take a fraction of the time.
    """
    affected = np.any(sensitivity != 0, axis=1).T
    patterns, pattern = np.unique(affected, axis=0, return_inverse=True)
    pattern = pattern.ravel()
    return [(np.flatnonzero(pattern == i), np.flatnonzero(rows)) for i, rows in enumerate(patterns) if rows.any()]


def concatenate(parts: list[NormalEquations]) -> NormalEquations:
    """Return the normal equations of recordings one after the other."""
    return NormalEquations(
        *(np.concatenate(values) for values in zip(*(vars(one).values() for one in parts), strict=True))
    )


def fit_gain(equations: NormalEquations, rows) -> float:
    """Return the gain of the parameters `rows`: by how much their common fit lowers the sum of squares."""
    information, gradient = equations.total_information[rows][:, rows], equations.total_gradient[rows]
    return float(gradient @ solve(information, gradient))


def solve(information, right) -> np.ndarray:
    """Return the minimum-norm solution of normal equations; directions without information get zero.

    Args:
        information: (p, p) symmetric.
        right: right-hand side, (p,) or (p, k).
    """
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse = np.where(values > MIN_EIGENVALUE, 1.0 / np.maximum(values, MIN_EIGENVALUE), 0.0)
    turned = vectors.T @ (right.T / scale).T
    return ((vectors @ (inverse * turned.T).T).T / scale).T
