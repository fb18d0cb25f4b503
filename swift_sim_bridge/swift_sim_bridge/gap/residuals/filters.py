"""Filters of the gap tool: both sides of every equation pass the same one."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import signal, sparse

from swift_sim_bridge.identification.grid import HALF_WIDTH_S, OUTPUT_HZ, bell

SIMPSON = np.array([1.0, 4.0, 1.0]) / 6.0  # mean over two steps (Simpson's rule)
DIFFERENCE = np.array([-0.5, 0.0, 0.5])  # times 1/dt: the mean slope over the same two steps
SECOND_DIFFERENCE = np.array([0.25, 0.0, -0.5, 0.0, 0.25])  # times 1/dt^2: DIFFERENCE applied twice
BATTERY_S = 1.0  # window for voltage and current: their sensors are slow


@dataclass(frozen=True)
class Filter:
    """The zero-phase low-pass filter of the residuals, as sparse matrices (m, n).

    Its response is 1/2 at 12 Hz; its output is thinned to about 50 Hz. `slope` applied to x equals `smooth` applied to
    dx/dt, and `curvature` equals `smooth_twice` applied to the second derivative, to fourth order in dt.

    Attributes:
        count: number n of uniform samples.
        dt: time step, s.
    """

    count: int
    dt: float

    @cached_property
    def rows(self) -> np.ndarray:
        """Index (m,) of the sample at the time of each filtered one."""
        half = max(1, round(HALF_WIDTH_S / self.dt)) + 2
        return np.arange(half, self.count - half, max(1, round(1.0 / (OUTPUT_HZ * self.dt))))

    @cached_property
    def smooth(self):
        """The filter."""
        return self.matrix(SIMPSON)

    @cached_property
    def slope(self):
        """The derivative after `smooth`."""
        return self.matrix(DIFFERENCE / self.dt)

    @cached_property
    def smooth_twice(self):
        """The filter with a second mean over two steps."""
        return self.matrix(np.convolve(SIMPSON, SIMPSON))

    @cached_property
    def slope_twice(self):
        """The derivative after `smooth_twice`."""
        return self.matrix(np.convolve(SIMPSON, DIFFERENCE / self.dt))

    @cached_property
    def curvature(self):
        """The second derivative after `smooth_twice`."""
        return self.matrix(SECOND_DIFFERENCE / self.dt**2)

    @cached_property
    def support(self):
        """The samples on which each filtered one depends, as a matrix of zeros and ones."""
        return abs(self.curvature) > 0

    def matrix(self, kernel):
        """Return the matrix of the low-pass filter after a kernel with an odd number of weights."""
        full = np.convolve(bell(max(1, round(HALF_WIDTH_S / self.dt))), kernel)
        middle, m = len(full) // 2, len(self.rows)
        columns = self.rows[:, None] + np.arange(-middle, middle + 1)
        return sparse.csr_matrix(
            (np.tile(full, m), columns.ravel(), np.arange(0, m * len(full) + 1, len(full))), shape=(m, self.count)
        )


def apply(matrix, values) -> np.ndarray:
    """Return a filter's matrix (m, n) times values (n, ...)."""
    return np.asarray(matrix @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def apply_to_batch(matrix, values) -> np.ndarray:
    """Return a filter's matrix (m, n) applied to values (b, n, k): (b, m, k)."""
    return np.moveaxis(apply(matrix, np.moveaxis(values, 0, 1)), 1, 0)


def derivative(values, dt: float) -> np.ndarray:
    """Return the derivative of values (..., n, k) by central differences of fourth order."""
    padded = np.concatenate([*[values[..., :1, :]] * 2, values, *[values[..., -1:, :]] * 2], axis=-2)
    inner, outer = padded[..., 3:-1, :] - padded[..., 1:-3, :], padded[..., 4:, :] - padded[..., :-4, :]
    return (8.0 * inner - outer) / (12.0 * dt)


def lagged(values, dt: float, time: float) -> np.ndarray:
    """Return values (n,) after a first-order lag of `time` s that is settled at the first value."""
    share = -np.expm1(-dt / time)
    return signal.lfilter([share], [1.0, share - 1.0], values, zi=[(1.0 - share) * values[0]])[0]


def averaged(values, dt: float) -> np.ndarray:
    """Return the moving average of values (n, k) over BATTERY_S."""
    half = max(1, round(0.5 * BATTERY_S / dt))
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    total = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), padded]), axis=0)
    return (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
