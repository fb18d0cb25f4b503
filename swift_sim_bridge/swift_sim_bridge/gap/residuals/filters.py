"""Filters of the gap tool: both sides of every equation go through the same one."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import signal, sparse

from swift_sim_bridge.identification.grid import HALF_WIDTH_S, OUTPUT_HZ, bell

SIMPSON = np.array([1.0, 4.0, 1.0]) / 6.0  # the mean over two steps, of which a difference is the exact mean slope
PACK_S = 1.0  # over which voltage and current are averaged: their meters are slow, the pack is slower


@dataclass(frozen=True)
class Filter:
    """The low-pass (zero phase, half at 12 Hz) of n even samples dt s apart, thinned to about 50 Hz, as matrices
    (m, n): `smooth` of a quantity, `slope` its derivative; `twice` as smooth, and so `slope_twice` and `bend`, first
    and second derivative. A slope is the smoothed derivative, and a bend the twice smoothed second one, however the
    quantity moves between samples."""

    count: int
    dt: float

    @cached_property
    def rows(self) -> np.ndarray:
        """Sample (m,) in the middle of each filtered one."""
        half = max(1, round(HALF_WIDTH_S / self.dt)) + 2
        return np.arange(half, self.count - half, max(1, round(1.0 / (OUTPUT_HZ * self.dt))))

    @cached_property
    def smooth(self):
        return self.matrix(SIMPSON)

    @cached_property
    def slope(self):
        return self.matrix(np.array([-0.5, 0.0, 0.5]) / self.dt)

    @cached_property
    def twice(self):
        return self.matrix(np.convolve(SIMPSON, SIMPSON))

    @cached_property
    def slope_twice(self):
        return self.matrix(np.convolve(SIMPSON, np.array([-0.5, 0.0, 0.5]) / self.dt))

    @cached_property
    def bend(self):
        return self.matrix(np.array([0.25, 0.0, -0.5, 0.0, 0.25]) / self.dt**2)

    @cached_property
    def whole(self):
        """The matrix that tells how many samples each filtered one rests on."""
        return abs(self.bend) > 0

    def matrix(self, kernel):
        """Return the matrix of the low-pass after a kernel, an odd number of weights."""
        full = np.convolve(bell(max(1, round(HALF_WIDTH_S / self.dt))), kernel)
        middle, m = len(full) // 2, len(self.rows)
        columns = self.rows[:, None] + np.arange(-middle, middle + 1)
        return sparse.csr_matrix(
            (np.tile(full, m), columns.ravel(), np.arange(0, m * len(full) + 1, len(full))), shape=(m, self.count)
        )


def apply(matrix, values) -> np.ndarray:
    """Return the filter's matrix (m, n) times values (n, ...)."""
    return np.asarray(matrix @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def over_batch(matrix, values) -> np.ndarray:
    """Return the filter applied to values (b, n, k): (b, m, k)."""
    return np.moveaxis(apply(matrix, np.moveaxis(values, 0, 1)), 1, 0)


def derivative(values, dt: float) -> np.ndarray:
    """Return the derivative of values (n, k), of order four."""
    padded = np.pad(values, ((2, 2), (0, 0)), mode="edge")
    return (8.0 * (padded[3:-1] - padded[1:-3]) - (padded[4:] - padded[:-4])) / (12.0 * dt)


def lagged(values, dt: float, time: float) -> np.ndarray:
    """Return values (n,) behind a first-order lag of `time` s, which is settled at the first."""
    share = -np.expm1(-dt / time)
    return signal.lfilter([share], [1.0, share - 1.0], values, zi=[(1.0 - share) * values[0]])[0]


def averaged(values, dt: float) -> np.ndarray:
    """Return values (n, k) averaged over PACK_S around each: a pack is slow."""
    half = max(1, round(0.5 * PACK_S / dt))
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    total = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), padded]), axis=0)
    return (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
