"""What may befall commands between the pilot and the flight controller's rate loop: late, lost, bent.

Each effect is one entry of the vehicle file's `terms`; absent ones cost nothing. `Line` is the memory of those that
need one. Commands are rates (FLU, rad/s) and throttle (0..1) as the flight controller decodes them from its frames.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms import noise
from swift_sim_bridge.physics.terms.term import Term, salt
from swift_sim_bridge.physics.terms.vectors import parts

SLOTS = 8  # commands under way at once: 0.07 s of them at 100 Hz


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CommandLatency:
    """delay: s, 0.005..0.04, of every command; jitter: s, 0.001..0.008, standard deviation of what comes on top,
    evenly spread."""

    delay: float
    jitter: float = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DroppedCommands:
    """share: of the commands that never arrive, 0..0.05; the last one that did holds."""

    share: float


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrottleCurve:
    """gain: share by which throttle is scaled up, -0.15..0.15; curve: what bends it, throttle += curve u (1 - u)."""

    gain: float = 0.0
    curve: float = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RateScale:
    """scale: (3,) factors of the commanded rates, 0.9..1.1; offset: (3,) rad/s, -0.2..0.2; cubic: (3,) s^2/rad^2, each
    axis its own: omega = scale command + offset + cubic command^3."""

    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cubic: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _possible(coefficients, vehicle):
    """Raise ValueError for delays longer than the line."""
    if not (coefficients.delay >= 0 and coefficients.jitter >= 0):
        raise ValueError("must have a 'delay' and a 'jitter' of at least 0, in s")
    if coefficients.delay + 2 * coefficients.jitter > 0.07:
        raise ValueError("must have a 'delay' plus twice the 'jitter' of at most 0.07 s")


COMMANDS = {
    "command_latency": Term(CommandLatency, check=_possible),
    "dropped_commands": Term(DroppedCommands),
    "throttle_curve": Term(ThrottleCurve),
    "rate_scale": Term(RateScale),
}
LATE = ("command_latency", "dropped_commands")


class Command(NamedTuple):
    """rates (...) rad/s by axis, throttle (...) 0..1."""

    x: jax.Array
    y: jax.Array
    z: jax.Array
    throttle: jax.Array


class CommandQueue(NamedTuple):
    """Commands under way. held: the one in force last; sent: SLOTS of them, newest first; due: SLOTS of (...) s from
    the start of the tick at which each acts, infinite for those lost; noise: random streams."""

    held: Command
    sent: tuple
    due: tuple
    noise: dict


def start(terms: dict, like, key=None) -> CommandQueue | None:
    """Return a line on which closed throttle has stood for long, shaped as `like` (...); None where none is needed."""
    if not set(LATE) & set(terms):
        return None
    key = jax.random.fold_in(jax.random.key(0) if key is None else key, 1)
    zero = jnp.zeros_like(like)
    closed = Command(zero, zero, zero, zero)
    return CommandQueue(closed, (closed,) * SLOTS, (zero,) * SLOTS, noise.start(key, like.shape))


def bend(setpoint_omega_body, throttle, terms: dict):
    """Return (rates (..., 3), throttle (...)) as scale, offset, cubic and the throttle's curve distort them.

    A closed throttle stays closed.
    """
    if "rate_scale" in terms:
        own, command = terms["rate_scale"], setpoint_omega_body
        setpoint_omega_body = own.scale * command + own.offset + own.cubic * command * command * command
    if "throttle_curve" in terms:
        own = terms["throttle_curve"]
        bent = (1.0 + own.gain) * throttle + own.curve * throttle * (1.0 - throttle)
        throttle = jnp.where(throttle > 0, jnp.clip(bent, 0.0, 1.0), 0.0)
    return setpoint_omega_body, throttle


def send(line: CommandQueue, setpoint_omega_body, throttle, terms: dict, tick_s: float) -> CommandQueue:
    """Return the line with one more command on it, given at the start of the tick that begins now."""
    zero = jnp.zeros_like(line.due[0])
    late, lost = noise.white(line.noise, salt("command_path"), 2, zero.dtype)
    due = zero
    if "command_latency" in terms:
        own = terms["command_latency"]
        due = jnp.maximum(own.delay + own.jitter * late, 0.0)
    if "dropped_commands" in terms:
        drawn = lost / 12.0**0.5 + 0.5  # 0..1
        due = jnp.where(drawn < terms["dropped_commands"].share, jnp.inf, due)
    given = Command(*(part + zero for part in (*parts(setpoint_omega_body), throttle)))
    return CommandQueue(
        line.held,
        (given, *line.sent[:-1]),
        (due + zero, *(old - tick_s for old in line.due[:-1])),
        noise.advance(line.noise),
    )


def received(line: CommandQueue, time) -> Command:
    """Return the command in force `time` s into the tick: of those arrived, the newest."""
    command = line.held
    for sent, due in zip(reversed(line.sent), reversed(line.due), strict=True):
        there = due <= time + 1e-6
        command = Command(*(jnp.where(there, new, old) for new, old in zip(sent, command, strict=True)))
    return command


def hold(line: CommandQueue, time) -> CommandQueue:
    """Return the line at the end of a tick whose last command was taken at `time` s."""
    return line._replace(held=received(line, time))
