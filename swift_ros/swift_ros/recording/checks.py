"""Finds the stretches of a recording that cannot be measurements, whatever the sensor. Pure.

A recording is a table: one row a time step. What is found is named with its time, channel and reason, and left out; the
rest is kept. Five things give bad data away: times that do not grow, values that are no numbers or that no such sensor
can give, a sensor that says exactly the same again and again, a stretch on exactly one straight line, which is what
resampling makes of a gap, and of the time after a log's end, and one that stands at the end of the sensor's range.
"""

from dataclasses import dataclass, replace

import numpy as np

LEAST_SAMPLES = 15  # a shorter run is a lost packet or two, if anything
LEAST_S = 0.03  # nor is one so short of a fast sensor, whose steps are coarse
TYPICAL_RUNS = 5  # in a channel that was resampled from a slower one, so many times its usual run
LONG_GAP = 5  # a gap is longer than so many time steps
CLIPPED, LEAPS = 5, 5.0  # a peak that stands for so many usual runs, between leaps over so many values, is cut
LEAST_CLIPPED = 10  # samples in all: where fewer stand at the extreme it may be chance
OTHER_CLOCK_S, OTHER_CLOCK = 600.0, 10_000  # and beyond one so long, and of so many time steps, another clock begins


@dataclass(frozen=True)
class Channel:
    """What one sensor measures together.

    values: (n,) or (n, k), one row a time step; low, high: what such a sensor can give; unit: of the values, for a
    reader; noisy: it never says exactly the same in all columns at rest (a gyro does not, an unarmed motor does);
    least_range: no such sensor ends earlier, infinite where nothing is known of its end.
    """

    name: str
    values: np.ndarray
    low: float
    high: float
    unit: str
    noisy: bool = True
    least_range: float = np.inf


@dataclass(frozen=True)
class Rejection:
    """A stretch that is no measurement: first and last time (s), channel, and why."""

    begin_s: float
    end_s: float
    channel: str
    reason: str

    def since(self, begin_s: float) -> "Rejection":
        """Return the same with its times counted from `begin_s`."""
        return replace(self, begin_s=self.begin_s - begin_s, end_s=self.end_s - begin_s)

    def as_json(self) -> dict:
        """Return the entry of `rejected_data` in a result file."""
        return {"time": [self.begin_s, self.end_s], "channel": self.channel, "reason": self.reason}

    def __str__(self) -> str:
        return f"{self.begin_s:.2f} s to {self.end_s:.2f} s, {self.channel}: {self.reason}"


def check_time(t) -> tuple[np.ndarray, list[Rejection]]:
    """Return which rows (n,) of times (n,) s can stay, and what is wrong with the others; gaps are named as well."""
    t = np.asarray(t, dtype=float)
    good = _on_one_clock(t)
    far = np.isfinite(t) & ~good
    newest = np.maximum.accumulate(np.where(good, t, -np.inf))
    good[1:] &= t[1:] > newest[:-1]
    found = [(far, "lie far from all others: another clock's"), (~good & ~far, "do not follow those before them")]
    rejections = [
        Rejection(*_span(t, first, last), "t", f"{last - first + 1} times {reason}")
        for mask, reason in found
        for first, last in stretches(mask)
    ]
    kept = t[good]
    steps = np.diff(kept)
    if steps.size:
        for i in np.flatnonzero(steps > LONG_GAP * np.median(steps)):
            rejections.append(Rejection(kept[i], kept[i + 1], "t", f"nothing was recorded for {steps[i]:.3g} s"))
    return good, rejections


def _on_one_clock(t) -> np.ndarray:
    """Return which times (n,) are numbers and go by the clock of most of them: between two clocks lies what no
    recording pauses."""
    times = np.sort(t[np.isfinite(t)])
    steps = np.diff(times)
    if not steps.size:
        return np.isfinite(t)
    first = np.flatnonzero(steps > max(OTHER_CLOCK_S, OTHER_CLOCK * np.median(steps))) + 1
    begin, end = np.concatenate([[0], first]), np.concatenate([first, [len(times)]])
    most = np.argmax(end - begin)
    return (t >= times[begin[most]]) & (t <= times[end[most] - 1])


def _span(t, first: int, last: int) -> tuple[float, float]:
    """Return the least and the greatest of the times `first` to `last`; of their neighbours where they are no
    numbers."""
    for rows in (t[first : last + 1], t[max(first - 1, 0) : last + 2]):
        if np.isfinite(rows).any():
            return float(np.min(rows[np.isfinite(rows)])), float(np.max(rows[np.isfinite(rows)]))
    return 0.0, 0.0


def check_channel(t, channel: Channel) -> tuple[np.ndarray, list[Rejection]]:
    """Return which rows (n,) of a channel can stay, at growing times t (n,) s, and what is wrong with the others."""
    t = np.asarray(t, dtype=float)
    values = np.asarray(channel.values, dtype=float).reshape(len(t), -1)
    finite = np.isfinite(values).all(axis=1)
    inside = ((values >= channel.low) & (values <= channel.high)).all(axis=1) | ~finite
    straight, still = _straight_and_still(t, values)
    found = [(~finite, "not a number"), (~inside, _impossible(channel, values[~inside]))]
    found.append((straight & ~still, "on exactly one straight line: filled in, not measured"))
    if channel.noisy:
        found.append((still, "exactly the same value again and again: the sensor stood still"))
    clipped = _clipped(np.where((finite & inside)[:, None], values, np.nan), channel.least_range)
    found.append((clipped, "stands at the greatest or least of its values: clipped"))
    bad = np.any([mask for mask, _ in found], axis=0)
    rejections = []
    for first, last in stretches(bad):
        reasons = [reason for mask, reason in found if mask[first : last + 1].any()]
        rejections.append(Rejection(t[first], t[last], channel.name, "; ".join(reasons)))
    return ~bad, rejections


def stretches(mask) -> list[tuple[int, int]]:
    """Return first and last index of each run of true in a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(first), int(after) - 1) for first, after in edges.reshape(-1, 2)]


def unchanged(t, values, least_s: float) -> list[tuple[int, int]]:
    """Return first and last index of each run of rows (n, ...) at times t (n,) s that say exactly the same for
    `least_s` s, and for many times as long as usual."""
    values = np.asarray(values).reshape(len(t), -1)
    same = (values[1:] == values[:-1]).all(axis=1)
    changed = t[1:][~same]
    usual = np.median(np.diff(changed)) if len(changed) > 1 else 0.0
    runs = [(first, last + 1) for first, last in stretches(same)]
    return [(first, last) for first, last in runs if t[last] - t[first] >= max(least_s, TYPICAL_RUNS * usual)]


def _clipped(values, least_range: float) -> np.ndarray:
    """Return the rows (n,) in which a column of values (n, k) stands at its own greatest or least value, as no peak
    does: longer than it stands anywhere else, with a leap before and after."""
    marked = np.zeros(len(values), bool)
    for column in values.T:
        for side in (column, -column):
            top = np.max(side, initial=-np.inf, where=np.isfinite(side))
            if np.isfinite(top) and top >= least_range:
                marked |= _cut(side, top)
    return marked


def _cut(column, top: float) -> np.ndarray:
    """Return where (n,) a column stands at its greatest value `top` because it was cut there."""
    steps, nothing = np.abs(np.diff(column)), np.zeros(len(column), bool)
    if np.count_nonzero(steps > 0) < LEAST_CLIPPED:
        return nothing
    least = CLIPPED * np.median(np.diff(np.flatnonzero(steps != 0)))
    leap = LEAPS * np.median(np.diff(np.unique(column[np.isfinite(column)])))
    far = np.concatenate([[np.inf] * 2, top - column, [np.inf] * 2])  # the last step towards a cut may be a short one
    cut = sum(
        last - first + 1
        for first, last in stretches(column == top)
        if last - first + 1 >= least and min(far[first], far[last + 4]) >= leap
    )
    return column == top if cut >= LEAST_CLIPPED else nothing


def _impossible(channel: Channel, values) -> str:
    if not values.size:
        return ""
    worst = values.flat[np.argmax(np.abs(values))]
    reached = f"{worst:.6g} {channel.unit}".rstrip()
    return f"reaches {reached}, possible are {channel.low:g} to {channel.high:g}"


def _straight_and_still(t, values) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows (n,) that lie in long runs in which all columns follow straight lines, and in which they do not
    change at all. A run of one kind is straight: where still ones are allowed, they are no part of the other."""
    n = len(t)
    if n < LEAST_SAMPLES:
        return np.zeros(n, bool), np.zeros(n, bool)
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    off = np.abs(values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:])
    # times may be rounded as well: seconds since 1970 to 0.2 microseconds
    late = np.spacing(np.abs(t).max()) / (t[2:] - t[:-2])[:, None] * np.abs(values[2:] - values[:-2])
    with np.errstate(invalid="ignore"):
        on_line = (off <= _resolution(values) + late).all(axis=1)
        same = (values[1:] == values[:-1]).all(axis=1)
    least = max(LEAST_SAMPLES, LEAST_S / np.median(np.diff(t)), TYPICAL_RUNS * _usual_run(on_line))
    return _long_runs(on_line & ~(same[1:] & same[:-1]), 2, least), _long_runs(same, 1, least)


def _usual_run(on_line) -> float:
    """Return the usual number of samples on a line in a channel that was made from a slower one; 0 in any other."""
    if np.mean(on_line) < 0.5:
        return 0.0
    return float(np.median([last - first + 3 for first, last in stretches(on_line)]))


def _long_runs(mask, reach: int, least: float) -> np.ndarray:
    """Return the rows (n,) under runs of a mask whose entry i speaks of rows i to i + reach, if long enough."""
    marked = np.zeros(len(mask) + reach, bool)
    for first, last in stretches(mask):
        if last - first + reach + 1 >= least:
            marked[first : last + reach + 1] = True
    return marked


def _resolution(values) -> np.ndarray:
    """Return how far (k,) rounding takes a value from its line: single precision, or nine decimals of a text file."""
    with np.errstate(invalid="ignore"):
        size = np.nanmax(np.where(np.isfinite(values), np.abs(values), np.nan), axis=0, initial=1.0)
        single = (values.astype(np.float32).astype(float) == values).all()
    return (4.0 * np.finfo(np.float32).eps if single else 2e-9) * np.maximum(size, 1.0)
