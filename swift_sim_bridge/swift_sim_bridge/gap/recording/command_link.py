"""The way of a command to the rate loop: what was sent against what was heard, late, lost and bent. Pure.

What chance did to a flight, which commands were lost or late, is read from the recording (`arrivals`); how often, and
by how much, is the effect.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.configuration import build
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.recording import command_timing as arrivals
from swift_sim_bridge.gap.recording import rate_pid
from swift_sim_bridge.gap.recording.command_timing import CommandTiming, Passes
from swift_sim_bridge.identification.grid import LONG_GAP
from swift_sim_bridge.physics.terms import command_path

UNITS = {"roll rate": "rad/s", "pitch rate": "rad/s", "yaw rate": "rad/s", "throttle": ""}
RATE_TOLERANCE = 0.02
FORGOTTEN_S = 0.5  # after which the loop's filters have forgotten how they began
EVEN_KURTOSIS = 0.8  # of what is evenly spread, less one
QUANTISED = 0.1  # passes, by which a spread is off that was seen in whole ones


@dataclass(frozen=True)
class Line:
    """What went in and what came out of a rate loop, and what became of it on the way."""

    passes: Passes
    arrivals: CommandTiming

    def held(self, delay_s: float, jitter_s: float = 0.0, lost=False) -> np.ndarray:
        """Return the command (n, 4) in force over each pass, if all come so late and scatter so much, as these ones by
        chance did; lost (k,): those that never come."""
        found = self.arrivals
        late_s = jitter_s / found.jitter_s * found.late_s if found.jitter_s else 0.0
        due = np.where(lost, np.inf, self.passes.first + np.maximum(delay_s + late_s, 0.0))
        return self.passes.in_force(due)

    def residuals(self, many: list[dict]) -> np.ndarray:
        """Return heard less what each of some vehicle files' `terms` makes of what was sent (b, n, 4), zero where
        nothing tells. What comes alike is worked out once."""
        ways, found = [_way(terms) for terms in many], []
        came = {way: self._came(*way) for way in set(ways)}
        for terms, way in zip(many, ways, strict=True):
            found.append(np.where(self.passes.told[:, None], self.passes.heard - bent(came[way], terms), 0.0))
        return np.stack(found)

    def _came(self, delay_s: float, jitter_s: float, share: float) -> np.ndarray:
        """Return the command (n, 4) in force over each pass where such a share is lost."""
        lost, plain = self.arrivals.lost, self.arrivals.plain
        command, usual = self.held(delay_s, jitter_s), float(lost.sum() / max(plain.sum(), 1))
        if usual > 0 and share:
            command = command + share / usual * (self.held(delay_s, jitter_s, lost) - command)
        return command


def _way(terms: dict) -> tuple[float, float, float]:
    """Return delay s, jitter s and lost share of commands by a vehicle file's terms."""
    late = terms.get("command_latency", {})
    return late.get("delay", 0.0), late.get("jitter", 0.0), terms.get("dropped_commands", {}).get("share", 0.0)


def bent(command, terms: dict) -> np.ndarray:
    """Return commands (n, 4) as `rate_scale` and `throttle_curve` bend them."""
    own = {
        name: build(command_path.COMMANDS[name].coefficients, terms[name], f"terms.{name}")
        for name in ("rate_scale", "throttle_curve")
        if name in terms
    }
    own = {name: _as_arrays(entry) for name, entry in own.items()}
    rates, throttle = command_path.bend(command[:, :3], command[:, 3], own)
    return np.column_stack([rates, throttle])


def _as_arrays(entry):
    return type(entry)(**{name: np.asarray(value) for name, value in vars(entry).items()})


def read_command_link(table: FlightTable, loop: rate_pid.RatePid | None) -> Line | str:
    """Return what a recording tells of its commands' way, or why it tells nothing."""
    missing = [
        name for name in ("omega_command_body", "thrust_command", "motor_command", "gyro_body") if name not in table
    ]
    if missing:
        return f"the recording lacks {', '.join(missing)}"
    if loop is None:
        return "the flight controller's loop is not one that is replayed (rate_pid)"
    motors, gyro = table["motor_command"], table["gyro_body"]
    if abs(motors.rate_hz / loop.rate_hz - 1.0) > RATE_TOLERANCE:
        return f"motor commands are recorded at {motors.rate_hz:.0f} Hz, the rate loop runs at {loop.rate_hz:.0f} Hz"
    t, own, theirs = np.intersect1d(np.round(motors.t, 6), np.round(gyro.t, 6), return_indices=True)
    if len(t) < 0.9 * len(motors.t):
        return "gyro and motor commands are not recorded at the same times"
    rates, thrust = table["omega_command_body"], table["thrust_command"]
    sent = np.column_stack([rates.values, np.interp(rates.t, thrust.t, thrust.values) / loop.top])
    passes = Passes.of(t, loop.step_s, rates.t, sent)
    found, told = rate_pid.heard(loop, gyro.values[theirs], motors.values[own], passes.in_force(passes.first))
    gap = np.diff(t, prepend=t[0] - FORGOTTEN_S) > 1.5 * loop.step_s
    since = t - np.maximum.accumulate(np.where(gap, t, -np.inf))
    passes = replace(passes, heard=found, told=told & (since >= FORGOTTEN_S) & _spoken(rates, t))
    if not passes.told.any():
        return "a motor stands at its limit, or the recording has a gap, all the time"
    return Line(passes, arrivals.of(passes))


def _spoken(rates: Samples, t) -> np.ndarray:
    """Return when (n,) commands were sent, at times t (n,) s: from the first on, and but for a period not in pauses."""
    period_s = 1.0 / rates.rate_hz
    pause_s = np.diff(rates.t, append=np.inf)
    lasts = np.concatenate([[-np.inf], rates.t + np.where(pause_s > LONG_GAP * period_s, 1.5 * period_s, np.inf)])
    return t <= lasts[np.searchsorted(rates.t, t + arrivals.EDGE_S, "right")]


def chance_variance(effect: str, values, lines: list[Line]) -> float:
    """Return what chance adds to the variance of an effect's first parameter: of so many commands so many are lost, or
    come so late, and a delay acts in whole passes."""
    step_s = lines[0].passes.step_s
    if effect == "dropped_commands":
        return float(values[0] * (1.0 - values[0]) / max(sum(line.arrivals.plain.sum() for line in lines), 1))
    if effect == "command_jitter":
        timed = max(sum(line.arrivals.timed for line in lines), 1)
        return float(EVEN_KURTOSIS * values[0] ** 2 / (4.0 * timed) + (QUANTISED * step_s) ** 2)
    return (0.5 * step_s) ** 2 if effect == "command_latency" else 0.0
