"""Regression of a residual on products, by halves of the flight: each half judges the coefficients of the other."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.residuals.propulsion import MAX_ABOVE_FULL_V

MAX_DISAGREEMENT = 0.5  # of the mean of two halves' coefficients, by which they may differ
DISAGREEMENT_ERRORS = 2.0  # standard errors by which they may differ where that is more
MIN_INDEPENDENT_SHARE = 1e-3  # of a product's square that the chosen ones do not contain
ONE_HALF_SHARE = 0.02  # of a product's square, below which a half of the flight does not show it
MAX_CANCELLED = 4.0  # squares of one product relative to those of the sum; products that cancel hold nowhere else
RIDGE = 1e-6  # of the sum of squares of a product, added for products that are zero in one half


class Level(NamedTuple):
    """The mean of a voltage, which its residual lacks: the charge at the start is unknown, but no pack is over full.

    Attributes:
        above_full: V, see `propulsion.voltage_above_full`.
        means: (q,) of the products.
        weight: squares of a volt, in independent samples.
    """

    above_full: float
    means: np.ndarray
    weight: float


@dataclass(frozen=True)
class HalfRegression:
    """The regression of one left side on q products, for each half of the flight.

    Attributes:
        side: left side.
        products: (q,).
        ranges: (q, 2).
        information: (2, q, q) products of the products, by half.
        gradient: (2, q) products of the products and the error, by half.
        squares: (2,) squares of the error, by half.
        noise: squares of its noise, of both halves.
        levels: the mean of a voltage in each recording that has one.
    """

    side: str
    products: tuple[str, ...]
    ranges: np.ndarray
    information: np.ndarray
    gradient: np.ndarray
    squares: np.ndarray
    noise: float
    levels: tuple[Level, ...] = ()

    def independent(self, chosen: list[int]) -> list[int]:
        """Return the products that the chosen ones do not contain."""
        total = self.information.sum(axis=0)
        diagonal = np.diag(total)
        remaining = diagonal.copy()
        if chosen:
            weights = solve(total[np.ix_(chosen, chosen)], total[chosen])
            remaining = remaining - np.einsum("ij,ij->j", total[chosen], weights)
        return [j for j in np.flatnonzero(remaining > MIN_INDEPENDENT_SHARE * diagonal) if j not in chosen]

    def strongest(self, chosen: list[int], others: list[int], count: int) -> list[int]:
        """Return those `count` of other products, independent of the chosen ones, that lower the squares most."""
        total, gradient = self.information.sum(axis=0), self.gradient.sum(axis=0)
        diagonal, remaining, slope = np.diag(total), np.diag(total), gradient
        if chosen:
            weights = solve(total[np.ix_(chosen, chosen)], total[chosen])
            remaining = diagonal - np.einsum("ij,ij->j", total[chosen], weights)
            slope = gradient - weights.T @ gradient[chosen]
        free = [j for j in others if remaining[j] > MIN_INDEPENDENT_SHARE * diagonal[j]]
        return sorted(free, key=lambda j: -(slope[j] ** 2) / remaining[j])[:count]

    def removed(self, rows: list[int], last: int = 1) -> float:
        """Return `lowered`, minus infinity if a coefficient of the last products differs between the halves.

        The same if a product is much larger than the sum: two that cancel each other here do not on another path.
        """
        squares, fits = self.lowered(rows)
        first, second = (one[-last:] for one in fits)
        apart = np.abs(first - second)
        unlike = apart > MAX_DISAGREEMENT * 0.5 * np.abs(first + second)
        if unlike.any():
            units = np.eye(len(rows))[:, -last:]
            variance = sum(np.sum(units * solve(one[np.ix_(rows, rows)], units), axis=0) for one in self.information)
            unlike &= apart > DISAGREEMENT_ERRORS * np.sqrt(variance)
        return -np.inf if unlike.any() or self._cancel(rows, sum(fits) / len(fits)) else squares

    def _cancel(self, rows: list[int], coefficients: np.ndarray) -> bool:
        """Return whether one of some products has MAX_CANCELLED times the squares of their sum."""
        total = self.information.sum(axis=0)[np.ix_(rows, rows)]
        of_sum = coefficients @ total @ coefficients
        return bool(np.any(coefficients**2 * np.diag(total) > MAX_CANCELLED * of_sum))

    def lowered(self, rows: list[int]) -> tuple[float, list[np.ndarray]]:
        """Return by how much the coefficients of one half lower the squares of the other, both ways, and them."""
        if not rows:
            return 0.0, []
        at, squares = np.ix_(rows, rows), 0.0
        total = self.information.sum(axis=0)[at]
        fits = [
            solve(self.information[i][at] + RIDGE * np.diag(np.diag(total)), self.gradient[i][rows]) for i in range(2)
        ]
        if min(one[rows[-1], rows[-1]] for one in self.information) < ONE_HALF_SHARE * total[-1, -1]:
            fits = [solve(total, self.gradient.sum(axis=0)[rows])] * 2  # a place that is passed in one half alone
        for i, other in ((0, 1), (1, 0)):
            x = fits[other]
            squares += float(2.0 * x @ self.gradient[i][rows] - x @ self.information[i][at] @ x)
            for level in self.levels:
                above = max(level.above_full - float(x @ level.means[rows]) - MAX_ABOVE_FULL_V, 0.0)
                squares -= 0.5 * level.weight * above**2
        return squares, fits
