"""Importer of Betaflight blackbox logs (`.bbl`, `.bfl`) of version 4.0 and later.

The axes of a log are forward, left and up. It has no position and attitude; these can come from a bag recorded at the
same time, to whose clock `alignment` aligns the log.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import full_name
from swift_ros.importers import blackbox_log
from swift_ros.importers.alignment import align
from swift_ros.importers.blackbox_log import header_number
from swift_ros.importers.flight import ChannelChecker, ForeignFlight, Stream, battery_stream, imu_stream, rotor_stream
from swift_ros.messages.control import to_command
from swift_ros.messages.stamps import from_time
from swift_ros.messages.vectors import from_xyz, to_stamped_vector
from swift_ros.recording import bags
from swift_ros.recording.checks import Rejection, SensorChannel
from swift_ros.text import excerpt
from swift_ros.types import BodyRateThrust
from swift_ros.vehicle import GRAVITY

SUFFIXES = (".bbl", ".bfl")
MIN_VERSION = (4, 0)  # first supported version of Betaflight
MAX_RATE_HZ = 2000.0  # Hz, the largest rate of a flight table; of a faster log every n-th frame is kept
MIN_DSHOT, DSHOT_RANGE = 48.0, 1999.0  # motor output of DSHOT at rest, and its range
MIN_PULSE_US, PULSE_RANGE_US = 1000.0, 1000.0  # motor output of analogue protocols at rest, and its range, us
ERPM_STEP, DEFAULT_POLES = 100.0, 14  # electrical rpm of one step; poles of a motor where the log has none
PID_UNITS = 1000.0  # PID output for the motors' whole range (mixer.c, PID_MIXER_SCALING)
NO_RPM = "speeds were not logged (bidirectional DSHOT was off)"

NOTES = {
    "frames": "base_link = the flight controller's axes, forward-left-up; the log has no position and attitude",
    "command/body_rate_thrust": "the rate loop's setpoint; thrust is unknown",
    "betaflight/feedforward": "the rate loop's F term; gyro (filtered by the loop), setpoint, F and motors of a row are"
    " from one cycle",
    "betaflight/rotors": "motor = the mixer's output, Betaflight's order (rear right, front right, rear left, front "
    "left on a standard frame)",
}


class Source(NamedTuple):
    """One log of a file: its number, and the number of logs in the file."""

    path: Path
    number: int
    count: int

    def __str__(self) -> str:
        return str(self.path) + (f", log {self.number} of {self.count}" if self.count > 1 else "")


def find(path: Path) -> list[Source]:
    """Return the logs at a file or in a folder."""
    candidates = [path] if path.is_file() else sorted(path.rglob("*"))
    files = [file for file in candidates if file.suffix.lower() in SUFFIXES]
    found = []
    for file in files:
        count = len(blackbox_log.split(file.read_bytes()))
        found += [Source(file, i + 1, count) for i in range(max(count, 1))]
    return found


def read(source: Source, bag: Path | None = None) -> ForeignFlight:
    """Return one log.

    Args:
        source: file and number of the log.
        bag: bag of the same flight; the log is then aligned to its clock and its other topics are copied.

    Raises:
        UsageError: the log cannot be decoded, or the bag is of another flight.
    """
    logs = blackbox_log.split(source.path.read_bytes())
    if not logs:
        raise UsageError(f"{source} is not a blackbox log: it does not begin with '{blackbox_log.BEGIN.decode()}'")
    log = blackbox_log.decode(logs[source.number - 1], str(source))
    _check_firmware(log, source)
    if len(log.time_us) < 2:
        raise UsageError(f"{source} holds no flight: {len(log.time_us)} frames can be decoded")
    kept = _rows(log)
    t = log.time_us[kept] * 1e-6
    checker = ChannelChecker(t, _undecoded(log, t))
    streams = (
        _imu(log, kept, checker, str(source)),
        _rotors(log, kept, checker, str(source)),
        _battery(log, kept, checker),
        _setpoint(log, kept),
        _feedforward(log, kept),
    )
    missing = "" if _speeds(log, kept) is not None else f"; {NO_RPM}"
    notes = NOTES | {
        "source": f"blackbox of {log.header['Firmware revision']}",
        "betaflight/rotors": NOTES["betaflight/rotors"] + missing,
    }
    name = source.path.stem + (f"-{source.number}" if source.count > 1 else "")
    flight = ForeignFlight(name, t, tuple(stream for stream in streams if stream), notes, tuple(checker.rejections))
    return flight if bag is None else _aligned(flight, log, kept, bag, source)


def _aligned(flight: ForeignFlight, log: blackbox_log.Log, kept: slice, bag: Path, source: Source) -> ForeignFlight:
    """Return the flight on the clock of a bag; of commands in both, those of the bag are kept: the pilot sent them."""
    gyro = _columns(log, "gyroADC", 3, kept)
    if gyro is None:
        raise UsageError(f"{source} has no gyro, which the alignment needs; log it (blackbox_disable_gyro = OFF)")
    topic, commands = full_name("imu/data_raw"), full_name("command/body_rate_thrust")
    bags.require(bag, topic)
    rates = [(message.header.stamp, message.angular_velocity) for _, message, _ in bags.read(bag, [topic])]
    t_bag = np.array([from_time(stamp) for stamp, _ in rates]) * 1e-9
    gyro_bag = np.array([from_xyz(rate) for _, rate in rates])
    alignment = align(flight.t, np.deg2rad(gyro / _resolution(log)), t_bag, gyro_bag)
    t, begin_s = alignment.at(flight.t), next(bags.read_raw(bag)).log_time_ns * 1e-9
    has_commands = commands in bags.topic_types(bag)
    streams = tuple(stream for stream in flight.streams if not (has_commands and full_name(stream.topic) == commands))
    rejections = tuple(rejection.since(min(begin_s, t[0]) - t[0]) for rejection in flight.rejections)
    notes = {**bags.custom_data(bag), **flight.notes, "aligned": f"to {bag.name}: {alignment}"}
    return replace(flight, t=t, streams=streams, notes=notes, rejections=rejections, aligned_bag=bag)


def _check_firmware(log: blackbox_log.Log, source: Source) -> None:
    revision = log.header.get("Firmware revision", "an unnamed firmware")
    version = re.match(r"Betaflight ([0-9]{1,4})\.([0-9]{1,4})", revision)
    if not version or tuple(map(int, version.groups())) < MIN_VERSION:
        raise UsageError(f"{source} was written by {excerpt(revision)}; Betaflight 4.0 and later are supported")


def _rows(log: blackbox_log.Log) -> slice:
    """Return the frames to keep: every n-th, so that the rate does not exceed MAX_RATE_HZ."""
    return slice(None, None, max(1, int(np.ceil(1e6 / (MAX_RATE_HZ * np.median(np.diff(log.time_us))) - 0.02))))


def _undecoded(log: blackbox_log.Log, t) -> list[Rejection]:
    found = [Rejection(begin * 1e-6, end * 1e-6, "blackbox", "frames cannot be decoded") for begin, end in log.gaps]
    if not log.ended:
        found.append(Rejection(t[-1], t[-1], "blackbox", "the log is truncated here: its end was not written"))
    return found


def _imu(log: blackbox_log.Log, kept: slice, checker: ChannelChecker, where: str) -> Stream | None:
    gyro = _columns(log, "gyroADC", 3, kept)
    if gyro is None:
        return None
    gyro = np.deg2rad(gyro / _resolution(log))
    good = checker.good(SensorChannel("gyro", gyro, -35.0, 35.0, "rad/s"))
    force = _columns(log, "accSmooth", 3, kept)
    gravity_steps = header_number(log.header, "acc_1G", 0, where)
    if force is None or gravity_steps <= 0:
        return imu_stream(good, gyro, np.full_like(gyro, np.nan))
    force = GRAVITY * force / gravity_steps
    good &= checker.good(SensorChannel("accelerometer", force, -320.0, 320.0, "m/s^2"))
    return imu_stream(good, gyro, force)


def _rotors(log: blackbox_log.Log, kept: slice, checker: ChannelChecker, where: str) -> Stream | None:
    count = sum(name.startswith("motor[") for name in log.fields)
    motor = _columns(log, "motor", count, kept)
    if motor is None:
        return None
    low = header_number(log.header, "motorOutput", 1000, where)
    least, span = (MIN_DSHOT, DSHOT_RANGE) if low < MIN_PULSE_US else (MIN_PULSE_US, PULSE_RANGE_US)
    motor = np.clip((motor - least) / span, 0.0, 1.0)
    good = checker.good(SensorChannel("motors", motor, 0.0, 1.0, "", noisy=False))
    electrical = _speeds(log, kept)
    if electrical is None:
        return rotor_stream(good, np.full_like(motor, np.nan), motor)
    pairs = header_number(log.header, "motor_poles", DEFAULT_POLES, where) / 2.0
    if pairs <= 0:
        raise UsageError(f"{where}: the header's 'motor_poles' is not positive; it is damaged")
    speed = electrical * ERPM_STEP / pairs * 2.0 * np.pi / 60.0
    good &= checker.good(SensorChannel("rotor speeds", speed, 0.0, 2e4, "rad/s", noisy=False))
    return rotor_stream(good, speed, motor)


def _speeds(log: blackbox_log.Log, kept: slice) -> np.ndarray | None:
    """Return the electrical speeds of the motors (n, r), None without telemetry: the fields are then absent or 0."""
    speeds = _columns(log, "eRPM", sum(name.startswith("eRPM[") for name in log.fields), kept)
    return speeds if speeds is not None and speeds.any() else None


def _battery(log: blackbox_log.Log, kept: slice, checker: ChannelChecker) -> Stream | None:
    if "vbatLatest" not in log.fields:
        return None
    voltage = 0.01 * log.fields["vbatLatest"][kept]
    good = checker.good(SensorChannel("battery", voltage, 2.0, 70.0, "V", noisy=False))
    current = log.fields.get("amperageLatest")
    if current is None or not current.any():  # always zero: there is no current meter
        return battery_stream(good, voltage)
    return battery_stream(good, voltage, 0.01 * current[kept])


def _setpoint(log: blackbox_log.Log, kept: slice) -> Stream | None:
    setpoint = _columns(log, "setpoint", 3, kept)
    if setpoint is None:
        return None
    omega_body = np.deg2rad(setpoint / _resolution(log))

    def message(i: int, stamp_ns: int):
        return to_command(BodyRateThrust(stamp_ns, float("nan"), omega_body[i]))

    return Stream("command/body_rate_thrust", np.ones(len(omega_body), bool), message)


def _feedforward(log: blackbox_log.Log, kept: slice) -> Stream | None:
    feedforward = _columns(log, "axisF", 3, kept)
    if feedforward is None:
        return None
    shares = feedforward / PID_UNITS
    return Stream(
        "betaflight/feedforward",
        np.ones(len(shares), bool),
        lambda i, stamp_ns: to_stamped_vector(stamp_ns, shares[i]),
    )


def _columns(log: blackbox_log.Log, name: str, count: int, kept: slice) -> np.ndarray | None:
    """Return the fields name[0] .. of the kept frames (n, count), None unless all were logged."""
    names = [f"{name}[{i}]" for i in range(count)]
    if not names or any(field not in log.fields for field in names):
        return None
    return np.stack([log.fields[field][kept] for field in names], axis=-1).astype(float)


def _resolution(log: blackbox_log.Log) -> float:
    """Return the steps per degree per second of the gyro and setpoint."""
    return 10.0 if log.header.get("blackbox_high_resolution") == "1" else 1.0
