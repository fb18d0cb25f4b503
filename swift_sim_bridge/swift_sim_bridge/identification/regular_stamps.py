"""Time stamps that scatter about regular rows.

A program that reads a sensor at a regular rate and stamps its samples when it gets round to it writes stamps that
scatter. At 5 m/s a scatter of 0.6 ms is one of 3 mm in the position, several times the noise of a motion capture, and
its second derivative is the force. Stamps may also scatter because the samples were taken at these very times. The
moving vehicle shows which: a sample that was taken at its stamp is where the vehicle was then.

Rows are counted, so that lost ones leave gaps. The regular times follow the stamps over seconds, so that a clock may
drift.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from swift_ros.recording.checks import Rejection
from swift_ros.recording.flight_table import FlightTable, Samples

SMOOTH = ("p_world", "q_world_body", "v_world", "gyro_body", "p_vio", "q_vio")  # channels that follow the motion
MIN_ROWS = 200  # of stamps from which a scatter is estimated
SCATTER_SHARE = 0.005, 0.15  # of a row: less is no scatter, with more rows cannot be counted
SAME_STAMPS_S = 2e-6  # in which stamps that differ by a constant agree: they are written in microseconds
TRACKING_GAIN = 0.05  # share of a stamp's deviation by which the counted time follows it
WINDOW_ROWS = 101  # over which regular times follow the stamps
SLOPE_ROWS = 3  # on each side, for the rate of change of a channel
DIFFERENCES = 4  # order of the differences that remove the motion
BINOMIAL = np.array([1.0, -4.0, 6.0, -4.0, 1.0])  # weights of these differences
# Largest share of the scatter in the samples with which they count as taken regularly, and what it must stay below by
# MARGIN standard errors: half way to samples that were taken at their stamps.
MAX_SHARE, SHARE_LIMIT, MARGIN = 0.2, 0.5, 5.0


def with_regular_stamps(table: FlightTable, progress: Callable[[str], None]) -> FlightTable:
    """Return the flight with regular times in place of stamps that scatter, where the samples were taken regularly.

    Args:
        table: the flight.
        progress: called with a line about each group of channels whose stamps are replaced, which is also among the
            `rejections` of the result.
    """
    left, channels, rejections = dict(table.channels), dict(table.channels), list(table.rejections)
    while left:
        first = next(iter(left.values()))
        group = {name: samples for name, samples in left.items() if _same_rows(samples.t, first.t)}
        left = {name: samples for name, samples in left.items() if name not in group}
        late_s = _lateness(group)
        if late_s is None:
            continue
        channels |= {name: Samples(samples.t - late_s, samples.values) for name, samples in group.items()}
        reason = (
            f"they scatter by {1e3 * late_s.std():.2g} ms about regular rows of {1e3 / first.rate_hz:.3g} ms; by the "
            "motion the samples were taken at regular times, which are used"
        )
        rejections.append(Rejection(float(first.t[0]), float(first.t[-1]), f"stamps of {', '.join(group)}", reason))
        progress(f"{table.name}: {rejections[-1].channel}: {reason}")
    return replace(table, channels=channels, rejections=tuple(rejections))


def _same_rows(t, other) -> bool:
    """Return whether stamps (n,) and (k,) are those of the same rows, perhaps later by a constant."""
    return len(t) == len(other) and float(np.ptp(t - other)) < SAME_STAMPS_S


def _lateness(group: dict[str, Samples]) -> np.ndarray | None:
    """Return by how much (n,) s each stamp of some channels is late; None where the stamps stand as they are.

    Args:
        group: channels with the same stamps.
    """
    t = next(iter(group.values())).t
    if len(t) < MIN_ROWS or (found := regular_times(t)) is None:
        return None
    regular, row = found
    late_s = t - regular
    low, high = SCATTER_SHARE
    if not low < late_s.std() * (len(t) - 1) / (t[-1] - t[0]) < high:
        return None
    columns = [
        column for name in SMOOTH if name in group for column in group[name].values.reshape(len(t), -1).T.astype(float)
    ]
    share, error = scatter_in_samples(columns, late_s, regular, row)
    return late_s if abs(share) < MAX_SHARE and abs(share) + MARGIN * error < SHARE_LIMIT else None


def regular_times(t) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the regular times (n,) s that stamps (n,) s scatter about, and the number (n,) of each row.

    None where the rows cannot be counted: stamps that are further than half a row from where they are expected.
    """
    period, row = float(np.median(np.diff(t))), np.zeros(len(t), int)
    expected = t[0]
    for i in range(1, len(t)):
        steps = max(1, round((t[i] - expected) / period))
        row[i] = row[i - 1] + steps
        expected += steps * period
        deviation = t[i] - expected
        expected += TRACKING_GAIN * deviation
        period += TRACKING_GAIN**2 / 4.0 * deviation / steps
    slope, offset = np.polyfit(row, t, 1)
    straight = offset + slope * row
    regular = straight + uniform_filter1d(t - straight, min(WINDOW_ROWS, len(t)), mode="nearest")
    return (regular, row) if np.max(np.abs(t - regular)) < 0.5 * slope else None


def scatter_in_samples(columns, late_s, t, row) -> tuple[float, float]:
    """Return which share of the stamps' scatter is in the samples, and its standard error.

    It is 0 for samples that were taken at the regular times, 1 for samples that were taken at their stamps: these
    deviate from a smooth motion in regular rows by the rate of change times the lateness. Differences of neighbouring
    rows remove the motion. An error of the rate of change makes the share smaller, and with it what the stamps matter.

    Args:
        columns: each (n,), of channels that follow the motion.
        late_s: (n,), by which the stamps are late.
        t: (n,) s, the regular times.
        row: (n,), number of each row.
    """
    whole = row[DIFFERENCES:] - row[:-DIFFERENCES] == DIFFERENCES  # no row is lost between these
    pairs = []
    for values in columns:
        pair = np.array([np.convolve(part, BINOMIAL, "valid")[whole] for part in (values, _slope(values, t) * late_s)])
        if scale := float(np.std(pair[0])) if whole.any() else 0.0:
            pairs.append(pair / scale)
    squares = sum(change @ change for _, change in pairs)
    if not squares:
        return 0.0, np.inf
    share = sum(changed @ change for changed, change in pairs) / squares
    variance = 0.0
    for changed, change in pairs:
        left = (changed - share * change) * change
        near = np.convolve(left, np.ones(2 * DIFFERENCES + 1), "same")  # neighbouring differences share samples
        variance += max(left @ near, left @ left)
    return float(share), float(np.sqrt(variance) / squares)


def _slope(values, t) -> np.ndarray:
    """Return the rate of change (n,) of a channel (n,), over SLOPE_ROWS on each side."""
    at = np.arange(len(t))
    after, before = np.minimum(at + SLOPE_ROWS, len(t) - 1), np.maximum(at - SLOPE_ROWS, 0)
    return (values[after] - values[before]) / (t[after] - t[before])
