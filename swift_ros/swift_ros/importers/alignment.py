"""Alignment of a log's clock to another recording's clock by correlation of their gyros. No ROS."""

from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from swift_ros.errors import UsageError

RATE_HZ = 200.0  # Hz; both gyros are resampled to this rate, so the offset is found in steps of 5 ms and then refined
SMOOTHING_STEPS = 2.0  # standard deviation of the Gaussian filter of both gyros, in steps: 10 ms, one half at 19 Hz
MIN_OVERLAP_S = 3.0  # s; shortest overlap of both recordings; the shorter, the higher are correlations by chance
MIN_CORRELATION = 0.8  # below, the recordings are not of the same flight: equal motions have 1, unrelated ones 0
# The offset is ambiguous when another peak farther away than this (s) reaches this share of the highest one.
AMBIGUITY_DISTANCE_S, AMBIGUITY_SHARE = 0.25, 0.95
# For the drift: length of a window (s), largest correction of the offset in a window (s), its resolution (s), and the
# smallest number of windows for a drift: it needs an overlap of 32 s.
WINDOW_S, MAX_CORRECTION_S, CORRECTION_STEP_S = 8.0, 0.05, 0.0005
MIN_WINDOWS = 4


@dataclass(frozen=True)
class Alignment:
    """Conversion between two clocks: other = t + offset_s + drift * (t - middle_s).

    Attributes:
        offset_s: offset at `middle_s`, s.
        drift: relative error in rate.
        middle_s: middle of the overlap, s.
        correlation: of both gyros, at most 1.
    """

    offset_s: float
    drift: float
    middle_s: float
    correlation: float

    def at(self, t) -> np.ndarray:
        """Return times t (n,) s of the log on the other clock, s."""
        t = np.asarray(t, dtype=float)
        return t + self.offset_s + self.drift * (t - self.middle_s)

    def __str__(self) -> str:
        return (
            f"offset {self.offset_s:.4f} s, drift {1e6 * self.drift:.0f} ppm, correlation of the gyros "
            f"{self.correlation:.3f}"
        )


def align(t_log, gyro_log, t_other, gyro_other) -> Alignment:
    """Return the alignment of a log to another recording.

    Args:
        t_log: times (n,) of the log, s.
        gyro_log: its gyro (n, 3), rad/s.
        t_other: times (m,) of the other recording, s.
        gyro_other: its gyro (m, 3), rad/s.

    Raises:
        UsageError: the gyros do not correlate, or correlate at more than one offset.
    """
    log, other = (_resampled(t, gyro) for t, gyro in ((t_log, gyro_log), (t_other, gyro_other)))
    steps, correlation = _correlation(log[1], other[1])
    best = int(np.argmax(correlation))
    if correlation[best] < MIN_CORRELATION:
        raise UsageError(
            f"the two gyros do not agree over {MIN_OVERLAP_S:g} s: their largest correlation is "
            f"{correlation[best]:.2f}; give the bag of the same flight"
        )
    apart = np.abs(steps - steps[best]) > AMBIGUITY_DISTANCE_S * RATE_HZ
    if np.any(correlation[apart] > AMBIGUITY_SHARE * correlation[best]):
        raise UsageError("the two gyros agree at several offsets; fly a trajectory that does not repeat")
    coarse = other[0][0] - log[0][0] + steps[best] / RATE_HZ
    inside = (log[0] + coarse > other[0][0] + MAX_CORRECTION_S) & (log[0] + coarse < other[0][-1] - MAX_CORRECTION_S)
    middle = float(np.mean(log[0][inside]))
    offset, drift = _refined(log, other, coarse, inside, middle)
    return Alignment(offset, drift, middle, float(correlation[best]))


def _resampled(t, gyro) -> tuple[np.ndarray, np.ndarray]:
    """Return uniform times (k,) s and the filtered gyro (k, 3) at them, without its mean."""
    t, gyro = np.asarray(t, dtype=float), np.asarray(gyro, dtype=float)
    even = np.arange(t[0], t[-1], 1.0 / RATE_HZ)
    if len(even) < MIN_OVERLAP_S * RATE_HZ:
        raise UsageError(f"a gyro was recorded for {t[-1] - t[0]:.1f} s; the alignment needs {MIN_OVERLAP_S:g} s")
    width = max(1, round(len(t) / len(even)))  # a faster gyro is averaged over the step of RATE_HZ
    smooth = np.asarray(signal.lfilter(np.ones(width) / width, 1.0, gyro, axis=0))[width - 1 :]
    centre = t[width - 1 :] - 0.5 * (t[width - 1 :] - t[: len(t) - width + 1])
    values = np.stack([np.interp(even, centre, column) for column in smooth.T], axis=-1)
    return even, gaussian_filter1d(values - values.mean(axis=0), SMOOTHING_STEPS, axis=0)


def _correlation(log, other) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets (k,) in steps and the correlation (k,) over the overlap at each; -1 for a short overlap."""
    product = sum(signal.correlate(other[:, i], log[:, i], "full", "fft") for i in range(3))
    power_log, power_other = (np.sum(gyro**2, axis=1) for gyro in (log, other))
    ones_log, ones_other = np.ones(len(log)), np.ones(len(other))
    under_other = signal.correlate(power_other, ones_log, "full", "fft")
    under_log = signal.correlate(ones_other, power_log, "full", "fft")
    overlap = signal.correlate(ones_other, ones_log, "full", "fft")
    correlation = product / np.sqrt(np.maximum(under_other, 1e-9) * np.maximum(under_log, 1e-9))
    rotates = np.minimum(under_log, under_other) > 0.1 * min(power_log.sum(), power_other.sum())
    correlation[(overlap < MIN_OVERLAP_S * RATE_HZ) | ~rotates] = -1.0
    return np.arange(-len(log) + 1, len(other)), correlation


def _refined(log, other, coarse: float, inside, middle: float) -> tuple[float, float]:
    """Return offset (s) and drift, fitted to the best offsets of windows of the flight."""
    t, gyro, reference = log[0][inside], log[1][inside], CubicSpline(*other)
    windows = np.array_split(np.arange(len(t)), max(1, int((t[-1] - t[0]) / WINDOW_S)))
    found = []
    for rows in windows:
        tried = np.arange(-MAX_CORRECTION_S, MAX_CORRECTION_S + CORRECTION_STEP_S, CORRECTION_STEP_S)
        errors = [np.mean((reference(t[rows] + coarse + shift) - gyro[rows]) ** 2) for shift in tried]
        best = int(np.clip(np.argmin(errors), 1, len(tried) - 2))
        left, centre, right = errors[best - 1 : best + 2]
        curvature = left - 2.0 * centre + right
        shift = tried[best] + (0.5 * CORRECTION_STEP_S * (left - right) / curvature if curvature > 0 else 0.0)
        found.append((float(np.mean(t[rows])), coarse + shift, float(np.sum(gyro[rows] ** 2))))
    at, offsets, weights = np.array(found).T
    if len(found) < MIN_WINDOWS:
        return float(np.average(offsets, weights=weights)), 0.0
    drift, offset = np.polyfit(at - middle, offsets, 1, w=np.sqrt(weights))
    return float(offset), float(drift)
