"""Checks of a flight table: removes samples that cannot be measurements and refuses wrong units and rates. No ROS."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording.checks import Rejection, SensorChannel, check_channel, check_time, constant_runs, true_runs
from swift_ros.recording.flight_channels import ACTUATION, CHANNELS, POSE, TIME, numbered_columns
from swift_ros.recording.flight_table import DetectedGates, FlightTable, Samples
from swift_ros.recording.log_mapping.quantities import RATE_RANGE_HZ, RATE_TOLERANCE, lowest_rate_hz

UNIT_LENGTH_TOLERANCE = 0.05  # a quaternion whose length differs more from 1 is rejected
TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}  # per second

# A unit is wrong when more than the first share of the rows is out of range, and another unit is proposed when less
# than the second share is out of range in it.
MIN_WRONG_SHARE, MAX_RIGHT_SHARE = 0.75, 0.01
DEGREES, MILLI = np.pi / 180.0, 1e-3
OTHER_UNITS = {  # by channel: names of units in which it may have been recorded, and their values in SI
    **dict.fromkeys(("gyro_body", "omega_command_body"), {"degrees a second": DEGREES, "mrad/s": MILLI}),
    **dict.fromkeys(("specific_force_body", "thrust_command"), {"mm/s^2": MILLI}),
    "p_world": {"millimetres": MILLI},
    "v_world": {"mm/s": MILLI},
    "rotor_speed": {"rpm": 2.0 * np.pi / 60.0},
    "motor_command": {"percent": 0.01, "thousandths": MILLI},
    "voltage": {"millivolts": MILLI},
    "current": {"milliamperes": MILLI},
}

# A pose is frozen when its attitude is constant while the gyro measures a rotation. Smaller bounds reject more poses.
FROZEN_POSE_S = 0.1  # s; shortest constant attitude
MIN_ROTATION = 0.3  # rad; smallest rotation of the gyro within it, 17 degrees
MIN_ATTITUDE_STEP = 0.1  # rad; smallest step of the attitude at its end; without a step the vehicle was at rest
MAX_GYRO_BIAS = 0.5  # rad/s; largest mean rate of a gyro at rest
# A rotor speed is frozen when it is constant while its command changes.
FROZEN_ROTOR_S = 0.25  # s; shortest constant speed: 7 time constants of the shipped vehicle's motors
MIN_COMMAND_CHANGE = 0.3  # smallest change of the motor command (0 to 1) within it


def checked_table(
    name: str,
    raw: Mapping[str, Samples],
    rejections: tuple[Rejection, ...] = (),
    detected_gates: DetectedGates | None = None,
    skips_commands: bool = False,
) -> FlightTable:
    """Return the flight table of recorded channels, without samples that cannot be measurements.

    Attitudes are normalised. Rows without any number are missing data and are not reported.

    Args:
        name: of the flight.
        raw: recorded channels by name.
        rejections: what was removed before.
        detected_gates: see `FlightTable`.
        skips_commands: see `FlightTable`.

    Raises:
        UsageError: a required channel is missing, is in a wrong unit, or has a rate outside of 50 to 2,000 Hz; a pose
            beside an IMU may be slower (see `lowest_rate_hz`).
    """
    channels, clock, found = {}, {}, list(rejections)
    for channel, samples in raw.items():
        samples, time_rejections = _increasing(channel, samples)
        for rejection in time_rejections:  # the same in several channels: caused by the clock or the recorder
            key = rejection.begin_s, rejection.end_s, rejection.reason
            clock[key] = replace(rejection, channel=TIME) if key in clock else rejection
        good, rejected = _plausible(channel, samples)
        _check_unit(name, channel, samples)
        found += rejected
        if len(good.t) > 1:
            channels[channel] = good
    for channel, frozen in _frozen(channels).items():
        samples = channels.pop(channel)
        if np.count_nonzero(~frozen) > 1:
            channels[channel] = Samples(samples.t[~frozen], samples.values[~frozen])
        cause = "commands change" if channel == "rotor_speed" else "gyro turns"
        reason = f"constant while the {cause}: frozen"
        found += [Rejection(samples.t[first], samples.t[last], channel, reason) for first, last in true_runs(frozen)]
    found = sorted([*clock.values(), *found], key=lambda rejection: rejection.begin_s)
    table = FlightTable(name, channels, tuple(found), detected_gates, skips_commands=skips_commands)
    _check_required(table, raw)
    return table


def _increasing(channel: str, samples: Samples) -> tuple[Samples, list[Rejection]]:
    """Return the rows of a channel that hold numbers at increasing times, and the rejections of its times."""
    values = np.asarray(samples.values, dtype=float)
    present = ~np.isnan(values.reshape(len(values), -1)).any(axis=1)
    t, values = np.asarray(samples.t, dtype=float)[present], values[present]
    increasing, rejections = check_time(t)
    return Samples(t[increasing], values[increasing]), [replace(rejection, channel=channel) for rejection in rejections]


def _plausible(channel: str, samples: Samples) -> tuple[Samples, list[Rejection]]:
    """Return the valid rows of a channel, and the rejections of the others."""
    spec, t, values = CHANNELS[channel], samples.t, samples.values
    if not len(t):
        return samples, []
    if spec.measured:
        sensor = SensorChannel(
            name=channel,
            values=values,
            low=spec.low,
            high=spec.high,
            unit=spec.unit,
            noisy=spec.noisy,
            min_range=spec.min_range,
        )
        good, rejections = check_channel(t, sensor)
    else:
        good = ((values >= spec.low) & (values <= spec.high)).reshape(len(values), -1).all(axis=1)
        reason = f"outside of {spec.low:g} to {spec.high:g} {spec.unit}"
        rejections = [Rejection(t[first], t[last], channel, reason) for first, last in true_runs(~good)]
    if len(spec.columns) == 4:
        bad_length = good & (np.abs(np.linalg.norm(values, axis=1) - 1.0) > UNIT_LENGTH_TOLERANCE)
        reason = "the quaternion's length is not 1"
        rejections += [Rejection(t[first], t[last], channel, reason) for first, last in true_runs(bad_length)]
        good, values = good & ~bad_length, geometry.normalize(values)
    return Samples(t[good], values[good]), rejections


def _frozen(channels: Mapping[str, Samples]) -> dict[str, np.ndarray]:
    """Return masks (n,) of the frozen rows of pose, velocity and rotor speeds, by channel, where there are any.

    A frozen row repeats the row before it although other channels show that the value has changed.
    """
    spans, found = _frozen_attitudes(channels), {}
    for name in (name for name in ("p_world", "q_world_body", "v_world") if name in channels):
        t, values = channels[name].t, channels[name].values
        same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
        found[name] = same & np.array([any(begin < stamp <= end for begin, end in spans) for stamp in t])
    if "rotor_speed" in channels and "motor_command" in channels:
        found["rotor_speed"] = _frozen_rotors(channels["rotor_speed"], channels["motor_command"])
    return {name: rows for name, rows in found.items() if rows.any()}


def _frozen_attitudes(channels: Mapping[str, Samples]) -> list[tuple[float, float]]:
    """Return first and last time of each run in which the attitude is constant while the gyro clearly turns.

    A run that ends without a step of the attitude is not frozen: the vehicle was at rest, and the attitude is late.
    """
    if "q_world_body" not in channels or "gyro_body" not in channels:
        return []
    attitude, gyro, found = channels["q_world_body"], channels["gyro_body"], []
    for first, last in constant_runs(attitude.t, attitude.values, FROZEN_POSE_S):
        begin, end = attitude.t[first], attitude.t[last]
        at_end = last + 1 == len(attitude.t)
        cosine = 1.0 if at_end else abs(float(attitude.values[last] @ attitude.values[last + 1]))
        inside = (gyro.t >= begin) & (gyro.t <= end)
        steps = at_end or 2.0 * np.arccos(min(cosine, 1.0)) > MIN_ATTITUDE_STEP
        if steps and _rotates(gyro.t[inside], gyro.values[inside]):
            found.append((begin, end))
    return found


def _rotates(t, gyro) -> bool:
    """Return whether a gyro (n, 3) rad/s at t (n,) s measures an oscillation, or a mean rate above any bias."""
    if len(t) < 2:
        return False
    steps = np.diff(t, append=t[-1])
    steps = np.minimum(steps, 2.0 * np.median(steps))  # the rate within a gap is unknown
    mean = gyro.mean(axis=0)
    oscillation = np.ptp(np.cumsum((gyro - mean) * steps[:, None], axis=0), axis=0).max()
    mean_rate = np.linalg.norm(mean)
    return bool(oscillation > MIN_ROTATION or (mean_rate > MAX_GYRO_BIAS and mean_rate * (t[-1] - t[0]) > MIN_ROTATION))


def _frozen_rotors(speed: Samples, command: Samples) -> np.ndarray:
    """Return a mask (n,) of the rows in which one rotor's speed is constant while its command changes.

    At its smallest and largest value a speed may be constant: a motor stops, and has a limit.
    """
    frozen = np.zeros(len(speed.t), bool)
    if speed.values.shape[1] != command.values.shape[1]:
        return frozen
    for column, sent in zip(speed.values.T, command.values.T, strict=True):
        for first, last in constant_runs(speed.t, column, FROZEN_ROTOR_S):
            begin, end = speed.t[first], speed.t[last] - FROZEN_POSE_S  # a later command may not act yet
            during = sent[(command.t >= begin) & (command.t <= end)]
            between_limits = column.min() < column[first] < column.max()
            if between_limits and len(during) and np.ptp(during) > MIN_COMMAND_CHANGE:
                frozen[first + 1 : last + 1] = True
    return frozen


def _check_unit(name: str, channel: str, samples: Samples) -> None:
    """Raise UsageError when most rows of a channel are out of range, with the unit in which they would not be."""
    spec, values = CHANNELS[channel], samples.values.reshape(len(samples.t), -1) if len(samples.t) else np.empty((0, 1))

    def share_outside(values) -> float:
        return float(np.mean(((values < spec.low) | (values > spec.high)).any(axis=1)))

    if len(values) and share_outside(values) > MIN_WRONG_SHARE:
        columns = ", ".join(numbered_columns(spec, values.shape[1]))
        possible = f"{spec.low:g} to {spec.high:g} {spec.unit}".rstrip()
        units = OTHER_UNITS.get(channel, {}).items()
        right = (unit for unit, factor in units if share_outside(values * factor) < MAX_RIGHT_SHARE)
        question = next((f"; are they in {unit}?" for unit in right), "")
        raise UsageError(
            f"{name}: {columns} are outside of {possible} in {share_outside(values):.0%} of the rows, "
            f"up to {np.abs(values).max():.6g}; a flight table is in SI units{question}"
        )


def _check_required(table: FlightTable, raw: Mapping[str, Samples]) -> None:
    """Raise UsageError when a required channel is missing or has an unusable rate."""
    pose = all(name in table for name in POSE)
    if not pose and "specific_force_body" not in table:
        for name in (name for name in (*POSE, "specific_force_body") if name in raw and name not in table):
            reasons = (rejection.reason for rejection in table.rejections if rejection.channel in (TIME, name))
            reason = next(reasons, "no row holds a number")
            raise UsageError(f"{table.name}: no valid rows of {', '.join(CHANNELS[name].columns)}: {reason}")
        raise UsageError(f"{table.name} has neither a pose (px .. qw) nor an accelerometer (ax ay az); one is needed")
    if not any(name in table for name in ACTUATION):
        raise UsageError(
            f"{table.name} has no rotor speeds (rotor_1 ..), motor commands (u_1 ..) or commanded thrust "
            "(cmd_thrust); one of them is needed"
        )
    rates = {name: samples.rate_hz for name, samples in table.channels.items()}
    for name in (*POSE, "specific_force_body", *ACTUATION):
        if name in table:
            _check_rate(table, name, rates)


def _check_rate(table: FlightTable, name: str, rates: Mapping[str, float]) -> None:
    low, high = RATE_RANGE_HZ
    rate = rates[name]
    if lowest_rate_hz(name, rates) <= rate <= high * (1 + RATE_TOLERANCE):
        return
    right = (unit for unit, per_second in TIME_UNITS.items() if low <= rate * per_second <= high)
    question = next((f"; is {TIME} in {unit}, not seconds?" for unit in right), "")
    raise UsageError(
        f"{table.name}: {', '.join(CHANNELS[name].columns)} come at {rate:.4g} Hz; supported are {low:g} to "
        f"{high:g} Hz{question}"
    )
