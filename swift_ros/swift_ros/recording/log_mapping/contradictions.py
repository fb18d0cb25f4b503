"""Physical checks of a mapping: gravity, gyro against attitude, velocity against position, force against velocity.

Two channels of one motion are compared. Where they disagree, the usual mistakes are tried: another unit, frame or order
of columns. A mistake that explains the disagreement is an error with the line of the mapping that corrects it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import TABLE, Log
from swift_ros.recording.log_mapping import conversion, increments, mistakes
from swift_ros.recording.log_mapping import mapping as log_mapping
from swift_ros.recording.log_mapping.conversion import Signal
from swift_ros.recording.log_mapping.mistakes import Examined, Signals
from swift_ros.recording.log_mapping.quantities import QUANTITIES, TIME, WORLDS, G
from swift_ros.text import excerpt

AGREED = 0.3  # misfit below which two signals agree; larger accepts more mistakes
MAX_MISFIT = 0.25  # misfit that may remain with a mistake corrected
MIN_IMPROVEMENT = 4.0  # factor by which a correction must reduce the misfit
EQUAL = 1.1, 0.005  # factor and difference of misfits between which two corrections are equally good
ROTATION_S, MOTION_S = 0.1, 0.5  # s; windows of rotation, and of position and velocity
MIN_RATE, MIN_SPEED, MIN_CHANGE = 0.05, 0.5, 0.3  # rad/s, m/s, m/s: RMS below which there is no motion to compare
GRAVITY_RANGE = 0.6, 2.5  # of g: median specific force of a flight
UPRIGHT = 0.5  # of the specific force that must point up, on average
RATE_RANGE_HZ = 2.0, 20_000.0  # rates of the fastest channel of a table
MAX_SHARE_LONG = 0.02  # of quaternions whose length is not 1
LENGTH_TOLERANCE = 0.05


@dataclass(frozen=True)
class Check:
    """Result of a check: what was compared, the finding, and whether it holds; None where it was not possible."""

    name: str
    text: str
    holds: bool | None

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


def checks(log: Log, mapping: log_mapping.Mapping, signals: Signals) -> list[Check]:
    """Return the results of all checks. Raises UsageError for a contradiction that a mistake explains."""
    examined = Examined(log, mapping, signals)
    tests: tuple[Callable[[Examined], Check], ...] = _time, _gravity, _quaternion, _rotation, _up, _velocity, _force
    return [test(examined) for test in tests]


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
    columns = mistakes.columns_of(examined, "specific_force_body")
    order = [(axis + 1) % 3, (axis + 2) % 3, axis]
    named = [columns[i] for i in order]
    named[2] = named[2] if up[axis] > 0 else mistakes.negative(named[2])
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
    tried = [*mistakes.of_gyro(examined, turned, integrated), *_attitude_mistakes(examined, spans, integrated)]
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
    tried = [(1.0 - share_up(one), *words) for one, *words in mistakes.of_attitude(examined)]
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
    for keys, mistake, cure in mistakes.of_velocity(examined):
        other = increments.of_integral(examined.changed("v_world", **keys), spans)
        tried.append((increments.misfit(moved, other), "v_world", mistake, cure))
    for unit, ratio in mistakes.ratios(examined, "p_world"):
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
    if not examined.mapping.channels["v_world"].body:
        attitude = examined.changed("q_world_body", world="NED", body="FRD")
        other = _centred(increments.of_value(examined.changed("v_world", world="NED"), spans))
        value = increments.misfit(other, _centred(increments.of_integral(acceleration(attitude), spans)))
        words = "have the frames NED and FRD, and the velocity NED", "world: NED, body: FRD`, and v_world `world: NED"
        tried.append((value, "q_world_body", *words))
    for one, *words in mistakes.of_attitude(examined):
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
    """Raise UsageError for the mistake (misfit, channel, mistake, cure) that explains a disagreement, if one does.

    Of mistakes that explain it equally well, the first one is named.
    """
    least = min((row[0] for row in tried), default=0.0)
    best = next((row for row in tried if row[0] <= EQUAL[0] * least + EQUAL[1]), None)
    if best and best[0] < MAX_MISFIT and MIN_IMPROVEMENT * best[0] < as_is:
        examined.refuse(finding, *best[1:])
    return Check(
        name, f"misfit {as_is:.2f}: {finding}, and no other unit, frame or order of columns explains it", False
    )


def _attitude_mistakes(examined: Examined, spans, integrated) -> Iterator[tuple]:
    for attitude, *words in mistakes.of_attitude(examined):
        yield (increments.misfit(increments.of_rotation(_unit(attitude), spans), integrated), *words)


def _unit(attitude: Signal) -> Signal:
    """Return the attitudes whose length is 1."""
    good = abs(np.linalg.norm(attitude.values, axis=1) - 1.0) < LENGTH_TOLERANCE
    return Signal(attitude.t[good], attitude.values[good]) if np.count_nonzero(good) > 10 else attitude


def _centred(values) -> np.ndarray:
    """Return values (k, 3) less their median: an accelerometer's bias is no contradiction."""
    return values - np.median(values, axis=0)


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))
