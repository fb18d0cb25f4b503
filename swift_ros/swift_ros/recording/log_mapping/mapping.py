"""A mapping: which columns of a log are a channel of the flight table, in which unit and frame."""

from dataclasses import dataclass, field, replace

from swift_ros.configuration import refuse_outside
from swift_ros.recording.log_mapping.quantities import BODIES, QUANTITIES, RANGES, TIME, WORLDS
from swift_ros.text import excerpt

MAX_ROTORS = 12
BETWEEN = ("held", "mean", "line")  # what a channel did between two rows


@dataclass(frozen=True)
class ChannelSource:
    """Where a channel is in a log.

    Attributes:
        columns: names of the columns; see `mapping_file.HEADER`.
        topic: of the columns that name none.
        unit: "" for SI, or for the unit of a range.
        world: frame of the world's axes, "" for ENU.
        body: frame of the body's axes, "" for FLU; of a velocity "" when it is not in the body frame.
        range: motor commands that mean 0 and 1.
        scale: factor.
        between: `held`, `mean` or `line`, see `flight_table.RowSampling`; "" where it is not known.
        late: age of a row's value at its time, s.
        loop_hz: of motor commands, rate of the flight controller's loop; 0 where the vehicle file gives it.
    """

    columns: tuple[str, ...]
    topic: str = ""
    unit: str = ""
    world: str = ""
    body: str = ""
    range: tuple[float, float] | None = None
    scale: float = 1.0
    between: str = ""
    late: float = 0.0
    loop_hz: float = 0.0

    def __post_init__(self):
        if not self.columns:
            raise ValueError("'columns' is empty")
        refuse_outside(("", *BETWEEN), between=self.between)
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
    for key, allowed in (
        ("world", quantity.world),
        ("body", quantity.body),
        ("range", name == "motor_command"),
        ("loop_hz", name == "motor_command"),
    ):
        if getattr(source, key) and not allowed:
            raise ValueError(f"{name} has no '{key}'")
    if name == "v_world" and source.body and source.world:
        raise ValueError("v_world has either 'world' or 'body'")
