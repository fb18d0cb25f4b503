"""Channels of a flight at common times, and the filter for both measurements and predictions."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable, Samples

GRID_RATES_HZ = (100.0, 1000.0)  # Hz, lowest and highest rate of the grid: at least 8 steps in the window of the filter
HALF_WIDTH_S = 0.04  # s, half the filter's window: its response falls to one half at 12 Hz
OUTPUT_HZ = 50.0  # Hz of the filtered samples: a higher rate adds no information after the filter
LONG_GAP = 5.0  # median sample intervals; in a longer gap a channel has no known value


def uniform_times(table: FlightTable, *channels: str) -> np.ndarray:
    """Return times (n,) s, as dense as the densest of the channels, over the span that all of them cover."""
    begin = max(table[name].t[0] for name in channels)
    end = min(table[name].t[-1] for name in channels)
    rate = np.clip(max(table[name].rate_hz for name in channels), *GRID_RATES_HZ)
    return begin + np.arange(max(0, int((end - begin) * rate) + 1)) / rate


def at(samples: Samples, t) -> np.ndarray:
    """Return a channel (n, k) or (n,) at times t (n,) s, interpolated linearly."""
    columns = samples.values.reshape(len(samples.t), -1)
    values = np.stack([np.interp(t, samples.t, column) for column in columns.T], axis=-1)
    return values[:, 0] if samples.values.ndim == 1 else values


def attitude_at(samples: Samples, t) -> np.ndarray:
    """Return attitudes (n, 4) at times t (n,) s."""
    q = samples.values
    turned_over = np.sum(q[1:] * q[:-1], axis=1) < 0
    sign = np.where(np.cumsum(np.concatenate([[False], turned_over])) % 2, -1.0, 1.0)
    return geometry.normalize(at(Samples(samples.t, q * sign[:, None]), t))


def velocity_at(table: FlightTable, t) -> np.ndarray:
    """Return velocities (n, 3) m/s in the world: as recorded, else central differences over five positions."""
    if "v_world" in table:
        return at(table["v_world"], t)
    p = table["p_world"]
    rows = np.arange(len(p.t))
    before, after = np.maximum(rows - 2, 0), np.minimum(rows + 2, len(rows) - 1)
    v_world = (p.values[after] - p.values[before]) / (p.t[after] - p.t[before])[:, None]
    return at(Samples(p.t, v_world), t)


def known(table: FlightTable, channels, t, open_ended: bool = False) -> np.ndarray:
    """Return at which times all channels have samples nearby on both sides.

    Args:
        table: the flight.
        channels: names.
        t: (n,) s.
        open_ended: whether times just before the first sample and just after the last count as well.

    Returns:
        (n,) bool.
    """
    good = np.ones(len(t), bool)
    for name in channels:
        stamps = table[name].t
        longest = LONG_GAP * np.median(np.diff(stamps))
        right, reach = np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1), longest if open_ended else 0.0
        good &= (stamps[right] - stamps[right - 1] <= longest) & (t >= stamps[0] - reach) & (t <= stamps[-1] + reach)
    return good


def bell(half: int) -> np.ndarray:
    """Return the weights (2 half + 1,) of a raised cosine, whose sum is one."""
    weights = 0.5 + 0.5 * np.cos(np.pi * np.arange(-half, half + 1) / (half + 1))
    return weights / weights.sum()


@dataclass(frozen=True)
class Filter:
    """Zero-phase low-pass filter on a uniform grid, with output at OUTPUT_HZ.

    smooth(dx/dt) equals slope(x) up to the fourth order of dt, so that a predicted derivative is compared with a
    measurement without differentiating the measurement.

    Attributes:
        dt: s, time step of the grid.
    """

    dt: float

    @property
    def window(self) -> np.ndarray:
        """Weights of the filter."""
        return bell(max(1, round(HALF_WIDTH_S / self.dt)))

    @property
    def reach(self) -> int:
        """Number of grid steps on each side on which a filtered sample depends."""
        return len(self.window) // 2 + 1

    @property
    def rows(self) -> int:
        """Grid steps between two filtered samples."""
        return max(1, round(1.0 / (OUTPUT_HZ * self.dt)))

    def smooth(self, x) -> np.ndarray:
        """Return x (n, ...) filtered, (m, ...), averaged over two steps (Simpson) as `slope` is."""
        return self._thin(np.convolve(self.window, [1 / 6, 4 / 6, 1 / 6]), x)

    def slope(self, x) -> np.ndarray:
        """Return the time derivative of x (n, ...), filtered, (m, ...)."""
        return self._thin(np.convolve(self.window, [0.5, 0.0, -0.5]) / self.dt, x)

    def whole(self, good) -> np.ndarray:
        """Return which filtered samples (m,) depend on good grid rows (n,) alone."""
        return self._thin(np.ones(2 * self.reach + 1), (~good).astype(float)) < 0.5

    def _thin(self, kernel, x) -> np.ndarray:
        """Return x convolved with a kernel, every `rows`-th sample."""
        x = np.asarray(x, dtype=float)
        columns = x.reshape(len(x), -1).T
        filtered = np.stack([np.convolve(column, kernel, "valid")[:: self.rows] for column in columns], axis=-1)
        return filtered.reshape(-1, *x.shape[1:])
