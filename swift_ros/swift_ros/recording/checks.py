"""Detects the parts of a recording that cannot be measurements, for any sensor. No ROS.

A recording is a table with one row per time step. Each rejected part is reported with its time, channel and reason; the
other rows are kept. Six properties identify bad data:

1. Times do not increase, or come from another clock.
2. A value is not a number.
3. A value is outside the range of such a sensor.
4. A noisy sensor repeats exactly the same value.
5. The values lie on exactly one straight line: resampling fills gaps, and the time after the end of a log, by lines.
6. The values stay at the end of the sensor's range.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

# A run of constant or straight values is rejected only above these three bounds. Larger ones keep more filled-in data,
# smaller ones reject more measurements.
MIN_RUN_SAMPLES = 15  # samples; a shorter run is at most one or two lost packets
MIN_RUN_S = 0.03  # s, for sensors faster than 500 Hz, which repeat values because of their coarse resolution
MIN_TYPICAL_RUNS = 5  # times the typical run of a channel that was resampled from a slower one

GAP_STEPS = 5  # median time steps; a longer step is reported as a gap
# A step between sorted times above both bounds separates two clocks: pauses in a recording are taken to be shorter.
MIN_OTHER_CLOCK_S = 600.0  # s
MIN_OTHER_CLOCK_STEPS = 10_000  # median time steps

# A peak counts as clipped when the values stay at the extreme for this long between two large steps.
MIN_CLIPPED_RUNS = 5  # typical times between two changes of value
MIN_CLIPPED_STEPS = 5.0  # typical steps between neighbouring values, before and after the peak
MIN_CLIPPED_SAMPLES = 10  # samples of a channel in all clipped peaks; fewer at the extreme can be chance

MIN_RESAMPLED_SHARE = 0.5  # share of samples on straight lines from which a channel was resampled from a slower one
TEXT_RESOLUTION = 2e-9  # relative; rounding error of a value in a text file with nine decimals


@dataclass(frozen=True)
class SensorChannel:
    """Samples of one sensor with the limits of what it can measure.

    Attributes:
        name: for the report.
        values: (n,) or (n, k), one row per time step.
        low: smallest possible value.
        high: largest possible value.
        unit: of the values, for the report.
        noisy: the sensor never repeats exactly the same values in all columns, not even at rest (true for a gyro, false
            for an unarmed motor).
        min_range: no such sensor has a smaller measurement range; infinite when unknown.
    """

    name: str
    values: np.ndarray
    low: float
    high: float
    unit: str
    noisy: bool = True
    min_range: float = np.inf


@dataclass(frozen=True)
class Rejection:
    """A part of a channel that was rejected.

    Attributes:
        begin_s: first time, s.
        end_s: last time, s.
        channel: its name.
        reason: why it is not a measurement.
    """

    begin_s: float
    end_s: float
    channel: str
    reason: str

    def since(self, begin_s: float) -> "Rejection":
        """Return the rejection with its times relative to `begin_s`."""
        return replace(self, begin_s=self.begin_s - begin_s, end_s=self.end_s - begin_s)

    def as_json(self) -> dict:
        """Return the entry of `rejected_data` in a result file."""
        return {"time": [self.begin_s, self.end_s], "channel": self.channel, "reason": self.reason}

    def __str__(self) -> str:
        return f"{self.begin_s:.2f} s to {self.end_s:.2f} s, {self.channel}: {self.reason}"


def check_time(t) -> tuple[np.ndarray, list[Rejection]]:
    """Check the times of a recording.

    Args:
        t: times (n,), s.

    Returns:
        A mask (n,) of the valid rows, and the rejections. Gaps are reported too, although they reject no row.
    """
    t = np.asarray(t, dtype=float)
    good = _on_main_clock(t)
    far = np.isfinite(t) & ~good
    newest = np.maximum.accumulate(np.where(good, t, -np.inf))
    good[1:] &= t[1:] > newest[:-1]
    found = [(far, "are far from all others: from another clock"), (~good & ~far, "do not increase")]
    rejections = [
        Rejection(*_span(t, first, last), "t", f"{last - first + 1} times {reason}")
        for mask, reason in found
        for first, last in true_runs(mask)
    ]
    kept = t[good]
    steps = np.diff(kept)
    if steps.size:
        for i in map(int, np.flatnonzero(steps > GAP_STEPS * np.median(steps))):
            rejections.append(Rejection(kept[i], kept[i + 1], "t", f"no data for {steps[i]:.3g} s"))
    return good, rejections


def _on_main_clock(t) -> np.ndarray:
    """Return a mask (n,) of the times that are numbers and belong to the clock of most times.

    Two clocks are recognised by a step between them that is longer than any pause of a recording.
    """
    times = np.sort(t[np.isfinite(t)])
    steps = np.diff(times)
    if not steps.size:
        return np.isfinite(t)
    first = np.flatnonzero(steps > max(MIN_OTHER_CLOCK_S, MIN_OTHER_CLOCK_STEPS * np.median(steps))) + 1
    begin, end = np.concatenate([[0], first]), np.concatenate([first, [len(times)]])
    most = np.argmax(end - begin)
    return (t >= times[begin[most]]) & (t <= times[end[most] - 1])


def _span(t, first: int, last: int) -> tuple[float, float]:
    """Return the smallest and largest time of rows `first` to `last`, or of their neighbours if these are NaN."""
    for rows in (t[first : last + 1], t[max(first - 1, 0) : last + 2]):
        if np.isfinite(rows).any():
            return float(np.min(rows[np.isfinite(rows)])), float(np.max(rows[np.isfinite(rows)]))
    return 0.0, 0.0


def check_channel(t, channel: SensorChannel) -> tuple[np.ndarray, list[Rejection]]:
    """Check the samples of one sensor.

    Args:
        t: increasing times (n,), s.
        channel: the samples and their limits.

    Returns:
        A mask (n,) of the valid rows, and the rejections.
    """
    t = np.asarray(t, dtype=float)
    values = np.asarray(channel.values, dtype=float).reshape(len(t), -1)
    finite = np.all(np.isfinite(values), axis=1)
    inside = np.all((values >= channel.low) & (values <= channel.high), axis=1) | ~finite
    straight, constant = _straight_and_constant(t, values)
    found = [(~finite, "not a number"), (~inside, _range_error(channel, values[~inside]))]
    found.append((straight & ~constant, "on exactly one straight line: interpolated, not measured"))
    if channel.noisy:
        found.append((constant, "exactly constant: the sensor is frozen"))
    clipped = _clipped(np.where((finite & inside)[:, None], values, np.nan), channel.min_range)
    found.append((clipped, "constant at its largest or smallest value: clipped"))
    bad = np.any([mask for mask, _ in found], axis=0)
    rejections = []
    for first, last in true_runs(bad):
        reasons = [reason for mask, reason in found if mask[first : last + 1].any()]
        rejections.append(Rejection(t[first], t[last], channel.name, "; ".join(reasons)))
    return ~bad, rejections


def true_runs(mask) -> list[tuple[int, int]]:
    """Return first and last index of each run of True in a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(first), int(after) - 1) for first, after in edges.reshape(-1, 2)]


def constant_runs(t, values, min_s: float) -> list[tuple[int, int]]:
    """Return first and last index of each long run of equal rows.

    Args:
        t: times (n,), s.
        values: (n, ...).
        min_s: shortest run, s. A run must also be several times longer than the typical one of the channel.
    """
    values = np.asarray(values).reshape(len(t), -1)
    same = (values[1:] == values[:-1]).all(axis=1)
    changed = t[1:][~same]
    typical = np.median(np.diff(changed)) if len(changed) > 1 else 0.0
    runs = [(first, last + 1) for first, last in true_runs(same)]
    return [(first, last) for first, last in runs if t[last] - t[first] >= max(min_s, MIN_TYPICAL_RUNS * typical)]


def _clipped(values, min_range: float) -> np.ndarray:
    """Return a mask (n,) of the rows in which a column of values (n, k) is clipped at its own extreme.

    Unlike at a peak, the value is constant there for longer than anywhere else, with a large step before and after.
    """
    marked = np.zeros(len(values), bool)
    for column in values.T:
        for side in (column, -column):
            top = np.max(side, initial=-np.inf, where=np.isfinite(side))
            if np.isfinite(top) and top >= min_range:
                marked |= _clipped_at(side, top)
    return marked


def _clipped_at(column: NDArray[np.float64], top: float) -> np.ndarray:
    """Return a mask (n,) of the rows in which a column is clipped at its largest value `top`."""
    steps, nothing = np.abs(np.diff(column)), np.zeros(len(column), bool)
    if np.count_nonzero(steps > 0) < MIN_CLIPPED_SAMPLES:
        return nothing
    min_samples = MIN_CLIPPED_RUNS * np.median(np.diff(np.flatnonzero(steps != 0)))
    min_step = MIN_CLIPPED_STEPS * np.median(np.diff(np.unique(column[np.isfinite(column)])))
    # two rows away, because the last step before a clipped value may be a short one
    below_top = np.concatenate([[np.inf] * 2, top - column, [np.inf] * 2])
    count = sum(
        last - first + 1
        for first, last in true_runs(column == top)
        if last - first + 1 >= min_samples and min(below_top[first], below_top[last + 4]) >= min_step
    )
    return column == top if count >= MIN_CLIPPED_SAMPLES else nothing


def _range_error(channel: SensorChannel, values) -> str:
    if not values.size:
        return ""
    worst = values.flat[np.argmax(np.abs(values))]
    reached = f"{worst:.6g} {channel.unit}".rstrip()
    return f"reaches {reached}, outside of {channel.low:g} to {channel.high:g}"


def _straight_and_constant(t, values) -> tuple[np.ndarray, np.ndarray]:
    """Return masks (n,) of the rows in long runs where all columns are straight lines, and where all are constant.

    Constant samples do not count as a part of a straight run: otherwise a resting channel, where constant values are
    allowed, would be rejected as straight.
    """
    n = len(t)
    if n < MIN_RUN_SAMPLES:
        return np.zeros(n, bool), np.zeros(n, bool)
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    off = np.abs(values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:])
    # times are rounded too: seconds since 1970 to 0.2 microseconds
    late = np.spacing(np.abs(t).max()) / (t[2:] - t[:-2])[:, None] * np.abs(values[2:] - values[:-2])
    with np.errstate(invalid="ignore"):
        on_line = (off <= _resolution(values) + late).all(axis=1)
        same = (values[1:] == values[:-1]).all(axis=1)
    least = max(MIN_RUN_SAMPLES, MIN_RUN_S / np.median(np.diff(t)), MIN_TYPICAL_RUNS * _typical_run(on_line))
    return _long_runs(on_line & ~(same[1:] & same[:-1]), 2, least), _long_runs(same, 1, least)


def _typical_run(on_line) -> float:
    """Return the median number of samples on one line, for a channel resampled from a slower one; 0 for others."""
    if np.mean(on_line) < MIN_RESAMPLED_SHARE:
        return 0.0
    return float(np.median([last - first + 3 for first, last in true_runs(on_line)]))


def _long_runs(mask, reach: int, min_samples: float) -> np.ndarray:
    """Return a mask (n,) of the rows in long runs of `mask`, whose entry i refers to the rows i to i + reach."""
    marked = np.zeros(len(mask) + reach, bool)
    for first, last in true_runs(mask):
        if last - first + reach + 1 >= min_samples:
            marked[first : last + reach + 1] = True
    return marked


def _resolution(values) -> np.ndarray:
    """Return the rounding errors (k,) of the columns: of single precision, or of a text file with nine decimals."""
    with np.errstate(invalid="ignore"):
        size = np.nanmax(np.where(np.isfinite(values), np.abs(values), np.nan), axis=0, initial=1.0)
        single = (values.astype(np.float32).astype(float) == values).all()
    return (4.0 * np.finfo(np.float32).eps if single else TEXT_RESOLUTION) * np.maximum(size, 1.0)
