"""Changes of signals over short windows: what two channels of one motion must agree on, at any rate of either."""

import numpy as np

from swift_ros import geometry
from swift_ros.recording.log_mapping.conversion import Signal, quaternions_at

MIN_SAMPLES = 3  # of a slow signal in a window, on average
MAX_WINDOWS = 5000  # windows beyond are left out evenly: the checks need no more
MAX_SPAN = 1e6  # windows in a log: a day
LONG_STEP = 0.5  # of a window: with a longer step in it, a window is left out


def windows(first: Signal, second: Signal, width_s: float) -> np.ndarray:
    """Return begin and end (k, 2) s of windows within both signals, each with samples of both."""
    begin, end = max(first.t[0], second.t[0]), min(first.t[-1], second.t[-1])
    step = max(float(np.median(np.diff(signal.t))) for signal in (first, second))
    width = max(width_s, MIN_SAMPLES * step)
    if not 0.0 < (end - begin) / width < MAX_SPAN:
        return np.zeros((0, 2))
    edges = begin + width * np.arange(max(0, int((end - begin) / width)) + 1)
    found = np.stack([edges[:-1], edges[1:]], axis=-1)
    for signal in (first, second):
        gaps = np.flatnonzero(np.diff(signal.t) > max(LONG_STEP * width, 2.5 * step))
        bad = np.zeros(len(found), bool)
        for at in gaps[:10_000]:
            bad |= (found[:, 0] < signal.t[at + 1]) & (found[:, 1] > signal.t[at])
        found = found[~bad]
    return found[:: max(1, len(found) // MAX_WINDOWS)]


def of_rotation(attitude: Signal, spans) -> np.ndarray:
    """Return the rotation (k, 3) rad of attitudes over windows (k, 2) s, as body vectors."""
    before, after = (quaternions_at(attitude, spans[:, i]) for i in (0, 1))
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(before), after)
    return geometry.rotation_vector_from_quaternion(turn)


def of_value(signal: Signal, spans) -> np.ndarray:
    """Return the change (k, c) of a signal (n, c) over windows (k, 2) s."""
    before, after = (_interpolated(signal.t, signal.values, spans[:, i]) for i in (0, 1))
    return after - before


def of_integral(signal: Signal, spans) -> np.ndarray:
    """Return the integral (k, c) of a signal (n, c) over windows (k, 2) s, by the trapezoidal rule."""
    steps = np.diff(signal.t)[:, None]
    area = np.cumsum(0.5 * (signal.values[1:] + signal.values[:-1]) * steps, axis=0)
    return of_value(Signal(signal.t, np.concatenate([np.zeros_like(area[:1]), area])), spans)


def misfit(first, second) -> float:
    """Return the squared difference over the sum of squares: 0 for equal signals, 1 for unrelated, 2 for opposite."""
    return float(np.sum((first - second) ** 2) / max(np.sum(first**2) + np.sum(second**2), 1e-300))


def _interpolated(t, values, at) -> np.ndarray:
    return np.stack([np.interp(at, t, column) for column in values.T], axis=-1)
