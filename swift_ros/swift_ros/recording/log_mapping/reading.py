"""Reads a log of another program: its topics, the mapping, the channels, and what the physical checks say."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.log_formats import dataflash, tables, ulog
from swift_ros.recording.log_formats.log import TABLES, ULOG, Log
from swift_ros.recording.log_mapping import (
    contradictions,
    conversion,
    guess,
    guess_columns,
    mapping_file,
    mistakes,
    motor_order,
)
from swift_ros.recording.log_mapping.conversion import Signal
from swift_ros.recording.log_mapping.mapping import Mapping
from swift_ros.recording.log_mapping.motor_order import MotorOrder
from swift_ros.recording.log_mapping.quantities import lowest_rate_hz
from swift_ros.text import excerpt

MAX_LISTED = 200  # columns that the file of a mapping lists


@dataclass(frozen=True)
class ReadLog:
    """What was read of a log.

    Attributes:
        signals: channels of a flight table, by name.
        mapping: by which they were read.
        checks: results of the physical checks.
        order: of the motors, None where it is not observable.
        slow: rates of channels that are too slow for a flight table and were left out, Hz.
        cure: what to do about slow channels.
        format: name of the log's format.
    """

    signals: dict[str, Signal]
    mapping: Mapping
    checks: list[contradictions.Check]
    order: MotorOrder | None
    slow: dict[str, float]
    cure: str
    format: str

    @property
    def notes(self) -> tuple[str, ...]:
        """How the log was read, a line each."""
        lines = [f"{self.format}, read as", *(f"  {line}" for line in mapping_file.lines(self.mapping))]
        if motors(self.signals):
            seen = f"by the gyro, motors are {self.order}" if self.order else "the gyro does not show the motors' order"
            lines.append(f"note: {seen}")
        marks = {True: "holds", False: "DOES NOT HOLD", None: "not checked"}
        lines += [f"check: {check} ({marks[check.holds]})" for check in self.checks]
        return tuple([*lines, self.left_out] if self.slow else lines)

    @property
    def left_out(self) -> str:
        """The channels that are too slow, and what to do; "" without one."""
        if not self.slow:
            return ""
        named = ", ".join(f"{name} ({rate_hz:.3g})" for name, rate_hz in self.slow.items())
        cure = f"; {self.cure}" if self.cure else ""
        return f"left out, because of fewer than 50 rows a second: {named}{cure}"

    @property
    def motor_columns(self) -> tuple[str, ...]:
        """The columns of the motors whose order was found."""
        return self.mapping.channels[name].columns if (name := motors(self.signals)) else ()


def read(log: Log, mapping: Mapping) -> ReadLog:
    """Return the channels of a log. Raises UsageError for a contradiction, or a column that the log lacks."""
    signals = conversion.signals(log, mapping)
    results = contradictions.checks(log, mapping, signals)
    rates = {name: _rate_hz(signal) for name, signal in signals.items()}
    slow = {name: rate for name, rate in rates.items() if rate < lowest_rate_hz(name, rates)}
    order = _order(signals)
    kept = {name: one for name, one in signals.items() if name not in slow}
    return ReadLog(kept, mapping, results, order, slow, guess.LOGGED_RATES.get(log.format, ""), log.format)


def open_log(path: Path, mapping: Mapping | None) -> tuple[Log, Mapping]:
    """Return a ULog, DataFlash log or table of any columns, and its mapping: the given one, or a guess.

    Raises:
        UsageError: the log cannot be read, or nothing is known about it without a mapping.
    """
    suffix = path.suffix.lower()
    if suffix in TABLES:
        names = tables.column_names(path)
        chosen = mapping or guess_columns.guess(path, names)
        if chosen.time is None:
            raise UsageError(f"{path} is a table; the mapping lacks the key 'time' with its column of times")
        used = {column for source in chosen.channels.values() for _, column, _ in source.places}
        if not used:
            shown = ", ".join(excerpt(name) for name in names[:12]) + (" .." if len(names) > 12 else "")
            raise UsageError(
                f"{path}: none of its columns ({shown}) is plainly a channel; write a mapping (--mapping FILE)"
            )
        return tables.read(path, chosen.time.column, sorted({chosen.time.column, *used})), chosen
    log = ulog.read(path) if suffix in ULOG else dataflash.read(path)
    return log, mapping or guess.guess(log)


def comments(log: Log) -> list[str]:
    """Return the topics and columns of a log, for the file of a mapping."""
    lines = ["", "What the log holds:"]
    for name, topic in sorted(log.topics.items()):
        columns = [excerpt(column) for column in topic.columns]
        more = f" and {len(columns) - MAX_LISTED} more" if len(columns) > MAX_LISTED else ""
        lines.append(f"{excerpt(name) or 'columns'}: {', '.join(columns[:MAX_LISTED])}{more}")
    return lines


def _rate_hz(signal: Signal) -> float:
    good = np.isfinite(np.asarray(signal.values).reshape(len(signal.t), -1)).all(axis=1) & np.isfinite(signal.t)
    steps = np.diff(signal.t[good])
    steps = steps[steps > 0]
    return float(1.0 / np.median(steps)) if len(steps) else 0.0


def _order(signals: dict[str, Signal]) -> MotorOrder | None:
    """Return the order of the motors as the gyro shows it."""
    if not (name := motors(signals)) or "gyro_body" not in signals:
        return None
    command, gyro = (mistakes.sound(signals[one]) for one in (name, "gyro_body"))
    return motor_order.estimate(command, gyro) if min(len(command.t), len(gyro.t)) > 10 else None


def motors(signals: dict[str, Signal]) -> str | None:
    """Return the channel of the motors: commands, else speeds; None without either."""
    return next((name for name in ("motor_command", "rotor_speed") if name in signals), None)
