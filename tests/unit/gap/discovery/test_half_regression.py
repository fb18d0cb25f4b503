"""The regression by halves, on columns whose coefficients are known."""

import numpy as np
import pytest

from swift_sim_bridge.gap.discovery.half_regression import HalfRegression

ROWS = 2000


def regression(columns: np.ndarray, error: np.ndarray) -> HalfRegression:
    """Return the regression of an error (n,) on columns (n, q)."""
    halves = [slice(None, ROWS // 2), slice(ROWS // 2, None)]
    return HalfRegression(
        side="force_y",
        products=tuple("abcdef"[: columns.shape[1]]),
        ranges=np.zeros((columns.shape[1], 2)),
        information=np.stack([columns[h].T @ columns[h] for h in halves]),
        gradient=np.stack([columns[h].T @ error[h] for h in halves]),
        squares=np.array([error[h] @ error[h] for h in halves]),
        noise=float(ROWS),
    )


@pytest.mark.parametrize(("likeness", "joins"), [(0.5, True), (0.98, False)])
def test_a_product_that_cancels_another_one_does_not_join_it(likeness, joins):
    """Two drags of similar form fit a small force by their difference: on another path they add up."""
    rng = np.random.default_rng(5)
    first, other = rng.standard_normal((2, ROWS))
    second = likeness * first + np.sqrt(1.0 - likeness**2) * other
    error = 3.0 * (first - second) / np.std(first - second) + rng.standard_normal(ROWS)
    problem = regression(np.stack([first, second], axis=-1), error)
    squares, (one, two) = problem.lowered([0, 1])
    assert squares > 0.85 * problem.squares.sum() and one == pytest.approx(two, rel=0.1)
    assert problem.removed([0, 1]) == (squares if joins else -np.inf)


def test_the_strongest_products_are_those_beside_the_chosen_ones():
    rng = np.random.default_rng(6)
    first, second, third = rng.standard_normal((3, ROWS))
    copy = first + 1e-3 * third
    error = 2.0 * first + second + rng.standard_normal(ROWS)
    problem = regression(np.stack([first, second, third, copy], axis=-1), error)
    assert problem.strongest([], [0, 1, 2], 2) == [0, 1]
    assert problem.strongest([0], [1, 2, 3], 3) == [1, 2]
