"""Motor commands in rows that are slower than the flight controller's loop.

What the commands did between two rows is not in the table: a row may hold the command that was set at its time, the
mean since the row before, or a command that is a part of a row older. To the motors, which are slow, all of these are
one smooth signal through the rows, moved in time and a little sharper or blunter:

    u(t) = s(t - shift) + bend s''(t - shift),   s the spline through the rows

Where rows are slower than the commanded rates too, each row shows the motor command just after a new commanded rate, or
always the same time later: the part of u that follows the commanded rates has a shift of its own.

Shifts and bend belong to the recording, not to the vehicle. They are declared (`FlightTable.sampling`) or estimated
(`inference.row_sampling`), and no effect below their uncertainty is identified.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from swift_ros.recording.flight_table import FlightTable, RowSampling, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.identification import grid

RATE_TOLERANCE = 0.02  # relative difference between the rate of the rows and the rate of the loop
MAX_STEP_S = 0.0025  # of the motors' replay between two rows; the shift resolves a small part of it
BEND_S = 0.01  # distance of the three points of the second derivative; shorter ones amplify noise
SENT = ("omega_command_body", "thrust_command", "gyro_body")
SENT_SHARE = 0.5  # of a row: standard deviation of the shift of what follows the commanded rates
MIN_REPEATS = 0.1  # share of rows that repeat the command before, from which on every command has a row
SLOWER = 0.9  # of the rate of the rows: commands at a lower rate have stamps of their own
MOMENT = 1.0 / 24.0  # of the squared width of a mean: its second-order error


@dataclass(frozen=True)
class CommandRows:
    """Commands in rows, and how they act between them.

    Attributes:
        samples: the rows, values (n, r) from 0 to 1.
        shift_s: time by which the commands act later than the rows say.
        bend_s2: weight of the second derivative.
        sent_shift_s: time by which the part `sent` acts later than that.
        sigma: standard deviations of these three before the recording is seen; zero where they are known.
        noise: noise of the residuals that depend on the commands, (k,) or one for all, with which these are compared.
        sent: (n, r) the part of the values that follows the commanded rates and thrust; None where each of these has a
            row of its own.
    """

    samples: Samples
    shift_s: float = 0.0
    bend_s2: float = 0.0
    sent_shift_s: float = 0.0
    sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: np.ndarray | float = 1.0
    sent: np.ndarray | None = None

    @property
    def interval_s(self) -> float:
        """The time between two rows."""
        return 1.0 / self.samples.rate_hz

    @property
    def nuisances(self) -> np.ndarray:
        """The parameters (3,) that belong to the recording."""
        return np.array([self.shift_s, self.bend_s2, self.sent_shift_s])

    @cached_property
    def _splines(self):
        """The smooth signals through the rows and through their part `sent`."""
        return [
            CubicSpline(self.samples.t, values) for values in (self.samples.values, self.sent) if values is not None
        ]

    def at(self, t) -> np.ndarray:
        """Return the commands (n, r) that act at times t (n,) s."""
        rows, before = self.samples, t - self.shift_s

        def smooth(times, which: int = 0):
            return self._splines[which](np.clip(times, rows.t[0], rows.t[-1]))

        found = smooth(before)
        if self.bend_s2:
            bend = (smooth(before + BEND_S) - 2.0 * found + smooth(before - BEND_S)) / BEND_S**2
            found = found + self.bend_s2 * bend
        if self.sent is not None and self.sent_shift_s:
            found = found + smooth(before - self.sent_shift_s, 1) - smooth(before, 1)
        return np.clip(found, 0.0, 1.0)

    def moved(self, shift_s: float, bend_s2: float = 0.0, sent_shift_s: float = 0.0) -> "CommandRows":
        """Return the rows with their commands later by shift_s, with more bend, and the part `sent` later still."""
        shift_s, bend_s2, sent_shift_s = self.nuisances + [shift_s, bend_s2, sent_shift_s]
        return replace(self, shift_s=shift_s, bend_s2=bend_s2, sent_shift_s=sent_shift_s)


def loop_interval_s(vehicle: Vehicle) -> float | None:
    """Return the period of the rate loop in the vehicle file, None where it has none."""
    rate_hz = vehicle.controller.get("rate_hz") or vehicle.controller.get("loop_hz")
    return 1.0 / float(rate_hz) if rate_hz else None


def command_rows_of(samples: Samples, sampling: RowSampling | None, loop_s: float | None) -> CommandRows | None:
    """Return motor commands as rows of a faster loop; None where each was held until the next row.

    Args:
        samples: the motor commands.
        sampling: how they were recorded, None where it was not declared.
        loop_s: period of the loop where it is not declared, s; None where it is not known.
    """
    row_s = 1.0 / samples.rate_hz
    loop_s = 1.0 / sampling.loop_hz if sampling and sampling.loop_hz else loop_s
    if loop_s and row_s < (1.0 + RATE_TOLERANCE) * loop_s:
        return None
    if sampling and sampling.between == "held" and not loop_s:
        return None
    if sampling and sampling.between:
        step_s = loop_s or 0.0
        shift_s, bend_s2 = {
            "held": (0.5 * step_s, MOMENT * step_s**2),
            "mean": (step_s - 0.5 * row_s, -MOMENT * row_s**2),
            "line": (0.0, 0.0),
        }[sampling.between]
        known = (0.5 * step_s, MOMENT * step_s**2, 0.0)
        return CommandRows(samples, shift_s - sampling.late_s, bend_s2, sigma=known)
    middle_s = 0.5 * (loop_s or row_s)
    return CommandRows(samples, middle_s, sigma=(row_s, MOMENT * row_s**2, 0.0))


def with_sent_part(rows: CommandRows, table: FlightTable) -> CommandRows:
    """Return rows with the part that follows the commanded rates and thrust, if commands were sent between the rows."""
    if not all(name in table for name in SENT) or rows.sent is not None or not rows.sigma[0]:
        return rows
    t, values = rows.samples.t, rows.samples.values
    rates, thrust, gyro = (table[name] for name in SENT)
    if all(every_command_has_a_row(one, rows.interval_s) for one in (rates, thrust)):
        return rows
    commands = np.column_stack([grid.at(rates, t), grid.at(thrust, t)])
    regressors = np.column_stack([commands, grid.at(gyro, t), np.ones(len(t))])
    gains = np.linalg.lstsq(regressors, values, rcond=None)[0]
    sigma = (*rows.sigma[:2], SENT_SHARE * rows.interval_s)
    return replace(rows, sent=commands @ gains[: commands.shape[1]], sigma=sigma)


def every_command_has_a_row(sent: Samples, row_s: float) -> bool:
    """Return whether no command was sent between two rows: some rows repeat the last one, or commands have a clock."""
    return bool(repeats(sent).mean() > MIN_REPEATS or sent.rate_hz < SLOWER / row_s)


def repeats(sent: Samples) -> np.ndarray:
    """Return which rows (n,) repeat the one before."""
    values = sent.values.reshape(len(sent.t), -1)
    return np.append(False, np.all(values[1:] == values[:-1], axis=1))


def undeclared_rows_s(table: FlightTable, vehicle: Vehicle) -> dict[str, float]:
    """Return by channel the time (s) between two rows, where these are slower than the loop and nothing is declared."""
    commands, found = table.sampling.get("motor_command"), {}
    loop_s = 1.0 / commands.loop_hz if commands and commands.loop_hz else loop_interval_s(vehicle)
    for name, samples in table.channels.items():
        row_s, declared = 1.0 / samples.rate_hz, table.sampling.get(name)
        every_pass = loop_s and row_s < (1.0 + RATE_TOLERANCE) * loop_s
        if not every_pass and not (declared and declared.between):
            found[name] = row_s
    return found


def of_held(samples: Samples) -> CommandRows:
    """Return commands of which each was held until the next row, as rows: their smooth signal is half a row late."""
    row_s = 1.0 / samples.rate_hz
    return CommandRows(samples, 0.5 * row_s, MOMENT * row_s**2)
