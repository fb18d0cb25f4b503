"""Channels in SI units and this project's frames, from the columns of a log by a mapping."""

import difflib
from typing import NamedTuple

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import TABLE, Log
from swift_ros.recording.log_mapping.mapping import ChannelSource, Mapping
from swift_ros.recording.log_mapping.quantities import ANGLE, BODIES, QUANTITIES, RANGES, SHARE, TIME, WORLDS
from swift_ros.text import excerpt

MAX_HELD_STEPS = 5.0  # typical steps for which the value of another topic's column is held
MAX_NAMED = 12  # topics in the sentence of an error
COMMAND_MARGIN = 0.02  # motor commands this far outside of 0 to 1 are at the limit: idle pulses, rounding


class Signal(NamedTuple):
    """A channel: times (n,) s and values (n, k), or (n,) for a channel with one column."""

    t: np.ndarray
    values: np.ndarray


def signals(log: Log, mapping: Mapping) -> dict[str, Signal]:
    """Return the channels of a mapping, with times from the first of any channel on.

    Raises:
        UsageError: the log lacks a topic or column of the mapping.
    """
    begin_s = first_time(log, mapping)
    found = {}
    for name in sorted(mapping.channels, key=lambda name: name == "v_world"):  # last: it may need the attitude
        found[name] = signal(log, mapping, name, begin_s, found.get("q_world_body"))
    return {name: found[name] for name in mapping.channels}


def signal(log: Log, mapping: Mapping, name: str, begin_s: float, attitude: Signal | None = None) -> Signal:
    """Return one channel.

    Args:
        log: the log.
        mapping: of the log.
        name: of the channel.
        begin_s: time of the log that becomes 0 s.
        attitude: `q_world_body`, for a velocity in the body frame.

    Raises:
        UsageError: the log lacks a topic or column of the channel.
    """
    source = mapping.channels[name]
    t, raw = _raw(log, mapping, name, source)
    t = t - begin_s
    if name == "v_world" and source.body:
        if attitude is None:
            raise UsageError(f"{log.path}: v_world is in the body frame and needs q_world_body, which is not mapped")
        speed = raw * _factor(name, source) @ BODIES[source.body].T
        return Signal(t, geometry.rotate(quaternions_at(attitude, t), speed))
    values = _values(name, source, raw)
    return Signal(t, values[:, 0] if QUANTITIES[name].sizes == (1,) else values)


def first_time(log: Log, mapping: Mapping) -> float:
    """Return the first time of any channel, s. Raises UsageError when the mapping has no channel."""
    if not mapping.channels:
        names = [f"{excerpt(name)} ({excerpt(topic.type)})" for name, topic in log.topics.items()]
        held = ", ".join(names[:MAX_NAMED]) + (f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else "")
        raise UsageError(
            f"{log.path}: none of its topics is a channel; write a mapping (--mapping FILE); it has {held}"
        )
    topics = {source.places[0][0] for source in mapping.channels.values()}
    firsts = [np.nanmin(t) for name in topics if len(t := _times(log, mapping, name)) and not np.isnan(t).all()]
    if not firsts:
        raise UsageError(f"{log.path}: no time of the mapped topics is a number")
    return float(min(firsts))


def quaternions_at(attitude: Signal, t) -> np.ndarray:
    """Return attitudes (m, 4) at times t (m,) s: linear between neighbours of the same sign."""
    good = np.isfinite(attitude.values).all(axis=1) & np.isfinite(attitude.t)
    q, known = attitude.values[good], attitude.t[good]
    if not len(q):
        return np.full((len(t), 4), np.nan)
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0))
    q = q * np.concatenate([[1.0], flips])[:, None]
    return geometry.normalize(np.stack([np.interp(t, known, column) for column in q.T], axis=-1))


def _times(log: Log, mapping: Mapping, topic: str) -> np.ndarray:
    """Return the times (n,) s of a topic."""
    if topic not in log.topics:
        raise UsageError(f"{log.path} has no topic '{excerpt(topic)}'{_nearest(topic, log.topics)}")
    if topic != TABLE:
        return log.topics[topic].t
    columns = log.topics[TABLE].columns
    if mapping.time is None:
        raise UsageError(f"{log.path} is a table; the mapping lacks the key 'time' with its column of times")
    raw = _column(log, TABLE, mapping.time.column)
    # the first one is subtracted before: nanoseconds since 1970 exceed the precision of a float in seconds
    with np.errstate(invalid="ignore"):
        return (raw - columns[mapping.time.column][0]) * TIME[mapping.time.unit]


def _raw(log: Log, mapping: Mapping, name: str, source: ChannelSource) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) and signed columns (n, k) of a channel, at the times of the first column's topic."""
    places = source.places
    t = _times(log, mapping, places[0][0])
    found = []
    for topic, column, sign in places:
        values = sign * _column(log, topic, column).astype(float)
        found.append(values if topic == places[0][0] else _held(t, _times(log, mapping, topic), values))
    return t, np.stack(found, axis=-1)


def _column(log: Log, topic: str, column: str) -> np.ndarray:
    if topic not in log.topics:
        raise UsageError(f"{log.path} has no topic '{excerpt(topic)}'{_nearest(topic, log.topics)}")
    columns = log.topics[topic].columns
    if column not in columns:
        where = f"topic {excerpt(topic)} of {log.path}" if topic else str(log.path)
        raise UsageError(f"{where} has no column '{excerpt(column)}'{_nearest(column, columns)}")
    return np.asarray(columns[column])


def _nearest(name: str, names) -> str:
    near = difflib.get_close_matches(name, list(names), n=1, cutoff=0.0)
    return f"; the nearest name is '{excerpt(near[0])}'" if near else ""


def _held(t, other, values) -> np.ndarray:
    """Return values at times `other` at times t: the last one before, NaN where that is too old."""
    if len(other) < 2:
        return np.full(len(t), np.nan)
    last = np.searchsorted(other, t, "right") - 1
    step = np.median(np.diff(other))
    good = (last >= 0) & (t - other[np.clip(last, 0, None)] <= MAX_HELD_STEPS * step)
    return np.where(good, values[np.clip(last, 0, None)], np.nan)


def _factor(name: str, source: ChannelSource) -> float:
    units = QUANTITIES[name].units
    return source.scale * units.get(source.unit or next(iter(units)), 1.0)


def _values(name: str, source: ChannelSource, raw) -> np.ndarray:
    """Return the values (n, k) of a channel in SI units and this project's frames."""
    quantity = QUANTITIES[name]
    if name == "motor_command":
        return _commands(source, raw)
    if name == "rotor_speed":
        return np.abs(raw) * abs(_factor(name, source))  # the sign is the direction of rotation
    if 4 in quantity.sizes:
        return _attitudes(source, raw)
    values = raw * _factor(name, source)
    if quantity.world or quantity.body:
        frames = (BODIES[source.body or "FLU"] if quantity.body else np.eye(3)) if name != "v_world" else np.eye(3)
        values = values @ (WORLDS[source.world or "ENU"] @ frames).T
    return values


def _commands(source: ChannelSource, raw) -> np.ndarray:
    """Return motor commands, 0..1; slightly outside of their range they are at its end."""
    low, high = source.range or RANGES.get(source.unit) or (0.0, 1.0 / SHARE[source.unit or "1"])
    shares = source.scale * (raw - low) / (high - low)
    with np.errstate(invalid="ignore"):
        near = (shares > -COMMAND_MARGIN) & (shares < 1.0 + COMMAND_MARGIN)
    return np.where(near, np.clip(shares, 0.0, 1.0), shares)


def _attitudes(source: ChannelSource, raw) -> np.ndarray:
    """Return quaternions (n, 4) that rotate body into world vectors."""
    q = raw if raw.shape[1] == 4 else from_euler(raw * source.scale * ANGLE[source.unit or "rad"])
    world, body = WORLDS[source.world or "ENU"], BODIES[source.body or "FLU"]
    q = geometry.quaternion_multiply(geometry.quaternion_from_matrix(world)[None], q)
    return geometry.quaternion_multiply(q, geometry.quaternion_from_matrix(body.T)[None])


def from_euler(angles) -> np.ndarray:
    """Return quaternions (n, 4) of roll, pitch and yaw (n, 3) rad: about z, then the new y, then the new x."""
    zero = np.zeros(len(angles))
    roll, pitch, yaw = (np.stack([np.sin(0.5 * a), np.cos(0.5 * a)]) for a in angles.T)
    q_roll = np.stack([roll[0], zero, zero, roll[1]], axis=-1)
    q_pitch = np.stack([zero, pitch[0], zero, pitch[1]], axis=-1)
    q_yaw = np.stack([zero, zero, yaw[0], yaw[1]], axis=-1)
    return geometry.quaternion_multiply(q_yaw, geometry.quaternion_multiply(q_pitch, q_roll))
