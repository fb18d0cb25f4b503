"""The YAML file of a mapping, and its lines for the terminal."""

from collections.abc import Sequence
from pathlib import Path

from swift_ros.configuration import load
from swift_ros.errors import UsageError
from swift_ros.recording.log_mapping.mapping import ChannelSource, Mapping
from swift_ros.recording.log_mapping.quantities import QUANTITIES
from swift_ros.text import excerpt

MAX_NOTE = 500  # characters
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
#   between: what the channel did between two rows: held, mean or line
#   late:    age of a row's value at its time, s
#   loop_hz: of motor commands, rate of the flight controller's loop
"""


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
    written = [HEADER.rstrip("\n")]
    if mapping.time:
        written.append(f"time: {{column: {_quoted(mapping.time.column)}, unit: {mapping.time.unit}}}")
    written.append("channels:")
    for name, source in mapping.channels.items():
        written.append(f"  {name}:")
        written += [f"    {line}" for line in _lines(source)]
    if mapping.notes:
        written += ["notes:", *(f"  - {_quoted(note)}" for note in mapping.notes)]
    written += [f"# {comment}" for comment in comments]
    return "\n".join(written) + "\n"


def described(name: str, source: ChannelSource) -> str:
    """Return a channel's source in a line."""
    is_quaternion = 4 in QUANTITIES[name].sizes and len(source.columns) == 4
    details = [] if is_quaternion else [source.unit or next(iter(QUANTITIES[name].units))]
    details += [frame for frame in (source.world, source.body) if frame]
    details += [f"{source.range[0]:g} to {source.range[1]:g}"] if source.range else []
    details += [f"times {source.scale:g}"] if source.scale != 1.0 else []
    details += [source.between] if source.between else []
    details += [f"{source.late:g} s late"] if source.late else []
    details += [f"loop at {source.loop_hz:g} Hz"] if source.loop_hz else []
    where = f"{source.topic}: " if source.topic else ""
    columns = [excerpt(column) for column in source.columns]
    return f"{name} = {where}{', '.join(columns)}" + (f" ({', '.join(details)})" if details else "")


def lines(mapping: Mapping) -> list[str]:
    """Return what a mapping says, for the terminal."""
    time = [f"time = {excerpt(mapping.time.column)} ({mapping.time.unit})"] if mapping.time else []
    notes = ["".join(c if c.isprintable() else "?" for c in note[:MAX_NOTE]) for note in mapping.notes]
    return [*time, *(described(*item) for item in mapping.channels.items()), *(f"note: {note}" for note in notes)]


def _lines(source: ChannelSource) -> list[str]:
    lines = [f"topic: {_quoted(source.topic)}"] if source.topic else []
    lines.append(f"columns: [{', '.join(_quoted(column) for column in source.columns)}]")
    lines += [f"{key}: {value}" for key in ("unit", "world", "body") if (value := getattr(source, key))]
    lines = [line.replace("unit: %", 'unit: "%"').replace("unit: 1", 'unit: "1"') for line in lines]
    lines += [f"range: [{source.range[0]!r}, {source.range[1]!r}]"] if source.range else []
    lines += [f"scale: {source.scale!r}"] if source.scale != 1.0 else []
    return lines + [f"{key}: {value}" for key in ("between", "late", "loop_hz") if (value := getattr(source, key))]


def _quoted(text: str) -> str:
    """Return a text in YAML's double quotes."""
    letters = {'"': '\\"', "\\": "\\\\"}
    return '"' + "".join(letters.get(c, c if c.isprintable() else f"\\U{ord(c):08X}") for c in text) + '"'
