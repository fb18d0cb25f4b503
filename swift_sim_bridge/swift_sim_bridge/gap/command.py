"""The way of a command to the rate loop: what was sent against what was heard, late, lost and bent. Pure.

What chance did to a flight, which commands were lost, is read from the recording; how often it does so is the effect.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.configuration import build
from swift_ros.flight_table import FlightTable
from swift_sim_bridge import command_path
from swift_sim_bridge.gap import rate_loop

UNITS = {"roll rate": "rad/s", "pitch rate": "rad/s", "yaw rate": "rad/s", "throttle": ""}
LEAST = (0.01, 0.01, 0.01, 0.001)  # nobody cares for less
LONGEST_S = 0.05  # delay that is tried while lost commands are looked for
APART = 6.0  # standard deviations between two commands, to be told apart
RATE_TOLERANCE = 0.02
FORGOTTEN_S = 0.5  # after which the loop's filters have forgotten how they began


@dataclass(frozen=True)
class Line:
    """What went in and what came out. t (n,) s: of the loop's passes, step_s apart; heard (n, 4): rates rad/s and
    throttle 0..1; told (n,): where the motors tell them; stamps (k,) s; sent (k, 4); lost (k,): never heard;
    plain (k,): so unlike the one before that a loss shows."""

    t: np.ndarray
    step_s: float
    heard: np.ndarray
    told: np.ndarray
    stamps: np.ndarray
    sent: np.ndarray
    lost: np.ndarray
    plain: np.ndarray

    def held(self, delay_s: float, lost) -> np.ndarray:
        """Return the command (n, 4) in force at each pass: the newest that arrived, blended between whole passes."""
        passes = delay_s / self.step_s
        whole = int(np.floor(passes))
        share = passes - whole
        early = self._newest(whole, self.sent, lost)
        return early if share == 0 else (1.0 - share) * early + share * self._newest(whole + 1, self.sent, lost)

    def _newest(self, passes: int, rows, lost) -> np.ndarray:
        kept = np.flatnonzero(~lost)
        arrived = np.searchsorted(self.stamps[kept], self.t - passes * self.step_s + 1e-6, "right") - 1
        return rows[kept[np.clip(arrived, 0, None)]]

    def residual(self, terms: dict) -> np.ndarray:
        """Return heard less what `terms` of a vehicle file make of what was sent (n, 4), zero where nothing tells."""
        delay = terms.get("command_latency", {}).get("delay", 0.0)
        share = terms.get("dropped_commands", {}).get("share", 0.0)
        none, usual = np.zeros(len(self.sent), bool), float(self.lost.sum() / max(self.plain.sum(), 1))
        command = self.held(delay, none)
        if usual > 0 and share:
            command = command + share / usual * (self.held(delay, self.lost) - command)
        return np.where(self.told[:, None], self.heard - bent(command, terms), 0.0)


def bent(command, terms: dict) -> np.ndarray:
    """Return commands (n, 4) as `rate_scale` and `throttle_curve` bend them."""
    own = {name: build(command_path.COMMANDS[name].coefficients, terms[name], f"terms.{name}")
           for name in ("rate_scale", "throttle_curve") if name in terms}
    own = {name: _as_arrays(entry) for name, entry in own.items()}
    rates, throttle = command_path.bend(command[:, :3], command[:, 3], own)
    return np.column_stack([rates, throttle])


def _as_arrays(entry):
    return type(entry)(**{name: np.asarray(value) for name, value in vars(entry).items()})


def line_of(table: FlightTable, loop: rate_loop.RateLoop | None) -> Line | str:
    """Return what a recording tells of its commands' way, or why it tells nothing."""
    missing = [name for name in ("omega_command_body", "thrust_command", "motor_command", "gyro_body")
               if name not in table]
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
    none = np.zeros(len(rates.t), bool)
    line = Line(t, loop.step_s, np.zeros((len(t), 4)), np.zeros(len(t), bool), rates.t, sent, none, none)
    commanded = line.held(0.0, line.lost)
    found, told = rate_loop.heard(loop, gyro.values[theirs], motors.values[own], commanded)
    gap = np.diff(t, prepend=t[0] - FORGOTTEN_S) > 1.5 * loop.step_s
    since = t - np.maximum.accumulate(np.where(gap, t, -np.inf))
    line = replace(line, heard=found, told=told & (since >= FORGOTTEN_S))
    never, plain = lost(line)
    return replace(line, lost=never, plain=plain)


def by_chance(effect: str, values, lines: list[Line]) -> float:
    """Return what chance adds to the variance of an effect's first parameter: of so many commands so many are lost, and
    a delay acts in whole passes."""
    if effect == "dropped_commands":
        return float(values[0] * (1.0 - values[0]) / max(sum(line.plain.sum() for line in lines), 1))
    return (0.5 * lines[0].step_s) ** 2 if effect == "command_latency" else 0.0


def lost(line: Line) -> tuple[np.ndarray, np.ndarray]:
    """Return which commands (k,) were never heard: while they should have been in force, the one before them was; and
    of which that can be told."""
    passes, gain, offset = _aligned(line)
    told = offset + gain * line.sent
    first = np.searchsorted(line.t, line.stamps + passes * line.step_s - 1e-6)
    total = np.concatenate([np.zeros((1, 5)), np.cumsum(np.column_stack([line.heard, np.ones(len(line.t))])
                                                       * line.told[:, None], axis=0)])  # fmt: skip
    within = total[np.append(first[1:], len(line.t))] - total[first]
    count = within[:, 4:]
    mean = within[:, :4] / np.maximum(count, 1)
    noise = np.maximum(1.4826 * np.median(np.abs(mean - told)[count[:, 0] > 0], axis=0), LEAST)
    found, plain, before = np.zeros(len(told), bool), np.zeros(len(told), bool), told[0]
    for k in range(1, len(told)):
        plain[k] = count[k, 0] and np.linalg.norm((told[k] - before) / noise) > APART
        if plain[k]:
            old, new = (np.linalg.norm((mean[k] - one) / noise) for one in (before, told[k]))
            found[k] = old < 0.3 * new
        before = before if found[k] else told[k]
    return found, plain


def _aligned(line: Line) -> tuple[int, np.ndarray, np.ndarray]:
    """Return by how many passes commands are late, and gain and offset (4,) of what is heard of them."""
    none, best = np.zeros(len(line.sent), bool), None
    heard = line.heard[line.told]
    for passes in range(round(LONGEST_S / line.step_s)):
        sent = line.held(passes * line.step_s, none)[line.told]
        apart = sent - sent.mean(axis=0)
        gain = np.sum(apart * heard, axis=0) / np.maximum(np.sum(apart**2, axis=0), 1e-12)
        offset = heard.mean(axis=0) - gain * sent.mean(axis=0)
        off = np.sum(((heard - offset - gain * sent) / np.maximum(heard.std(axis=0), LEAST)) ** 2)
        if best is None or off < best[0]:
            best = off, passes, gain, offset
    return best[1:]
