"""The flight table: what one recorded flight measured, SI, each channel at its own stamps. Pure.

`gap` and `identify` read it. It comes from a CSV or Parquet table or from a bag of this graph (`flight_files`); what
cannot be a measurement is left out and named in `rejections`.
"""

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.recording.checks import Channel, Rejection, check_channel, check_time, stretches, unchanged
from swift_ros.track import Track

TIME = "t"
RATE_RANGE_HZ = (50.0, 2000.0)
RATE_TOLERANCE = 0.02  # a clock that jitters
UNIT_LENGTH = 0.05  # a quaternion further than this from length one is none
MAX_ROTORS = 12
FINER = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
ALWAYS, SELDOM = 0.75, 0.01  # of its rows: beyond the possible in another unit, and in the right one
FROZEN_S, TURNED, LEAP = 0.1, 0.3, 0.1  # a pose stands still while the gyro turns (rad), and goes on with a leap (rad)
SPUN_S, DRIVEN = 0.25, 0.3  # a rotor's speed stands still while its command changes by so much
BIASED = 0.5  # rad/s: no gyro that is at rest says so much
DEGREES, MILLI = np.pi / 180.0, 1e-3
OTHER_UNITS = {  # by channel: in which a recorder may have written, and what one of it is
    **dict.fromkeys(("gyro_body", "omega_command_body"), {"degrees a second": DEGREES, "mrad/s": MILLI}),
    **dict.fromkeys(("specific_force_body", "thrust_command"), {"mm/s^2": MILLI}),
    "p_world": {"millimetres": MILLI},
    "v_world": {"mm/s": MILLI},
    "rotor_speed": {"rpm": 2.0 * np.pi / 60.0},
    "motor_command": {"percent": 0.01, "thousandths": MILLI},
    "voltage": {"millivolts": MILLI},
    "current": {"milliamperes": MILLI},
}


@dataclass(frozen=True)
class ChannelSpec:
    """What one sensor or command tells at a time.

    columns: of the table; `rotor_#` stands for rotor_1, rotor_2 and so on; unit; low, high: what can be true;
    measured: by a sensor, whose values neither stand still on a slope nor follow a ruler; noisy: nor at rest;
    least_range: no such sensor ends earlier.
    """

    columns: tuple[str, ...]
    unit: str
    low: float
    high: float
    measured: bool = True
    noisy: bool = False
    least_range: float = np.inf


# A motor command acts from its time on until the next, but for `skips_commands`.
CHANNELS = {
    "p_world": ChannelSpec(("px", "py", "pz"), "m", -1e5, 1e5),
    "v_world": ChannelSpec(("vx", "vy", "vz"), "m/s", -120.0, 120.0),
    "q_world_body": ChannelSpec(("qx", "qy", "qz", "qw"), "", -1.05, 1.05),
    "gyro_body": ChannelSpec(("wx", "wy", "wz"), "rad/s", -70.0, 70.0, noisy=True, least_range=4.0),
    "specific_force_body": ChannelSpec(("ax", "ay", "az"), "m/s^2", -400.0, 400.0, True, True, 19.0),
    "rotor_speed": ChannelSpec(("rotor_#",), "rad/s", 0.0, 2e4),
    "motor_command": ChannelSpec(("u_#",), "", -1e-6, 1.0 + 1e-6),
    "thrust_command": ChannelSpec(("cmd_thrust",), "m/s^2", -20.0, 400.0, measured=False),
    "omega_command_body": ChannelSpec(("cmd_wx", "cmd_wy", "cmd_wz"), "rad/s", -70.0, 70.0, measured=False),
    "feedforward_body": ChannelSpec(("ff_x", "ff_y", "ff_z"), "", -20.0, 20.0, measured=False),
    "voltage": ChannelSpec(("vbat",), "V", 1e-3, 120.0),
    "current": ChannelSpec(("ibat",), "A", -200.0, 2000.0),
    "p_vio": ChannelSpec(("vio_px", "vio_py", "vio_pz"), "m", -1e5, 1e5),
    "q_vio_body": ChannelSpec(("vio_qx", "vio_qy", "vio_qz", "vio_qw"), "", -1.05, 1.05),
}
POSE, DRIVES = ("p_world", "q_world_body"), ("rotor_speed", "motor_command", "thrust_command")


@dataclass(frozen=True)
class Samples:
    """One channel: t (n,) s, growing; values (n, k), or (n,) where the channel has one column."""

    t: np.ndarray
    values: np.ndarray

    @cached_property
    def rate_hz(self) -> float:
        """The usual rate: one over the median time step."""
        return float(1.0 / np.median(np.diff(self.t)))


@dataclass(frozen=True)
class DetectedGates:
    """Gates in images, as a detector told them: t (n,) s of each one's image, never falling; corners (n, 4, 2) px, TL,
    TR, BR, BL of the gate upright; camera and track: those that the stack believed in."""

    t: np.ndarray
    corners: np.ndarray
    camera: Camera
    track: Track


@dataclass(frozen=True)
class FlightTable:
    """One flight. name: for a reader; channels: by name of `CHANNELS`, only those that were recorded; rejections: what
    was left out of them, on the same clock; seen: gates in images, None where there were no images; spun: the rotor
    speeds are what somebody made of the motor commands, not measured; skips_commands: the motors heard others between
    those that were recorded."""

    name: str
    channels: Mapping[str, Samples]
    rejections: tuple[Rejection, ...] = ()
    detected_gates: DetectedGates | None = None
    rotor_speed_modelled: bool = False
    skips_commands: bool = False

    def __contains__(self, channel: str) -> bool:
        return channel in self.channels

    def __getitem__(self, channel: str) -> Samples:
        return self.channels[channel]

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time of all channels."""
        return min(s.t[0] for s in self.channels.values()), max(s.t[-1] for s in self.channels.values())

    def require(self, *names: str) -> None:
        """Raise UsageError when the flight lacks one of these channels."""
        for name in names:
            if name not in self.channels:
                columns = ", ".join(CHANNELS[name].columns)
                raise UsageError(f"{self.name} lacks {columns}; it has {', '.join(self.channels)}")


def check(
    name: str,
    raw: Mapping[str, Samples],
    rejections: tuple[Rejection, ...] = (),
    detected_gates: DetectedGates | None = None,
    skips_commands: bool = False,
) -> FlightTable:
    """Return the table of channels as they were recorded: without what cannot be a measurement, attitudes of length
    one. Rows without any number are missing, not corrupt. seen, skips_commands: as `FlightTable` has them.

    Raises UsageError when what a flight must hold is not there, or comes at another rate than 50 to 2,000 Hz.
    """
    channels, clock, found = {}, {}, list(rejections)
    for channel, samples in raw.items():
        samples, late = _growing(channel, samples)
        for rejection in late:  # what befell several channels at the same time was the clock's or the recorder's
            key = rejection.begin_s, rejection.end_s, rejection.reason
            clock[key] = replace(rejection, channel=TIME) if key in clock else rejection
        good, rejected = _credible(channel, samples)
        _check_unit(name, channel, samples)
        found += rejected
        if len(good.t) > 1:
            channels[channel] = good
    for channel, frozen in _frozen(channels).items():
        samples = channels.pop(channel)
        if np.count_nonzero(~frozen) > 1:
            channels[channel] = Samples(samples.t[~frozen], samples.values[~frozen])
        reason = f"stands still while the {'commands change' if channel == 'rotor_speed' else 'gyro turns'}: frozen"
        found += [Rejection(samples.t[first], samples.t[last], channel, reason) for first, last in stretches(frozen)]
    found = sorted([*clock.values(), *found], key=lambda rejection: rejection.begin_s)
    table = FlightTable(name, channels, tuple(found), detected_gates, skips_commands=skips_commands)
    _check_required(table, raw)
    return table


def _growing(channel: str, samples: Samples) -> tuple[Samples, list[Rejection]]:
    """Return the rows of a channel that hold numbers at growing times, and what was wrong with its clock."""
    values = np.asarray(samples.values, dtype=float)
    there = ~np.isnan(values.reshape(len(values), -1)).any(axis=1)
    t, values = np.asarray(samples.t, dtype=float)[there], values[there]
    growing, rejections = check_time(t)
    return Samples(t[growing], values[growing]), [replace(rejection, channel=channel) for rejection in rejections]


def _credible(channel: str, samples: Samples) -> tuple[Samples, list[Rejection]]:
    """Return the rows of a channel that can be true, and what was wrong with the others."""
    spec, t, values = CHANNELS[channel], samples.t, samples.values
    if not len(t):
        return samples, []
    if spec.measured:
        good, rejections = check_channel(
            t, Channel(channel, values, spec.low, spec.high, spec.unit, spec.noisy, spec.least_range)
        )
    else:
        good = ((values >= spec.low) & (values <= spec.high)).reshape(len(values), -1).all(axis=1)
        reason = f"beyond the possible {spec.low:g} to {spec.high:g} {spec.unit}"
        rejections = [Rejection(t[first], t[last], channel, reason) for first, last in stretches(~good)]
    if len(spec.columns) == 4:
        odd = good & (np.abs(np.linalg.norm(values, axis=1) - 1.0) > UNIT_LENGTH)
        reason = "the quaternion's length is not 1"
        rejections += [Rejection(t[first], t[last], channel, reason) for first, last in stretches(odd)]
        good, values = good & ~odd, geometry.normalize(values)
    return Samples(t[good], values[good]), rejections


def _frozen(channels: Mapping[str, Samples]) -> dict[str, np.ndarray]:
    """Return which rows (n,) of pose, velocity and rotor speeds repeat what was said before though other channels show
    that it cannot have lasted, by channel; without those of which none do."""
    spans, found = _frozen_attitudes(channels), {}
    for name in (name for name in ("p_world", "q_world_body", "v_world") if name in channels):
        t, values = channels[name].t, channels[name].values
        same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
        found[name] = same & np.array([any(begin < stamp <= end for begin, end in spans) for stamp in t])
    if "rotor_speed" in channels and "motor_command" in channels:
        found["rotor_speed"] = _frozen_rotors(channels["rotor_speed"], channels["motor_command"])
    return {name: rows for name, rows in found.items() if rows.any()}


def _frozen_attitudes(channels: Mapping[str, Samples]) -> list[tuple[float, float]]:
    """Return first and last time of each stretch in which the attitude stands still while the gyro turns clearly. Where
    it goes on with no leap it was at rest, and is late."""
    if "q_world_body" not in channels or "gyro_body" not in channels:
        return []
    attitude, gyro, found = channels["q_world_body"], channels["gyro_body"], []
    for first, last in unchanged(attitude.t, attitude.values, FROZEN_S):
        begin, end = attitude.t[first], attitude.t[last]
        ends = last + 1 == len(attitude.t)
        apart = 1.0 if ends else abs(float(attitude.values[last] @ attitude.values[last + 1]))
        inside = (gyro.t >= begin) & (gyro.t <= end)
        if (ends or 2.0 * np.arccos(min(apart, 1.0)) > LEAP) and _turns(gyro.t[inside], gyro.values[inside]):
            found.append((begin, end))
    return found


def _turns(t, gyro) -> bool:
    """Return whether a gyro (n, 3) rad/s at t (n,) s turns clearly: to and fro, or faster than any that is at rest."""
    if len(t) < 2:
        return False
    steps = np.diff(t, append=t[-1])
    steps = np.minimum(steps, 2.0 * np.median(steps))  # over a gap nothing is known
    mean = gyro.mean(axis=0)
    to_and_fro = np.ptp(np.cumsum((gyro - mean) * steps[:, None], axis=0), axis=0).max()
    onwards = np.linalg.norm(mean)
    return bool(to_and_fro > TURNED or (onwards > BIASED and onwards * (t[-1] - t[0]) > TURNED))


def _frozen_rotors(speed: Samples, command: Samples) -> np.ndarray:
    """Return the rows (n,) in which one rotor's speed stands still while its command changes. At its least and greatest
    value it may: a motor stops, and has a limit."""
    frozen = np.zeros(len(speed.t), bool)
    if speed.values.shape[1] != command.values.shape[1]:
        return frozen
    for column, sent in zip(speed.values.T, command.values.T, strict=True):
        for first, last in unchanged(speed.t, column, SPUN_S):
            begin, end = speed.t[first], speed.t[last] - FROZEN_S  # later commands may not have come through
            during = sent[(command.t >= begin) & (command.t <= end)]
            if column.min() < column[first] < column.max() and len(during) and np.ptp(during) > DRIVEN:
                frozen[first + 1 : last + 1] = True
    return frozen


def _check_unit(name: str, channel: str, samples: Samples) -> None:
    """Raise UsageError when hardly a row of a channel can be true; it names the unit in which all would be."""
    spec, values = CHANNELS[channel], samples.values.reshape(len(samples.t), -1) if len(samples.t) else np.empty((0, 1))

    def beyond(values) -> float:
        return float(np.mean(((values < spec.low) | (values > spec.high)).any(axis=1)))

    if len(values) and beyond(values) > ALWAYS:
        columns = ", ".join(_numbered(spec, values.shape[1]))
        possible = f"{spec.low:g} to {spec.high:g} {spec.unit}".rstrip()
        unit = next(
            (
                f"; are they in {unit}?"
                for unit, one in OTHER_UNITS.get(channel, {}).items()
                if beyond(values * one) < SELDOM
            ),
            "",
        )
        raise UsageError(
            f"{name}: {columns} are beyond the possible {possible} in {beyond(values):.0%} of the rows, "
            f"up to {np.abs(values).max():.6g}; a flight table is in SI units{unit}"
        )


def _check_required(table: FlightTable, raw: Mapping[str, Samples]) -> None:
    pose = all(name in table for name in POSE)
    if not pose and "specific_force_body" not in table:
        for name in (name for name in (*POSE, "specific_force_body") if name in raw and name not in table):
            why = next((one.reason for one in table.rejections if one.channel in (TIME, name)), "no row holds a number")
            raise UsageError(f"{table.name}: nothing is left of {', '.join(CHANNELS[name].columns)}: {why}")
        raise UsageError(f"{table.name} has neither a pose (px .. qw) nor an accelerometer (ax ay az); one is needed")
    if not any(name in table for name in DRIVES):
        raise UsageError(
            f"{table.name} has no rotor speeds (rotor_1 ..), motor commands (u_1 ..) or commanded thrust "
            "(cmd_thrust); one of them is needed"
        )
    low, high = RATE_RANGE_HZ
    for name in (*POSE, "specific_force_body", *DRIVES):
        if name in table and not low * (1 - RATE_TOLERANCE) <= table[name].rate_hz <= high * (1 + RATE_TOLERANCE):
            rate = table[name].rate_hz
            unit = next(
                (f"; is {TIME} in {unit}, not seconds?" for unit, many in FINER.items() if low <= rate * many <= high),
                "",
            )
            raise UsageError(
                f"{table.name}: {', '.join(CHANNELS[name].columns)} come at {rate:.4g} Hz; {low:g} to "
                f"{high:g} Hz can be read{unit}"
            )


def channels_from_columns(name: str, columns: Mapping[str, np.ndarray]) -> dict[str, Samples]:
    """Return the channels of a table's columns (n,) by name, unchecked.

    Raises UsageError for a column that no flight table has, naming the nearest, and for a channel with a part missing.
    """
    if TIME not in columns:
        raise UsageError(f"{name} lacks the column {TIME} (time, s)")
    known = known_columns()
    for column in columns:
        if column not in known:
            near = difflib.get_close_matches(column, known, n=1, cutoff=0.0)[0]
            raise UsageError(f"{name} has the unknown column '{column}'; the nearest known one is '{near}'")
    channels = {}
    for channel, spec in CHANNELS.items():
        wanted = _columns_of(spec, columns)
        there = [column for column in wanted if column in columns]
        if not there:
            continue
        if len(there) < len(wanted):
            missing = next(column for column in wanted if column not in columns)
            raise UsageError(f"{name} has {', '.join(there)} but lacks {missing}")
        values = np.stack([np.asarray(columns[column], dtype=float) for column in wanted], axis=-1)
        single = len(spec.columns) == 1 and "#" not in spec.columns[0]
        channels[channel] = Samples(np.asarray(columns[TIME], dtype=float), values[:, 0] if single else values)
    return channels


def columns_of(table: FlightTable) -> dict[str, np.ndarray]:
    """Return the columns (n,) of a table, one row for each time at which any channel has a sample, NaN elsewhere."""
    t = np.unique(np.concatenate([samples.t for samples in table.channels.values()]))
    columns = {TIME: t}
    for channel, samples in table.channels.items():
        rows = np.searchsorted(t, samples.t)
        values = samples.values.reshape(len(samples.t), -1)
        for i, column in enumerate(_numbered(CHANNELS[channel], values.shape[1])):
            columns[column] = np.full(len(t), np.nan)
            columns[column][rows] = values[:, i]
    return columns


def known_columns() -> list[str]:
    """Return the names of all columns that a flight table can have."""
    return [TIME, *(column for spec in CHANNELS.values() for column in _numbered(spec, MAX_ROTORS))]


def _columns_of(spec: ChannelSpec, columns) -> list[str]:
    """Return the columns that a channel must have: of rotors, as many as the highest number there is."""
    pattern = re.compile(re.escape(spec.columns[0]).replace(r"\#", r"(\d+)") + "$")
    numbers = [int(match[1]) for match in map(pattern.match, columns) if match and match.groups()]
    return _numbered(spec, max(numbers, default=0))


def _numbered(spec: ChannelSpec, count: int) -> list[str]:
    if "#" not in spec.columns[0]:
        return list(spec.columns)
    return [spec.columns[0].replace("#", str(i + 1)) for i in range(count)]
