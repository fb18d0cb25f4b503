"""Physical checks of a mapping: gravity, gyro against attitude, velocity against position, force against velocity.

Two channels of one motion are compared. Where they disagree, the usual mistakes are tried: another unit, frame or order
of columns. A mistake that explains the disagreement is an error with the line of the mapping that corrects it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import TABLE, Log
from swift_ros.recording.log_mapping import conversion, increments
from swift_ros.recording.log_mapping import mapping as log_mapping
from swift_ros.recording.log_mapping.conversion import Signal
from swift_ros.recording.log_mapping.quantities import BODIES, QUANTITIES, TIME, WORLDS, G
from swift_ros.text import excerpt

AGREED = 0.3  # misfit below which two signals agree; larger accepts more mistakes
MAX_MISFIT = 0.25  # misfit that may remain with a mistake corrected
MIN_IMPROVEMENT = 4.0  # factor by which a correction must reduce the misfit
ROTATION_S, MOTION_S = 0.1, 0.5  # s; windows of rotation, and of position and velocity
MIN_RATE, MIN_SPEED, MIN_CHANGE = 0.05, 0.5, 0.3  # rad/s, m/s, m/s: RMS below which there is no motion to compare
GRAVITY_RANGE = 0.6, 2.5  # of g: median specific force of a flight
UPRIGHT = 0.5  # of the specific force that must point up, on average
RATE_RANGE_HZ = 2.0, 20_000.0  # rates of the fastest channel of a table
MAX_SHARE_LONG = 0.02  # of quaternions whose length is not 1
LENGTH_TOLERANCE = 0.05
Signals = Mapping[str, Signal]


@dataclass(frozen=True)
class Check:
    """Result of a check: what was compared, the finding, and whether it holds; None where it was not possible."""

    name: str
    text: str
    holds: bool | None

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


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


def checks(log: Log, mapping: log_mapping.Mapping, signals: Signals) -> list[Check]:
    """Return the results of all checks. Raises UsageError for a contradiction that a mistake explains."""
    examined = Examined(log, mapping, signals)
    tests: tuple[Callable[[Examined], Check], ...] = _time, _gravity, _quaternion, _rotation, _up, _velocity, _force
    return [test(examined) for test in tests]


def sound(signal: Signal) -> Signal:
    """Return the rows with numbers, at increasing times; values (n, k)."""
    values = np.asarray(signal.values, dtype=float).reshape(len(signal.t), -1)
    good = np.isfinite(values).all(axis=1) & np.isfinite(signal.t)
    t, values = signal.t[good], values[good]
    newest = np.maximum.accumulate(t) if len(t) else t
    later = np.concatenate([[True], t[1:] > newest[:-1]]) if len(t) else np.zeros(0, bool)
    return Signal(t[later], values[later])


def _time(examined: Examined) -> Check:
    """Compare the rate of the fastest channel with rates that exist, for a table, whose times are a column."""
    source = examined.mapping.time
    if TABLE not in examined.log.topics or source is None or not examined.signals:
        return Check("time", "the log's own clock", None)
    step_s = min(float(np.median(np.diff(signal.t))) for signal in examined.signals.values())
    rate_hz = 1.0 / max(step_s, 1e-300)
    low, high = RATE_RANGE_HZ
    if low <= rate_hz <= high:
        return Check("time", f"{rate_hz:.4g} rows a second", True)
    factors = {unit: factor / TIME[source.unit] for unit, factor in TIME.items()}
    right = [unit for unit, factor in factors.items() if low <= rate_hz / factor <= high]
    if right:
        unit = min(right, key=lambda name: abs(np.log(rate_hz / factors[name] / 100.0)))
        raise UsageError(
            f"{examined.log.path}: in {source.unit} its rows would be {step_s:.4g} s apart; column "
            f"{excerpt(source.column)} is in {unit}: give `time: {{column: {excerpt(source.column)}, unit: {unit}}}`"
        )
    return Check("time", f"{rate_hz:.4g} rows a second, which no flight controller logs", False)


def _gravity(examined: Examined) -> Check:
    """Compare the size of the specific force with gravity, and its direction in the body with up."""
    if not examined.has("specific_force_body"):
        return Check("gravity", "no accelerometer", None)
    force = examined.signals["specific_force_body"].values
    size = float(np.median(np.linalg.norm(force, axis=1)))
    finding = f"the accelerometer measures {size:.3g} m/s^2, not about 9.8"
    low, high = (share * G for share in GRAVITY_RANGE)
    if not low < size < high:
        source, units = examined.mapping.channels["specific_force_body"], QUANTITIES["specific_force_body"].units
        per_unit = size / units[source.unit or "m/s^2"]
        for unit, factor in units.items():
            if low < per_unit * factor < high:
                examined.refuse(finding, "specific_force_body", f"are in {unit}", f"unit: {unit}")
        reason = "no unit fits" if size > high else "gravity may be taken out, which an accelerometer measures"
        return Check("gravity", f"{finding}; {reason}", False)
    up = force.mean(axis=0) / size
    text = f"{size:.3g} m/s^2, {100 * up[2]:.0f} % of it along the body's up"
    if up[2] > UPRIGHT:
        return Check("gravity", text, True)
    if max(abs(up)) < UPRIGHT:
        return Check("gravity", f"{text}: no axis of the accelerometer points up on average", False)
    finding = f"on average the accelerometer points to {', '.join(f'{value:.2g}' for value in up)} (forward, left, up)"
    if up[2] < -UPRIGHT:
        body = "FLU" if examined.mapping.channels["specific_force_body"].body == "FRD" else "FRD"
        examined.refuse(finding, "specific_force_body", "point down", f"body: {body}")
    axis = int(np.argmax(abs(up)))
    columns = _signed(examined, "specific_force_body")
    order = [(axis + 1) % 3, (axis + 2) % 3, axis]
    named = [columns[i] for i in order]
    named[2] = named[2] if up[axis] > 0 else _negative(named[2])
    cure = f"columns: [{', '.join(named)}]"
    examined.refuse(finding, "specific_force_body", "have another order of axes", f"{cure}, the last one up")
    raise AssertionError("unreachable")


def _quaternion(examined: Examined) -> Check:
    """Check the length of the quaternions."""
    if not examined.has("q_world_body") or len(examined.mapping.channels["q_world_body"].columns) == 3:
        return Check("quaternion", "no quaternion", None)
    length = np.linalg.norm(examined.signals["q_world_body"].values, axis=1)
    share = float(np.mean(abs(length - 1.0) > LENGTH_TOLERANCE))
    return Check("quaternion", f"{share:.1%} of the rows have another length than 1", share < MAX_SHARE_LONG)


def _rotation(examined: Examined) -> Check:
    """Compare the rotation of the attitude with the integral of the gyro."""
    if not examined.has("q_world_body", "gyro_body"):
        return Check("gyro against attitude", "not both recorded", None)
    attitude, gyro = _unit(examined.signals["q_world_body"]), examined.signals["gyro_body"]
    spans = increments.windows(attitude, gyro, ROTATION_S)
    if len(spans) < 10:
        return Check("gyro against attitude", "too few rows at the same time", None)
    turned, integrated = increments.of_rotation(attitude, spans), increments.of_integral(gyro, spans)
    width = float(np.mean(spans[:, 1] - spans[:, 0]))
    if min(_rms(turned), _rms(integrated)) < MIN_RATE * width:
        return Check("gyro against attitude", "the vehicle hardly rotates", None)
    as_is = increments.misfit(turned, integrated)
    if as_is < AGREED:
        return Check("gyro against attitude", f"misfit {as_is:.3f}", True)
    tried = [*_gyro_mistakes(examined, turned, integrated), *_attitude_mistakes(examined, spans, integrated)]
    finding = "the attitude's rotation and the gyro disagree"
    return _explained(examined, "gyro against attitude", finding, as_is, tried)


def _up(examined: Examined) -> Check:
    """Compare the direction of the specific force in the world with up."""
    if not examined.has("q_world_body", "specific_force_body"):
        return Check("accelerometer against attitude", "not both recorded", None)
    force = examined.signals["specific_force_body"]

    def share_up(attitude: Signal) -> float:
        """Return the part (-1..1) of the specific force that points up in the world on average."""
        in_world = geometry.rotate(conversion.quaternions_at(_unit(attitude), force.t), force.values)
        return float(np.mean(in_world[:, 2]) / np.mean(np.linalg.norm(force.values, axis=1)))

    as_is = share_up(examined.signals["q_world_body"])
    text = f"{as_is:.0%} of the specific force points up in the world"
    if as_is > UPRIGHT:
        return Check("accelerometer against attitude", text, True)
    tried = [(1.0 - share_up(one), *words) for one, *words in _attitudes(examined)]
    finding = f"by the attitude only {text}"
    return _explained(examined, "accelerometer against attitude", finding, 1.0 - as_is, tried)


def _velocity(examined: Examined) -> Check:
    """Compare the change of the position with the integral of the velocity."""
    if not examined.has("p_world", "v_world"):
        return Check("velocity against position", "not both recorded", None)
    position, velocity = examined.signals["p_world"], examined.signals["v_world"]
    spans = increments.windows(position, velocity, MOTION_S)
    if len(spans) < 10:
        return Check("velocity against position", "too few rows at the same time", None)
    moved, integrated = increments.of_value(position, spans), increments.of_integral(velocity, spans)
    width = float(np.mean(spans[:, 1] - spans[:, 0]))
    if max(_rms(moved), _rms(integrated)) < MIN_SPEED * width:
        return Check("velocity against position", "the vehicle hardly moves", None)
    as_is = increments.misfit(moved, integrated)
    if as_is < AGREED:
        return Check("velocity against position", f"misfit {as_is:.3f}", True)
    tried = []
    for keys, mistake, cure in _velocity_sources(examined):
        other = increments.of_integral(examined.changed("v_world", **keys), spans)
        tried.append((increments.misfit(moved, other), "v_world", mistake, cure))
    for unit, ratio in _ratios(examined, "p_world"):
        tried.append((increments.misfit(moved * ratio, integrated), "p_world", f"are in {unit}", f"unit: {unit}"))
    finding = "the position's change and the velocity disagree"
    return _explained(examined, "velocity against position", finding, as_is, tried)


def _force(examined: Examined) -> Check:
    """Compare the change of the velocity with the integral of specific force and gravity."""
    if not examined.has("v_world", "q_world_body", "specific_force_body"):
        return Check("accelerometer against velocity", "not both recorded", None)
    velocity, force = examined.signals["v_world"], examined.signals["specific_force_body"]

    def acceleration(attitude: Signal) -> Signal:
        in_world = geometry.rotate(conversion.quaternions_at(_unit(attitude), force.t), force.values)
        return Signal(force.t, in_world - [0.0, 0.0, G])

    spans = increments.windows(velocity, force, MOTION_S)
    if len(spans) < 10:
        return Check("accelerometer against velocity", "too few rows at the same time", None)
    changed = _centred(increments.of_value(velocity, spans))
    integrated = _centred(increments.of_integral(acceleration(examined.signals["q_world_body"]), spans))
    if min(_rms(changed), _rms(integrated)) < MIN_CHANGE * MOTION_S:
        return Check("accelerometer against velocity", "the vehicle hardly accelerates", None)
    as_is = increments.misfit(changed, integrated)
    if as_is < AGREED:
        return Check("accelerometer against velocity", f"misfit {as_is:.3f}", True)
    tried = []
    for one, *words in _attitudes(examined):
        other = _centred(increments.of_integral(acceleration(one), spans))
        tried.append((increments.misfit(changed, other), *words))
    if not examined.mapping.channels["v_world"].body:
        for world in WORLDS:
            other = _centred(increments.of_value(examined.changed("v_world", world=world), spans))
            words = "v_world", f"have axes of the world {world}, and so has the position", f"world: {world}"
            tried.append((increments.misfit(other, integrated), *words))
    finding = "the velocity's change and the accelerometer disagree"
    return _explained(examined, "accelerometer against velocity", finding, as_is, tried)


def _explained(examined: Examined, name: str, finding: str, as_is: float, tried: list[tuple]) -> Check:
    """Raise UsageError for the mistake (misfit, channel, mistake, cure) that explains a disagreement, if one does."""
    best = min(tried, key=lambda row: row[0], default=None)
    if best and best[0] < MAX_MISFIT and MIN_IMPROVEMENT * best[0] < as_is:
        examined.refuse(finding, *best[1:])
    return Check(
        name, f"misfit {as_is:.2f}: {finding}, and no other unit, frame or order of columns explains it", False
    )


def _ratios(examined: Examined, channel: str) -> Iterator[tuple[str, float]]:
    """Yield the other units of a channel, and the factors by which its values would change."""
    units = QUANTITIES[channel].units
    now = units[examined.mapping.channels[channel].unit or next(iter(units))]
    yield from ((unit, factor / now) for unit, factor in units.items() if factor != now)


def _gyro_mistakes(examined: Examined, turned, integrated) -> Iterator[tuple]:
    for unit, ratio in _ratios(examined, "gyro_body"):
        yield increments.misfit(turned, integrated * ratio), "gyro_body", f"are in {unit}", f"unit: {unit}"
    now = BODIES[examined.mapping.channels["gyro_body"].body or "FLU"]
    for body, rotation in BODIES.items():
        other = integrated @ now @ rotation.T
        yield increments.misfit(turned, other), "gyro_body", f"have the axes {body}", f"body: {body}"
    columns, raw = _signed(examined, "gyro_body"), integrated @ now
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        named = [columns[i] if sign > 0 else _negative(columns[i]) for i, sign in zip(order, signs, strict=True)]
        cure = f"columns: [{', '.join(named)}]"
        # a little worse than a frame with a name, which explains the same
        value = 1.01 * increments.misfit(turned, raw[:, list(order)] * signs @ now.T) + 1e-4
        yield value, "gyro_body", "have another order or other signs", cure


def _attitude_mistakes(examined: Examined, spans, integrated) -> Iterator[tuple]:
    for attitude, *words in _attitudes(examined):
        yield (increments.misfit(increments.of_rotation(_unit(attitude), spans), integrated), *words)


def _attitudes(examined: Examined) -> Iterator[tuple[Signal, str, str, str]]:
    """Yield the attitude with each usual mistake corrected: signal, channel, mistake, cure."""
    source, channel = examined.mapping.channels["q_world_body"], "q_world_body"
    columns = _signed(examined, channel)
    if len(columns) == 4:
        rolled = (*columns[1:], columns[0])
        yield _with_columns(examined, rolled, "have the quaternion's w first")
        yield _with_columns(examined, (columns[3], *columns[:3]), "have the quaternion's w last")
        turned = (*(_negative(name) for name in columns[:3]), columns[3])
        yield _with_columns(examined, turned, "rotate world into body vectors")
        rolled = (*(_negative(name) for name in rolled[:3]), rolled[3])
        yield _with_columns(examined, rolled, "have w first and rotate world into body vectors")
    else:
        for unit, _ in _ratios(examined, channel):
            yield examined.changed(channel, unit=unit), channel, f"are in {unit}", f"unit: {unit}"
    for world, body in product(WORLDS, BODIES):
        if (world, body) != (source.world or "ENU", source.body or "FLU"):
            mistake = f"have the frames {world} and {body}"
            yield examined.changed(channel, world=world, body=body), channel, mistake, f"world: {world}, body: {body}"


def _with_columns(examined: Examined, columns: tuple[str, ...], mistake: str) -> tuple[Signal, str, str, str]:
    cure = f"columns: [{', '.join(columns)}]"
    return examined.changed("q_world_body", columns=columns), "q_world_body", mistake, cure


def _velocity_sources(examined: Examined) -> Iterator[tuple[dict, str, str]]:
    """Yield other keys of the velocity, the mistake and its cure."""
    for unit, _ in _ratios(examined, "v_world"):
        yield {"unit": unit}, f"are in {unit}", f"unit: {unit}"
    for world in WORLDS:
        yield {"world": world, "body": ""}, f"have axes of the world {world}", f"world: {world}"
    if examined.has("q_world_body"):
        for body in BODIES:
            yield {"world": "", "body": body}, f"are in the body frame {body}", f"body: {body}"


def _signed(examined: Examined, channel: str) -> tuple[str, ...]:
    return examined.mapping.channels[channel].columns


def _negative(column: str) -> str:
    return column[1:] if column.startswith("-") else f"-{column}"


def _unit(attitude: Signal) -> Signal:
    """Return the attitudes whose length is 1."""
    good = abs(np.linalg.norm(attitude.values, axis=1) - 1.0) < LENGTH_TOLERANCE
    return Signal(attitude.t[good], attitude.values[good]) if np.count_nonzero(good) > 10 else attitude


def _centred(values) -> np.ndarray:
    """Return values (k, 3) less their median: an accelerometer's bias is no contradiction."""
    return values - np.median(values, axis=0)


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))
