"""Commands on their way to the rate loop: delay, loss, scale and offset between what was sent and what was received.

Which commands were lost or late by chance is read from the recording (`command_timing`). The rates of loss and delay
are parameters of effects.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from swift_ros.configuration import build
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.recording import rate_pid
from swift_sim_bridge.gap.recording.command_rows import (
    MIN_REPEATS,
    RATE_TOLERANCE,
    CommandRows,
    command_rows_of,
    every_command_has_a_row,
    repeats,
)
from swift_sim_bridge.gap.recording.command_timing import (
    MAX_DELAY_S,
    STAMP_TOLERANCE_S,
    CommandTiming,
    Passes,
    delayed_fit,
    estimate_command_timing,
)
from swift_sim_bridge.gap.recording.unavailable import Unavailable
from swift_sim_bridge.identification import grid
from swift_sim_bridge.identification.grid import LONG_GAP
from swift_sim_bridge.physics.terms import command_path

UNITS = {"roll": "rad/s", "pitch": "rad/s", "yaw": "rad/s", "throttle": ""}  # of a command: rates by axis, throttle
NEEDED = ("omega_command_body", "thrust_command", "motor_command", "gyro_body")
MIN_SHARED_SAMPLES = 0.9  # share of the motor commands with a gyro sample at the same time
SETTLING_S = 0.5  # time after which the loop's low-pass filters no longer depend on their unknown initial state
UNIFORM_KURTOSIS = 0.8  # fourth over squared second moment of a uniform distribution (1.8), less 1
MIN_ROWS = 100  # rows with motor commands and gyro
SCALE_MARGIN = 2.0  # times the error of a scale that a shift by a whole row makes
ROW_PARTS = 2  # of a row: steps in which a common delay is sought
AT_LIMIT = Unavailable("a motor stands at its limit, or the recording has a gap, all the time")
QUANTISATION = 0.1  # passes; standard error of a jitter that is observed in whole passes, besides that of the sample


@dataclass(frozen=True)
class CommandLink:
    """Sent and received commands of a rate loop.

    Attributes:
        passes: commands as sent, and as received at each pass.
        timing: loss and delay of each command.
        row_s: time between two rows that are slower than the loop; 0 where every pass has a row.
        late_gyro: (n, 4) change of the received commands where the gyro is half a row later against the motor commands;
            None where every pass has a row.
        is_complete: whether each command that was sent has a row; the timing is not known otherwise.
    """

    passes: Passes
    timing: CommandTiming
    row_s: float = 0.0
    late_gyro: np.ndarray | None = None
    is_complete: bool = True

    def held(self, delay_s: float, jitter_s: float = 0.0, lost=False) -> np.ndarray:
        """Return the command (n, 4) in force over each pass.

        Args:
            delay_s: common delay.
            jitter_s: standard deviation of the delay; the delays found in the recording are scaled to it.
            lost: (k,) bool, commands that never arrive.
        """
        timing = self.timing
        excess_s = jitter_s / timing.jitter_s * timing.excess_delay_s if timing.jitter_s else 0.0
        due = np.where(lost, np.inf, self.passes.first + np.maximum(delay_s + excess_s, 0.0))
        return self.passes.in_force(due)

    def residuals(self, term_sets: list[dict]) -> np.ndarray:
        """Return received commands less those that the model gives from the sent ones.

        Args:
            term_sets: `terms` of each of b vehicle files.

        Returns:
            (b, n, 4) rates rad/s and throttle, zero where the received command is not observable.
        """
        delays, found = [_delays(terms) for terms in term_sets], []
        delayed = {key: self._delayed(*key) for key in set(delays)}
        for terms, key in zip(term_sets, delays, strict=True):
            expected = distorted(delayed[key], terms)
            found.append(np.where(self.passes.observable[:, None], self.passes.received - expected, 0.0))
        return np.stack(found)

    def timing_change(self) -> np.ndarray:
        """Return the change (5, n, 4) of the residuals where one of the commands, last the gyro, is half a row later.

        The gyro lags behind the commands. Late against the motor commands, it makes received rates larger or smaller.
        """
        later = self._delayed(0.5 * self.row_s, 0.0, 0.0) - self._delayed(0.0, 0.0, 0.0)
        change = np.concatenate([-np.eye(4)[:, None] * later, self.late_gyro[None]])
        return np.where(self.passes.observable[:, None], change, 0.0)

    def scale_error(self) -> np.ndarray:
        """Return the share (3,) by which rates may seem smaller or larger because of the rows.

        To first order a shift makes no rate larger or smaller; a row of many milliseconds does so to the second, and
        the D and I terms of the slower loop are not those of the loop that flew. In flights without an error of the
        scale, with commands held, averaged or late, it seemed wrong by up to 1.3 times what a shift of a whole row
        makes. Zero where every pass has a row.
        """
        rates, t = self._delayed(0.0, 0.0, 0.0)[:, :3], self.passes.t
        moved = [
            np.stack([np.interp(t + shift_s, t, rate) for rate in rates.T], axis=-1)
            for shift_s in (-self.row_s, self.row_s)
        ]
        rates, moved = (one[self.passes.observable] for one in (rates, np.mean(moved, axis=0)))
        rates, moved = rates - rates.mean(axis=0), moved - moved.mean(axis=0)
        return SCALE_MARGIN * (1.0 - np.sum(rates * moved, axis=0) / np.maximum(np.sum(rates**2, axis=0), 1e-12))

    def _delayed(self, delay_s: float, jitter_s: float, share: float) -> np.ndarray:
        """Return the command (n, 4) in force over each pass where this share of the commands is lost."""
        lost, distinct = self.timing.lost, self.timing.distinct
        command, recorded_share = self.held(delay_s, jitter_s), float(lost.sum() / max(distinct.sum(), 1))
        if recorded_share > 0 and share:
            command = command + share / recorded_share * (self.held(delay_s, jitter_s, lost) - command)
        return command


def _delays(terms: dict) -> tuple[float, float, float]:
    """Return delay s, jitter s and lost share of commands from a vehicle file's terms."""
    latency = terms.get("command_latency", {})
    return latency.get("delay", 0.0), latency.get("jitter", 0.0), terms.get("dropped_commands", {}).get("share", 0.0)


def distorted(command, terms: dict) -> np.ndarray:
    """Return commands (n, 4) after the terms `rate_scale` and `throttle_curve`."""
    entries = {
        name: build(command_path.TERMS[name].coefficients, terms[name], f"terms.{name}")
        for name in ("rate_scale", "throttle_curve")
        if name in terms
    }
    entries = {name: _as_arrays(entry) for name, entry in entries.items()}
    rates, throttle = command_path.distort(command[:, :3], command[:, 3], entries)
    return np.column_stack([rates, throttle])


def _as_arrays(entry):
    """Return the coefficients with arrays in place of tuples."""
    return type(entry)(**{name: np.asarray(value) for name, value in vars(entry).items()})


def read_command_link(
    table: FlightTable, loop: rate_pid.RatePid | None, rows: CommandRows | None = None
) -> CommandLink | Unavailable:
    """Return sent and received commands of a recording, or why they cannot be evaluated.

    Args:
        table: the recording.
        loop: rate loop that flew; None where its type is not supported.
        rows: its motor commands, where their shift is already fitted; None before.
    """
    if missing := [name for name in NEEDED if name not in table]:
        return Unavailable(missing=tuple(missing))
    if loop is None:
        return Unavailable("the flight controller's loop is not one that is replayed (rate_pid)")
    motors, gyro = table["motor_command"], table["gyro_body"]
    slow = rows or command_rows_of(motors, table.sampling.get("motor_command"), loop.step_s)
    if motors.rate_hz > (1.0 + RATE_TOLERANCE) * loop.rate_hz:
        return Unavailable(
            f"motor commands are recorded at {motors.rate_hz:.0f} Hz, the rate loop runs at {loop.rate_hz:.0f} Hz"
        )
    rates, thrust = table["omega_command_body"], table["thrust_command"]
    sent = np.column_stack([rates.values, np.interp(rates.t, thrust.t, thrust.values) / loop.top])
    if slow is not None:
        return _link_of_rows(table, loop, slow, Samples(rates.t, sent))
    t, motor_rows, gyro_rows = np.intersect1d(np.round(motors.t, 6), np.round(gyro.t, 6), return_indices=True)
    if len(t) < MIN_SHARED_SAMPLES * len(motors.t):
        return Unavailable("gyro and motor commands are not recorded at the same times")
    passes = Passes.of(t, loop.step_s, rates.t, sent)
    gap = np.diff(t, prepend=t[0] - SETTLING_S) > 1.5 * loop.step_s
    since = t - np.maximum.accumulate(np.where(gap, t, -np.inf))
    known = (since >= SETTLING_S) & _while_sending(rates, t)
    passes = _received(passes, loop, gyro.values[gyro_rows], motors.values[motor_rows], known)
    return CommandLink(passes, estimate_command_timing(passes)) if passes.observable.any() else AT_LIMIT


def _received(passes: Passes, loop: rate_pid.RatePid, gyro_body, motor_command, known) -> Passes:
    """Return passes with the received commands, observable where (n,) the filters are settled and no motor clips."""
    in_force = passes.in_force(passes.first)
    received, observable = rate_pid.received_commands(loop, gyro_body, motor_command, in_force)
    return replace(passes, received=received, observable=observable & known)


def _link_of_rows(
    table: FlightTable, loop: rate_pid.RatePid, rows: CommandRows, sent: Samples
) -> CommandLink | Unavailable:
    """Return the command link of a recording whose rows are slower than the loop.

    The rows are taken for passes of a slower loop. Its D and I terms differ a little from the true ones; that is noise
    of the received commands. The time between a sent command and its row is unknown by up to a row: a common delay that
    is shorter is taken out, because it belongs to the recording.
    """
    row_s, gyro = rows.interval_s, table["gyro_body"]
    stamps = rows.samples.t + rows.shift_s - 0.5 * loop.step_s  # at which the loop set these commands
    within = (stamps >= gyro.t[0]) & (stamps <= gyro.t[-1])
    if within.sum() < MIN_ROWS:
        return Unavailable("gyro and motor commands are not recorded at the same times")
    number = _row_numbers(stamps[within], row_s)
    every = np.arange(number[-1] + 1)
    # The passes stand at the rows. On a grid of their mean interval, stamps that scatter, or a clock that drifts, would
    # mix commands of neighbouring rows.
    t = np.interp(every, number, stamps[within])
    motor_command = np.clip(CubicSpline(number, rows.samples.values[within])(every), 0.0, 1.0)
    commands, complete = _distinct_rows(sent), every_command_has_a_row(sent, row_s)
    known = (t >= t[0] + SETTLING_S) & np.isin(every, number) & _while_sending(sent, t)
    slower = replace(loop, rate_hz=1.0 / row_s)
    without = Passes.of(t, row_s, commands.t, commands.values)
    passes, later, earlier = (
        _received(without, slower, grid.at(gyro, t - late_s), motor_command, known)
        for late_s in (0.0, 0.5 * row_s, -0.5 * row_s)
    )
    if not passes.observable.any():
        return AT_LIMIT
    late_gyro = 0.5 * (later.received - earlier.received)
    delays_s = np.arange(-1.0, MAX_DELAY_S / row_s, 1.0 / ROW_PARTS) * row_s
    moved = [Passes.of(t, row_s, commands.t + delay_s, commands.values) for delay_s in delays_s]
    moved = [replace(one, received=passes.received, observable=passes.observable) for one in moved]
    best = int(np.argmin([delayed_fit(one, 0.0)[0] for one in moved]))
    if abs(delays_s[best]) < (1.0 + RATE_TOLERANCE) * row_s:
        passes = moved[best]
    timing = estimate_command_timing(passes)
    if not complete:
        nothing = np.zeros(len(timing.lost), bool)
        timing = CommandTiming(nothing, nothing, np.zeros(len(nothing)))
    return CommandLink(passes, timing, row_s, late_gyro, complete)


def _row_numbers(stamps, row_s: float) -> np.ndarray:
    """Return the number (m,) of each row from its stamps (m,) s; lost rows have numbers too."""
    return np.cumsum(np.maximum(np.rint(np.diff(stamps, prepend=stamps[0] - row_s) / row_s), 1.0)).astype(int) - 1


def _distinct_rows(sent: Samples) -> Samples:
    """Return the commands without rows that repeat the one before."""
    again = repeats(sent)
    return Samples(sent.t[~again], sent.values[~again]) if again.mean() > MIN_REPEATS else sent


def _while_sending(rates: Samples, t) -> np.ndarray:
    """Return when (n,) commands were sent: from the first one on, and not in pauses longer than LONG_GAP periods."""
    period_s = 1.0 / rates.rate_hz
    pause_s = np.diff(rates.t, append=np.inf)
    valid_until = np.concatenate([[-np.inf], rates.t + np.where(pause_s > LONG_GAP * period_s, 1.5 * period_s, np.inf)])
    return t <= valid_until[np.searchsorted(rates.t, t + STAMP_TOLERANCE_S, "right")]


def chance_variance(effect: str, values, links: list[CommandLink]) -> float:
    """Return the sampling variance of the first parameter of an effect of the command link.

    A finite number of commands was lost or delayed by chance, and a delay acts in whole passes.

    Args:
        effect: id of the effect.
        values: its parameters.
        links: one for each recording.
    """
    step_s = links[0].passes.step_s
    if effect == "dropped_commands":
        return float(values[0] * (1.0 - values[0]) / max(sum(link.timing.distinct.sum() for link in links), 1))
    if effect == "command_jitter":
        timed = max(sum(link.timing.timed for link in links), 1)
        return float(UNIFORM_KURTOSIS * values[0] ** 2 / (4.0 * timed) + (QUANTISATION * step_s) ** 2)
    return (0.5 * step_s) ** 2 if effect == "command_latency" else 0.0
