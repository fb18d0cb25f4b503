"""Betaflight's blackbox: the flight controller's own log, `.bbl` or `.bfl`, from version 4.0 on.

Its axes are the airframe's, forward, left and up. It knows neither place nor attitude: those come from a bag recorded
at the same time, on whose clock `alignment` puts the log.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swift_ros import messages
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import full_name
from swift_ros.importers import blackbox_log
from swift_ros.importers.alignment import align
from swift_ros.importers.flight import Checked, ForeignFlight, Stream, battery_stream, imu_stream, rotor_stream
from swift_ros.recording import bags
from swift_ros.recording.checks import Rejection, SensorChannel
from swift_ros.types import BodyRateThrust

SUFFIXES = (".bbl", ".bfl")
GRAVITY = 9.80665
OLDEST = (4, 0)
HIGHEST_HZ = 2000.0  # of what a flight table holds
DSHOT_LEAST, DSHOT_RANGE, PULSE_LEAST_US, PULSE_RANGE_US = 48.0, 1999.0, 1000.0, 1000.0
ERPM_STEP, DEFAULT_POLES = 100.0, 14
PID_UNITS = 1000.0  # of the motors' range (mixer.c, PID_MIXER_SCALING)
NO_RPM = "speeds were not logged (bidirectional DSHOT was off)"

NOTES = {
    "frames": "base_link = the flight controller's axes, forward-left-up; the log knows neither place nor attitude",
    "command/body_rate_thrust": "the rate loop's setpoint; thrust is not known",
    "betaflight/feedforward": "the rate loop's F; gyro, setpoint, F and motors of a row are of one pass, the gyro as "
    "the loop filtered it",
    "betaflight/rotors": "motor = the mixer's output, Betaflight's order (rear right, front right, rear left, front "
    "left on a standard frame)",
}


class Source(NamedTuple):
    """One log of a file: which, of how many."""

    path: Path
    number: int
    count: int

    def __str__(self) -> str:
        return str(self.path) + (f", log {self.number} of {self.count}" if self.count > 1 else "")


def find(path: Path) -> list[Source]:
    """Return the logs at a file or in a folder."""
    there = [path] if path.is_file() else sorted(path.rglob("*"))
    files = [file for file in there if file.suffix.lower() in SUFFIXES]
    found = []
    for file in files:
        count = len(blackbox_log.split(file.read_bytes()))
        found += [Source(file, i + 1, count) for i in range(max(count, 1))]
    return found


def read(source: Source, bag: Path | None = None) -> ForeignFlight:
    """Return one log, on its own clock, or on that of a bag of the same flight, whose other topics then go along.

    Raises UsageError when it cannot be read, or is of another flight than the bag.
    """
    logs = blackbox_log.split(source.path.read_bytes())
    if not logs:
        raise UsageError(f"{source} is no blackbox log: it does not begin with '{blackbox_log.BEGIN.decode()}'")
    log = blackbox_log.decode(logs[source.number - 1], str(source))
    _check_firmware(log, source)
    if len(log.time_us) < 2:
        raise UsageError(f"{source} holds no flight: {len(log.time_us)} frames can be read")
    kept = _rows(log)
    t = log.time_us[kept] * 1e-6
    checked = Checked(t, _unread(log, t))
    streams = (
        _imu(log, kept, checked),
        _rotors(log, kept, checked),
        _battery(log, kept, checked),
        _setpoint(log, kept),
        _feedforward(log, kept),
    )
    missing = "" if _speeds(log, kept) is not None else f"; {NO_RPM}"
    notes = NOTES | {
        "source": f"blackbox of {log.header['Firmware revision']}",
        "betaflight/rotors": NOTES["betaflight/rotors"] + missing,
    }
    name = source.path.stem + (f"-{source.number}" if source.count > 1 else "")
    flight = ForeignFlight(name, t, tuple(stream for stream in streams if stream), notes, tuple(checked.rejections))
    return flight if bag is None else _beside(flight, log, kept, bag, source)


def _beside(flight: ForeignFlight, log: blackbox_log.Log, kept: slice, bag: Path, source: Source) -> ForeignFlight:
    """Return the flight on the clock of a bag. Where both tell a command, the bag's is the pilot's own."""
    gyro = _columns(log, "gyroADC", 3, kept)
    if gyro is None:
        raise UsageError(f"{source} has no gyro, by which it could be aligned; log it (blackbox_disable_gyro = OFF)")
    topic, commands = full_name("imu/data_raw"), full_name("command/body_rate_thrust")
    bags.require(bag, topic)
    heard = [(message.header.stamp, message.angular_velocity) for _, message, _ in bags.read(bag, [topic])]
    t_bag = np.array([messages.stamp_ns(stamp) for stamp, _ in heard]) * 1e-9
    gyro_bag = np.array([messages.from_xyz(rate) for _, rate in heard])
    found = align(flight.t, np.deg2rad(gyro / _resolution(log)), t_bag, gyro_bag)
    t, begin_s = found.at(flight.t), next(bags.read_raw(bag)).log_time_ns * 1e-9
    told = commands in bags.topic_types(bag)
    streams = tuple(stream for stream in flight.streams if not (told and full_name(stream.topic) == commands))
    rejections = tuple(rejection.since(min(begin_s, t[0]) - t[0]) for rejection in flight.rejections)
    notes = {**bags.custom_data(bag), **flight.notes, "aligned": f"to {bag.name}: {found}"}
    return replace(flight, t=t, streams=streams, notes=notes, rejections=rejections, beside=bag)


def _check_firmware(log: blackbox_log.Log, source: Source) -> None:
    revision = log.header.get("Firmware revision", "an unnamed firmware")
    found = re.match(r"Betaflight (\d+)\.(\d+)", revision)
    if not found or tuple(map(int, found.groups())) < OLDEST:
        raise UsageError(f"{source} was written by {revision}; Betaflight 4.0 and later can be read")


def _rows(log: blackbox_log.Log) -> slice:
    """Return which frames to keep: no more a second than a flight table holds."""
    return slice(None, None, max(1, int(np.ceil(1e6 / (HIGHEST_HZ * np.median(np.diff(log.time_us))) - 0.02))))


def _unread(log: blackbox_log.Log, t) -> list[Rejection]:
    found = [Rejection(begin * 1e-6, end * 1e-6, "blackbox", "frames cannot be read") for begin, end in log.gaps]
    if not log.ended:
        found.append(Rejection(t[-1], t[-1], "blackbox", "the log was torn off here: its end was never written"))
    return found


def _imu(log: blackbox_log.Log, kept: slice, checked: Checked) -> Stream | None:
    gyro = _columns(log, "gyroADC", 3, kept)
    if gyro is None:
        return None
    gyro = np.deg2rad(gyro / _resolution(log))
    good = checked.good(SensorChannel("gyro", gyro, -35.0, 35.0, "rad/s"))
    force = _columns(log, "accSmooth", 3, kept)
    if force is None or not log.header.get("acc_1G", "").isdigit():
        return imu_stream(good, gyro, np.full_like(gyro, np.nan))
    force = GRAVITY * force / int(log.header["acc_1G"])
    good &= checked.good(SensorChannel("accelerometer", force, -320.0, 320.0, "m/s^2"))
    return imu_stream(good, gyro, force)


def _rotors(log: blackbox_log.Log, kept: slice, checked: Checked) -> Stream | None:
    count = sum(name.startswith("motor[") for name in log.fields)
    motor = _columns(log, "motor", count, kept)
    if motor is None:
        return None
    low = float(log.header.get("motorOutput", "1000").split(",")[0])
    least, span = (DSHOT_LEAST, DSHOT_RANGE) if low < PULSE_LEAST_US else (PULSE_LEAST_US, PULSE_RANGE_US)
    motor = np.clip((motor - least) / span, 0.0, 1.0)
    good = checked.good(SensorChannel("motors", motor, 0.0, 1.0, "", noisy=False))
    electrical = _speeds(log, kept)
    if electrical is None:
        return rotor_stream(good, np.full_like(motor, np.nan), motor)
    pairs = int(log.header.get("motor_poles", DEFAULT_POLES)) / 2.0
    speed = electrical * ERPM_STEP / pairs * 2.0 * np.pi / 60.0
    good &= checked.good(SensorChannel("rotor speeds", speed, 0.0, 2e4, "rad/s", noisy=False))
    return rotor_stream(good, speed, motor)


def _speeds(log: blackbox_log.Log, kept: slice) -> np.ndarray | None:
    """Return the electrical speeds of the motors (n, r), None where they do not tell them: then the fields lack, or are
    zero."""
    speeds = _columns(log, "eRPM", sum(name.startswith("eRPM[") for name in log.fields), kept)
    return speeds if speeds is not None and speeds.any() else None


def _battery(log: blackbox_log.Log, kept: slice, checked: Checked) -> Stream | None:
    if "vbatLatest" not in log.fields:
        return None
    voltage = 0.01 * log.fields["vbatLatest"][kept]
    good = checked.good(SensorChannel("battery", voltage, 2.0, 70.0, "V", noisy=False))
    current = log.fields.get("amperageLatest")
    if current is None or not current.any():  # zero all the time: there is no meter
        return battery_stream(good, voltage)
    return battery_stream(good, voltage, 0.01 * current[kept])


def _setpoint(log: blackbox_log.Log, kept: slice) -> Stream | None:
    setpoint = _columns(log, "setpoint", 3, kept)
    if setpoint is None:
        return None
    omega_body = np.deg2rad(setpoint / _resolution(log))

    def message(i: int, stamp_ns: int):
        return messages.to_command(BodyRateThrust(stamp_ns, float("nan"), omega_body[i]))

    return Stream("command/body_rate_thrust", np.ones(len(omega_body), bool), message)


def _feedforward(log: blackbox_log.Log, kept: slice) -> Stream | None:
    feedforward = _columns(log, "axisF", 3, kept)
    if feedforward is None:
        return None
    shares = feedforward / PID_UNITS
    return Stream(
        "betaflight/feedforward",
        np.ones(len(shares), bool),
        lambda i, stamp_ns: messages.to_stamped_vector(stamp_ns, shares[i]),
    )


def _columns(log: blackbox_log.Log, name: str, count: int, kept: slice) -> np.ndarray | None:
    """Return the fields name[0] .. of the frames to keep (n, count), None unless all were logged."""
    names = [f"{name}[{i}]" for i in range(count)]
    if not names or any(one not in log.fields for one in names):
        return None
    return np.stack([log.fields[one][kept] for one in names], axis=-1).astype(float)


def _resolution(log: blackbox_log.Log) -> float:
    """Return how many steps a deg/s has."""
    return 10.0 if log.header.get("blackbox_high_resolution") == "1" else 1.0
