"""A log with its mapping, and the usual mistakes in a mapping: other units, frames and orders of columns."""

from collections.abc import Iterator, Mapping
from itertools import permutations, product

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import Log
from swift_ros.recording.log_mapping import conversion, increments
from swift_ros.recording.log_mapping import mapping as log_mapping
from swift_ros.recording.log_mapping.conversion import Signal
from swift_ros.recording.log_mapping.quantities import BODIES, QUANTITIES, WORLDS
from swift_ros.text import excerpt

# A step between times above both bounds separates two clocks: pauses in a log are shorter, as in `recording.checks`.
OTHER_CLOCK_S, OTHER_CLOCK_STEPS = 600.0, 10_000  # s, median steps
Signals = Mapping[str, Signal]


class Examined:
    """A log with its mapping and the channels that result.

    Attributes:
        log: the log.
        mapping: its mapping.
        signals: channels by name, without rows that hold no number, with increasing times.
    """

    def __init__(self, log: Log, mapping: log_mapping.Mapping, signals: Signals):
        self.log, self.mapping = log, mapping
        self.signals = {name: good for name, one in signals.items() if len((good := sound(one)).t) > 10}

    def has(self, *names: str) -> bool:
        return all(name in self.signals for name in names)

    def changed(self, channel: str, **keys) -> Signal:
        """Return a channel with other keys of its source."""
        mapping = self.mapping.with_channel(channel, **keys)
        begin_s = conversion.first_time(self.log, self.mapping)
        return sound(conversion.signal(self.log, mapping, channel, begin_s, self.signals.get("q_world_body")))

    def named(self, channel: str) -> str:
        """Return the columns of a channel for the sentence of an error."""
        source = self.mapping.channels[channel]
        columns = [excerpt(name.removeprefix("-")) for name in source.columns]
        names = columns[0] if len(columns) == 1 else f"{', '.join(columns[:-1])} and {columns[-1]}"
        return f"{'column' if len(columns) == 1 else 'columns'} {names}" + (
            f" of {source.topic}" if source.topic else ""
        )

    def refuse(self, finding: str, channel: str, mistake: str, cure: str) -> None:
        """Raise UsageError for a mistake in the source of a channel."""
        raise UsageError(f"{self.log.path}: {finding}; {self.named(channel)} {mistake}: give {channel} `{cure}`")


def sound(signal: Signal) -> Signal:
    """Return the rows with numbers, at increasing times of one clock; values (n, k)."""
    values = np.asarray(signal.values, dtype=float).reshape(len(signal.t), -1)
    good = np.isfinite(values).all(axis=1) & np.isfinite(signal.t)
    t, values = signal.t[good], values[good]
    if not len(t):
        return Signal(t, values)
    ordered = np.sort(t)
    steps = np.diff(ordered)
    pause_s = max(OTHER_CLOCK_S, OTHER_CLOCK_STEPS * float(np.median(steps))) if len(steps) else 0.0
    clocks = np.split(ordered, np.flatnonzero(steps > pause_s) + 1)
    main = max(clocks, key=len)
    same = (t >= main[0]) & (t <= main[-1])
    t, values = t[same], values[same]
    later = np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])
    return Signal(t[later], values[later])


def ratios(examined: Examined, channel: str) -> Iterator[tuple[str, float]]:
    """Yield the other units of a channel, and the factors by which its values would change."""
    units = QUANTITIES[channel].units
    now = units[examined.mapping.channels[channel].unit or next(iter(units))]
    yield from ((unit, factor / now) for unit, factor in units.items() if factor != now)


def of_gyro(examined: Examined, turned, integrated) -> Iterator[tuple]:
    for unit, ratio in ratios(examined, "gyro_body"):
        yield increments.misfit(turned, integrated * ratio), "gyro_body", f"are in {unit}", f"unit: {unit}"
    now = BODIES[examined.mapping.channels["gyro_body"].body or "FLU"]
    for body, rotation in BODIES.items():
        other = integrated @ now @ rotation.T
        yield increments.misfit(turned, other), "gyro_body", f"have the axes {body}", f"body: {body}"
    columns, raw = columns_of(examined, "gyro_body"), integrated @ now
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        named = [columns[i] if sign > 0 else negative(columns[i]) for i, sign in zip(order, signs, strict=True)]
        cure = f"columns: [{', '.join(named)}]"
        other = raw[:, list(order)] * signs @ now.T
        yield increments.misfit(turned, other), "gyro_body", "have another order or other signs", cure


def of_attitude(examined: Examined) -> Iterator[tuple[Signal, str, str, str]]:
    """Yield the attitude with each usual mistake corrected: signal, channel, mistake, cure."""
    source, channel = examined.mapping.channels["q_world_body"], "q_world_body"
    columns = columns_of(examined, channel)
    if len(columns) == 4:
        rolled = (*columns[1:], columns[0])
        yield _with_columns(examined, rolled, "have the quaternion's w first")
        yield _with_columns(examined, (columns[3], *columns[:3]), "have the quaternion's w last")
        turned = (*(negative(name) for name in columns[:3]), columns[3])
        yield _with_columns(examined, turned, "rotate world into body vectors")
        rolled = (*(negative(name) for name in rolled[:3]), rolled[3])
        yield _with_columns(examined, rolled, "have w first and rotate world into body vectors")
    else:
        for unit, _ in ratios(examined, channel):
            yield examined.changed(channel, unit=unit), channel, f"are in {unit}", f"unit: {unit}"
    usual = [("NED", "FRD"), ("ENU", "FLU")]
    for world, body in [*usual, *(pair for pair in product(WORLDS, BODIES) if pair not in usual)]:
        if (world, body) != (source.world or "ENU", source.body or "FLU"):
            mistake = f"have the frames {world} and {body}"
            yield examined.changed(channel, world=world, body=body), channel, mistake, f"world: {world}, body: {body}"


def _with_columns(examined: Examined, columns: tuple[str, ...], mistake: str) -> tuple[Signal, str, str, str]:
    cure = f"columns: [{', '.join(columns)}]"
    return examined.changed("q_world_body", columns=columns), "q_world_body", mistake, cure


def of_velocity(examined: Examined) -> Iterator[tuple[dict, str, str]]:
    """Yield other keys of the velocity, the mistake and its cure."""
    for unit, _ in ratios(examined, "v_world"):
        yield {"unit": unit}, f"are in {unit}", f"unit: {unit}"
    for world in WORLDS:
        yield {"world": world, "body": ""}, f"have axes of the world {world}", f"world: {world}"
    if examined.has("q_world_body"):
        for body in BODIES:
            yield {"world": "", "body": body}, f"are in the body frame {body}", f"body: {body}"


def columns_of(examined: Examined, channel: str) -> tuple[str, ...]:
    return examined.mapping.channels[channel].columns


def negative(column: str) -> str:
    return column[1:] if column.startswith("-") else f"-{column}"
