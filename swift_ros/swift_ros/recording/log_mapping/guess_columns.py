"""The mapping of a table, where the names of its columns are plain.

A name is divided into words, and a last letter or number, its axis. Words in brackets, or at the end, may be a unit.
"""

import re
from typing import NamedTuple

from swift_ros.errors import UsageError
from swift_ros.recording.log_mapping.mapping import MAX_ROTORS, ChannelSource, Mapping, TimeSource
from swift_ros.recording.log_mapping.quantities import QUANTITIES, RANGES, TIME
from swift_ros.text import excerpt

ORDER = "the order of the motors is that of the columns' numbers; compare it with the rotors of the vehicle file"
W_FIRST = "q0 is taken to be the quaternion's w"
TIMES = ("t", "time", "timestamp", "stamp", "times", "timestamps", "clock")
# Words of a channel: all words of a name must be among them or among the words that are ignored.
WORDS = {
    "gyro_body": ("gyro", "gyr", "gyroscope", "w", "omega", "rates", "angular velocity", "ang vel", "angvel"),
    "specific_force_body": ("acc", "accel", "accelerometer", "a", "acceleration", "linear acceleration", "acc b"),
    "v_world": ("v", "vel", "velocity", "linear velocity"),
    "p_world": ("p", "pos", "position", ""),
    "q_world_body": ("q", "quat", "quaternion", "orientation"),
    "rotor_speed": ("rotor", "rpm", "motor rpm", "motor speed", "rotor speed", "erpm", "esc rpm"),
    "motor_command": ("u", "motor", "m", "mot", "pwm", "motor command", "motor cmd", "motor pwm", "throttle"),
    "voltage": ("vbat", "voltage", "battery voltage", "volt", "bat voltage", "vbatt"),
    "current": ("ibat", "current", "battery current", "curr", "bat current", "amps"),
}
EULER = {"roll": 0, "phi": 0, "pitch": 1, "theta": 1, "yaw": 2, "psi": 2}
IGNORED = {"imu", "rs", "r", "s", "drone", "quad", "uav", "body", "world", "raw", "meas", "measured", "est", "state"}
IGNORED |= {"mocap", "vicon", "gt", "truth", "ground", "b", "euler", "angle", "data", "pose", "orientation", "odom"}
UNITS = {
    "degs": "deg/s", "dps": "deg/s", "degpers": "deg/s", "deg/s": "deg/s", "rad/s": "rad/s", "rads": "rad/s",
    "rad s^-1": "rad/s", "rad s-1": "rad/s", "m s^-1": "m/s", "m s^-2": "m/s^2", "m s-2": "m/s^2", "m/s^2": "m/s^2",
    "m/s2": "m/s^2", "g": "g", "mm": "mm", "cm": "cm", "m": "m", "m/s": "m/s", "deg": "deg", "rad": "rad", "mv": "mV",
    "v": "V", "a": "A", "ma": "mA", "rpm": "rpm", "hz": "Hz", "us": "us", "ms": "ms", "ns": "ns", "s": "s", "%": "%",
    "sec": "s", "seconds": "s", "usec": "us", "msec": "ms", "nsec": "ns", "percent": "%",
}  # fmt: skip


LETTERS = {"m", "v", "a", "s", "g"}  # units that may as well be the name of a quantity


class _Name(NamedTuple):
    """A column: its words without axis and unit, its axis, and its unit."""

    words: str
    axis: str
    unit: str


def guess(path, columns: list[str]) -> Mapping:
    """Return the mapping of a table with these columns.

    Raises:
        UsageError: there is no column of times, or a channel has two columns for an axis.
    """
    parsed = {column: _parse(column) for column in columns}
    time = _time(path, parsed)
    channels, notes = {}, []
    for channel, words in WORDS.items():
        found: dict[str, str] = {}
        for column, name in parsed.items():
            if column != time.column and _fits(name.words, words) and (key := _key(channel, name)) is not None:
                if key in found:
                    both = f"'{excerpt(found[key])}' and '{excerpt(column)}'"
                    raise UsageError(f"{path}: {channel} may be {both}; choose in a mapping (--mapping FILE)")
                found[key] = column
        if source := _source(channel, found, parsed):
            channels[channel] = source
    if "q_world_body" not in channels and (source := _euler(parsed)):
        channels["q_world_body"] = source
    if any(parsed[column].axis == "0" for column in getattr(channels.get("q_world_body"), "columns", ())):
        notes.append(W_FIRST)
    notes += [ORDER] if {"rotor_speed", "motor_command"} & set(channels) else []
    return Mapping(channels, time, tuple(notes))


def _time(path, parsed: dict[str, _Name]) -> TimeSource:
    """Return the column of times. Raises UsageError when there is none, or more than one."""
    found = [column for column, name in parsed.items() if name.words in TIMES and not name.axis]
    if len(found) != 1:
        which = f"'{excerpt(found[0])}' and '{excerpt(found[1])}'" if found else "none of its columns"
        question = f"{which} may be the time" if found else f"{which} is plainly the time"
        raise UsageError(
            f"{path}: {question}; name it in a mapping (`time: {{column: NAME, unit: s}}`, --mapping FILE)"
        )
    unit = parsed[found[0]].unit
    return TimeSource(found[0], unit if unit in TIME else "s")


def _parse(column: str) -> _Name:
    """Return the parts of a column's name."""
    text = column.strip().strip("#").strip()
    unit = ""
    if match := re.search(r"[\[(]([^\])]*)[\])]\s*$", text):
        content = match[1].strip().lower()
        if content in UNITS:
            unit, text = UNITS[content], text[: match.start()]
    text = re.sub(r"([a-z])([A-Z])", r"\1 \2", text)  # camel case
    words = [word for word in re.split(r"[^a-z0-9%]+", text.lower()) if word]
    if len(words) > 1 and not unit and words[-1] in UNITS and (words[-1] not in LETTERS or words[0] in TIMES):
        unit = UNITS[words.pop()]
    axis = ""
    if words and (match := re.fullmatch(r"(.*?)([xyzw]|\d{1,2})", words[-1])) and words[-1] not in UNITS:
        axis = match[2]
        words[-1:] = [match[1]] if match[1] else []
    return _Name(" ".join(words), axis, unit)


def _fits(words: str, wanted: tuple[str, ...]) -> bool:
    """Return whether the words of a name are those of a channel, besides words that say nothing."""
    if words in wanted:
        return True
    left = [word for word in words.split() if word not in IGNORED]
    return bool(left) and " ".join(left) in wanted


def _key(channel: str, name: _Name) -> str | None:
    """Return the axis of a column of a channel, "" for a scalar, None where the channel has no such axis."""
    sizes = QUANTITIES[channel].sizes
    if sizes == (1,):
        return "" if not name.axis else None
    if not sizes:
        return name.axis if name.axis.isdecimal() and int(name.axis) <= MAX_ROTORS else None
    letters = "xyzw0123" if 4 in sizes else "xyz"
    return name.axis if name.axis and name.axis in letters else None


def _source(channel: str, found: dict[str, str], parsed: dict[str, _Name]) -> ChannelSource | None:
    """Return the source of a channel, None where an axis is missing."""
    sizes = QUANTITIES[channel].sizes
    if sizes == (1,):
        order = [""]
    elif not sizes:
        order = sorted(found, key=int)
        if len(order) < 3 or int(order[0]) > 1 or int(order[-1]) - int(order[0]) != len(order) - 1:
            return None
    elif 4 in sizes:
        order = list("xyzw") if "w" in found else list("1230")
    else:
        order = list("xyz")
    if any(axis not in found for axis in order):
        return None
    columns = tuple(found[axis] for axis in order)
    return ChannelSource(columns, unit=_unit(channel, columns, parsed))


def _unit(channel: str, columns: tuple[str, ...], parsed: dict[str, _Name]) -> str:
    """Return the unit that the columns' names say, "" without one."""
    unit = parsed[columns[0]].unit
    if channel == "rotor_speed" and not unit and "rpm" in parsed[columns[0]].words:
        return "rpm"
    if channel == "motor_command" and "pwm" in parsed[columns[0]].words:
        return "us"
    units = (*QUANTITIES[channel].units, *(RANGES if channel == "motor_command" else ()))
    return unit if unit in units else ""


def _euler(parsed: dict[str, _Name]) -> ChannelSource | None:
    """Return the attitude as roll, pitch and yaw."""
    found: dict[int, str] = {}
    for column, name in parsed.items():
        left = [word for word in name.words.split() if word not in IGNORED]
        if len(left) == 1 and left[0] in EULER and not name.axis:
            found.setdefault(EULER[left[0]], column)
    if len(found) < 3:
        return None
    columns = tuple(found[i] for i in range(3))
    unit = parsed[columns[0]].unit
    return ChannelSource(columns, unit=unit if unit in ("deg", "rad") else "")
