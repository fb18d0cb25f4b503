"""A log on another recording's clock: both have a gyro, and what turned the vehicle turned both. Pure."""

from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from swift_ros.errors import UsageError

RATE_HZ = 200.0  # at which the two are compared
FINEST_S = 0.0005
SMOOTH = 2.0  # steps of the comparison over which both are smoothed
LEAST_OVERLAP_S = 3.0
LEAST_LIKENESS = 0.8
RIVAL_S, RIVAL_SHARE = 0.25, 0.95  # another peak so far away must be so much lower
WINDOW_S, REACH_S = 8.0, 0.05  # for the drift: pieces, and how far each may be off
LEAST_WINDOWS = 4


@dataclass(frozen=True)
class Alignment:
    """How to read one clock by another: other = t + offset_s + drift * (t - middle_s). likeness: correlation of the
    gyros, 1 at best."""

    offset_s: float
    drift: float
    middle_s: float
    likeness: float

    def at(self, t) -> np.ndarray:
        """Return times t (n,) s of the log on the other clock."""
        t = np.asarray(t, dtype=float)
        return t + self.offset_s + self.drift * (t - self.middle_s)

    def __str__(self) -> str:
        return (
            f"offset {self.offset_s:.4f} s, drift {1e6 * self.drift:.0f} ppm, correlation of the gyros "
            f"{self.likeness:.3f}"
        )


def align(t_log, gyro_log, t_other, gyro_other) -> Alignment:
    """Return the alignment of a log's gyro (n, 3) at t_log (n,) s with another recording's (m, 3) at t_other (m,) s.

    Raises UsageError where they do not turn alike, or do so at more than one offset.
    """
    log, other = (_even(t, gyro) for t, gyro in ((t_log, gyro_log), (t_other, gyro_other)))
    steps, likeness = _likeness(log[1], other[1])
    best = int(np.argmax(likeness))
    if likeness[best] < LEAST_LIKENESS:
        raise UsageError(
            "the two gyros never turn alike for "
            f"{LEAST_OVERLAP_S:g} s: their correlation is {likeness[best]:.2f} at best; give the bag of "
            "the same flight"
        )
    apart = np.abs(steps - steps[best]) > RIVAL_S * RATE_HZ
    if np.any(likeness[apart] > RIVAL_SHARE * likeness[best]):
        raise UsageError("the two gyros turn alike at several offsets; fly something that does not repeat")
    coarse = other[0][0] - log[0][0] + steps[best] / RATE_HZ
    inside = (log[0] + coarse > other[0][0] + REACH_S) & (log[0] + coarse < other[0][-1] - REACH_S)
    middle = float(np.mean(log[0][inside]))
    offset, drift = _refined(log, other, coarse, inside, middle)
    return Alignment(offset, drift, middle, float(likeness[best]))


def _even(t, gyro) -> tuple[np.ndarray, np.ndarray]:
    """Return even times and the gyro there, without its mean."""
    t, gyro = np.asarray(t, dtype=float), np.asarray(gyro, dtype=float)
    even = np.arange(t[0], t[-1], 1.0 / RATE_HZ)
    if len(even) < LEAST_OVERLAP_S * RATE_HZ:
        raise UsageError(f"a gyro was recorded for {t[-1] - t[0]:.1f} s; to align it, {LEAST_OVERLAP_S:g} s are needed")
    width = max(1, round(len(t) / len(even)))  # a faster gyro is averaged, as the slower one hears it
    smooth = signal.lfilter(np.ones(width) / width, 1.0, gyro, axis=0)[width - 1 :]
    centre = t[width - 1 :] - 0.5 * (t[width - 1 :] - t[: len(t) - width + 1])
    values = np.stack([np.interp(even, centre, column) for column in smooth.T], axis=-1)
    return even, gaussian_filter1d(values - values.mean(axis=0), SMOOTH, axis=0)


def _likeness(log, other) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets in steps (k,) and the correlation (k,) over what then overlaps."""
    product = sum(signal.correlate(other[:, i], log[:, i], "full", "fft") for i in range(3))
    power_log, power_other = (np.sum(one**2, axis=1) for one in (log, other))
    ones_log, ones_other = np.ones(len(log)), np.ones(len(other))
    under_other = signal.correlate(power_other, ones_log, "full", "fft")
    under_log = signal.correlate(ones_other, power_log, "full", "fft")
    overlap = signal.correlate(ones_other, ones_log, "full", "fft")
    likeness = product / np.sqrt(np.maximum(under_other, 1e-9) * np.maximum(under_log, 1e-9))
    turned = np.minimum(under_log, under_other) > 0.1 * min(power_log.sum(), power_other.sum())
    likeness[(overlap < LEAST_OVERLAP_S * RATE_HZ) | ~turned] = -1.0
    return np.arange(-len(log) + 1, len(other)), likeness


def _refined(log, other, coarse: float, inside, middle: float) -> tuple[float, float]:
    """Return offset (s) and drift from the offsets that pieces of the flight call for."""
    t, gyro, course = log[0][inside], log[1][inside], CubicSpline(*other)
    pieces = np.array_split(np.arange(len(t)), max(1, int((t[-1] - t[0]) / WINDOW_S)))
    found = []
    for rows in pieces:
        tried = np.arange(-REACH_S, REACH_S + FINEST_S, FINEST_S)
        apart = [np.mean((course(t[rows] + coarse + shift) - gyro[rows]) ** 2) for shift in tried]
        best = int(np.clip(np.argmin(apart), 1, len(tried) - 2))
        left, middle_one, right = apart[best - 1 : best + 2]
        bend = left - 2.0 * middle_one + right
        shift = tried[best] + (0.5 * FINEST_S * (left - right) / bend if bend > 0 else 0.0)
        found.append((float(np.mean(t[rows])), coarse + shift, float(np.sum(gyro[rows] ** 2))))
    at, offsets, weights = np.array(found).T
    if len(found) < LEAST_WINDOWS:
        return float(np.average(offsets, weights=weights)), 0.0
    drift, offset = np.polyfit(at - middle, offsets, 1, w=np.sqrt(weights))
    return float(offset), float(drift)
