"""A mapping: which columns of a log are a channel of the flight table, in which unit and frame; and its YAML file."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from swift_ros.configuration import load, refuse_outside
from swift_ros.errors import UsageError
from swift_ros.recording.log_mapping.quantities import BODIES, QUANTITIES, RANGES, TIME, WORLDS
from swift_ros.text import excerpt

MAX_ROTORS = 12
HEADER = """\
# Mapping of a log to the channels of a flight table (docs/flight-logs.md). For each channel:
#   topic:   topic of the log; a table has none
#   columns: its columns; `-name` is the negative, `TOPIC:name` a column of another topic. A quaternion is x, y, z, w
#            and rotates body vectors into the world; three columns are roll, pitch and yaw
#   unit:    such as deg/s, g, mm, rpm, us; without it SI
#   world:   ENU (any world with z up), NED or y-up
#   body:    FLU, FRD or RFU; a velocity with this key is in the body frame
#   range:   motor commands that mean 0 and 1
#   scale:   factor behind the unit
"""


@dataclass(frozen=True)
class ChannelSource:
    """Where a channel is in a log.

    Attributes:
        columns: names of the columns; see `HEADER`.
        topic: of the columns that name none.
        unit: "" for SI, or for the unit of a range.
        world: frame of the world's axes, "" for ENU.
        body: frame of the body's axes, "" for FLU; of a velocity "" when it is not in the body frame.
        range: motor commands that mean 0 and 1.
        scale: factor.
    """

    columns: tuple[str, ...]
    topic: str = ""
    unit: str = ""
    world: str = ""
    body: str = ""
    range: tuple[float, float] | None = None
    scale: float = 1.0

    def __post_init__(self):
        if not self.columns:
            raise ValueError("'columns' is empty")
        refuse_outside(("", *WORLDS), world=self.world)
        refuse_outside(("", *BODIES), body=self.body)
        if self.range and self.range[0] == self.range[1]:
            raise ValueError("'range' must have two different values")
        if not self.scale:
            raise ValueError("'scale' must not be 0")

    @property
    def places(self) -> list[tuple[str, str, float]]:
        """Topic, column and sign of each column."""
        found = []
        for text in self.columns:
            sign, name = (-1.0, text[1:]) if text.startswith("-") else (1.0, text)
            topic, separator, column = name.rpartition(":")
            found.append((topic, column, sign) if separator else (self.topic, name, sign))
        return found


@dataclass(frozen=True)
class TimeSource:
    """Column of the times of a table, and its unit."""

    column: str
    unit: str = "s"

    def __post_init__(self):
        refuse_outside(tuple(TIME), unit=self.unit)


@dataclass(frozen=True)
class Mapping:
    """The mapping of a log.

    Attributes:
        channels: by name.
        time: of a table; other logs have their own times.
        notes: what the user should know about it, a sentence each.
    """

    channels: dict[str, ChannelSource]
    time: TimeSource | None = None
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self):
        refuse_outside(tuple(QUANTITIES), **{f"channels, {excerpt(name)}": name for name in self.channels})
        for name, source in self.channels.items():
            _check(name, source)

    def with_channel(self, name: str, **changes) -> "Mapping":
        """Return the mapping with changed keys of a channel."""
        return replace(self, channels=self.channels | {name: replace(self.channels[name], **changes)})


def _check(name: str, source: ChannelSource) -> None:
    """Raise ValueError for keys that the channel does not have."""
    quantity, count = QUANTITIES[name], len(source.columns)
    if quantity.sizes and count not in quantity.sizes:
        raise ValueError(f"{name} needs {' or '.join(map(str, quantity.sizes))} columns, not {count}")
    if not quantity.sizes and count > MAX_ROTORS:
        raise ValueError(f"{name} has {count} columns; at most {MAX_ROTORS} rotors are supported")
    units = (*quantity.units, *(RANGES if name == "motor_command" else ()))
    if source.unit:
        refuse_outside(units, **{f"{name}, unit": source.unit})
    for key, allowed in (("world", quantity.world), ("body", quantity.body), ("range", name == "motor_command")):
        if getattr(source, key) and not allowed:
            raise ValueError(f"{name} has no '{key}'")
    if name == "v_world" and source.body and source.world:
        raise ValueError("v_world has either 'world' or 'body'")


def read(path: Path) -> Mapping:
    """Return the mapping in a file. Raises UsageError with the key of an error."""
    return load(Mapping, path)


def write(mapping: Mapping, path: Path, comments: Sequence[str] = ()) -> None:
    """Write a mapping as a YAML file with comments. Raises UsageError when it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text(mapping, comments), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror or error}") from error


def text(mapping: Mapping, comments: Sequence[str] = ()) -> str:
    """Return a mapping as YAML text; the comments stand at its end."""
    lines = [HEADER.rstrip("\n")]
    if mapping.time:
        lines.append(f"time: {{column: {_quoted(mapping.time.column)}, unit: {mapping.time.unit}}}")
    lines.append("channels:")
    for name, source in mapping.channels.items():
        lines.append(f"  {name}:")
        lines += [f"    {line}" for line in _lines(source)]
    if mapping.notes:
        lines += ["notes:", *(f"  - {_quoted(note)}" for note in mapping.notes)]
    lines += [f"# {comment}" for comment in comments]
    return "\n".join(lines) + "\n"


def described(name: str, source: ChannelSource) -> str:
    """Return a channel's source in a line."""
    is_quaternion = 4 in QUANTITIES[name].sizes and len(source.columns) == 4
    details = [] if is_quaternion else [source.unit or next(iter(QUANTITIES[name].units))]
    details += [frame for frame in (source.world, source.body) if frame]
    details += [f"{source.range[0]:g} to {source.range[1]:g}"] if source.range else []
    details += [f"times {source.scale:g}"] if source.scale != 1.0 else []
    where = f"{source.topic}: " if source.topic else ""
    columns = [excerpt(column) for column in source.columns]
    return f"{name} = {where}{', '.join(columns)}" + (f" ({', '.join(details)})" if details else "")


def _lines(source: ChannelSource) -> list[str]:
    lines = [f"topic: {_quoted(source.topic)}"] if source.topic else []
    lines.append(f"columns: [{', '.join(_quoted(column) for column in source.columns)}]")
    lines += [f"{key}: {value}" for key in ("unit", "world", "body") if (value := getattr(source, key))]
    lines = [line.replace("unit: %", 'unit: "%"').replace("unit: 1", 'unit: "1"') for line in lines]
    lines += [f"range: [{source.range[0]!r}, {source.range[1]!r}]"] if source.range else []
    return lines + ([f"scale: {source.scale!r}"] if source.scale != 1.0 else [])


def _quoted(text: str) -> str:
    """Return a text in YAML's double quotes."""
    letters = {'"': '\\"', "\\": "\\\\"}
    return '"' + "".join(letters.get(c, c if c.isprintable() else f"\\U{ord(c):08X}") for c in text) + '"'
