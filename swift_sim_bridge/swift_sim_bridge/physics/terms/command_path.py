"""Errors of commands between the pilot and the flight controller's rate loop: delay, loss, scale and offset.

Each is one entry of the vehicle file's `terms`; an absent one is not simulated. `CommandQueue` is the memory of delay
and loss. Commands are rates (FLU, rad/s) and throttle (0..1) as the flight controller decodes them from its frames.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import COMMAND_CHANNELS, Effect, scalar_parameter, vector_parameters
from swift_sim_bridge.physics.terms import noise
from swift_sim_bridge.physics.terms.term import Term, salt
from swift_sim_bridge.physics.terms.vectors import parts

SLOTS = 8  # commands in the queue: 0.07 s of them at 100 Hz
MAX_DELAY_S = 0.07  # longest delay with jitter that the queue holds at 100 Hz


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CommandLatency:
    """Delay of the commands.

    Attributes:
        delay: s, mean of all commands, 0.005 to 0.04.
        jitter: s, standard deviation of a uniform random delay in addition, 0.001 to 0.008.
    """

    delay: float
    jitter: float = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DroppedCommands:
    """Loss of commands; the last received command stays in force.

    Attributes:
        share: of the commands that are lost, 0 to 0.05.
    """

    share: float


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ThrottleCurve:
    """Error of the throttle: (1 + gain) u + curve u (1 - u) for throttle u.

    Attributes:
        gain: relative error, -0.15 to 0.15.
        curve: quadratic error.
    """

    gain: float = 0.0
    curve: float = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RateScale:
    """Error of the commanded rates, for each axis: scale command + offset + cubic command^3.

    Attributes:
        scale: (3,), 0.9 to 1.1.
        offset: (3,) rad/s, -0.2 to 0.2.
        cubic: (3,) s^2/rad^2.
    """

    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cubic: tuple[float, float, float] = (0.0, 0.0, 0.0)


def fits_queue(coefficients, vehicle):
    """Raise ValueError for negative delays and for those that the queue cannot hold."""
    if not (coefficients.delay >= 0 and coefficients.jitter >= 0):
        raise ValueError("must have a 'delay' and a 'jitter' of at least 0, in s")
    if coefficients.delay + 2 * coefficients.jitter > MAX_DELAY_S:
        raise ValueError("must have a 'delay' plus twice the 'jitter' of at most 0.07 s")


QUEUED = ("command_latency", "dropped_commands")  # terms that need the queue


class Command(NamedTuple):
    """Body rates x, y, z (...) rad/s and throttle (...) 0..1."""

    x: jax.Array
    y: jax.Array
    z: jax.Array
    throttle: jax.Array


class CommandQueue(NamedTuple):
    """Commands on their way to the rate loop.

    Attributes:
        held: the command that was in force last.
        sent: SLOTS commands, newest first.
        due: SLOTS of (...) s from the start of the tick at which each takes effect; infinite for a lost one.
        noise: random streams.
    """

    held: Command
    sent: tuple
    due: tuple
    noise: dict


def start(terms: dict, like, key=None) -> CommandQueue | None:
    """Return a queue filled with closed throttle, shaped as `like` (...); None where no term needs a queue."""
    if not set(QUEUED) & set(terms):
        return None
    key = jax.random.fold_in(jax.random.key(0) if key is None else key, 1)
    zero = jnp.zeros_like(like)
    closed = Command(zero, zero, zero, zero)
    return CommandQueue(closed, (closed,) * SLOTS, (zero,) * SLOTS, noise.start(key, like.shape))


def distort(setpoint_omega_body, throttle, terms: dict):
    """Return (rates (..., 3), throttle (...)) with the errors of the terms; a closed throttle stays closed."""
    if "rate_scale" in terms:
        error, command = terms["rate_scale"], setpoint_omega_body
        setpoint_omega_body = error.scale * command + error.offset + error.cubic * command * command * command
    if "throttle_curve" in terms:
        error = terms["throttle_curve"]
        distorted = (1.0 + error.gain) * throttle + error.curve * throttle * (1.0 - throttle)
        throttle = jnp.where(throttle > 0, jnp.clip(distorted, 0.0, 1.0), 0.0)
    return setpoint_omega_body, throttle


def send(queue: CommandQueue, setpoint_omega_body, throttle, terms: dict, tick_s: float) -> CommandQueue:
    """Return the queue with one more command, sent at the start of the tick that begins now."""
    zero = jnp.zeros_like(queue.due[0])
    late, lost = noise.white(queue.noise, salt("command_path"), 2, zero.dtype)
    due = zero
    if "command_latency" in terms:
        latency = terms["command_latency"]
        due = jnp.maximum(latency.delay + latency.jitter * late, 0.0)
    if "dropped_commands" in terms:
        drawn = lost / 12.0**0.5 + 0.5  # 0..1
        due = jnp.where(drawn < terms["dropped_commands"].share, jnp.inf, due)
    command = Command(*(part + zero for part in (*parts(setpoint_omega_body), throttle)))
    return CommandQueue(
        queue.held,
        (command, *queue.sent[:-1]),
        (due + zero, *(old - tick_s for old in queue.due[:-1])),
        noise.advance(queue.noise),
    )


def received(queue: CommandQueue, time) -> Command:
    """Return the command in force `time` s into the tick: the newest of those received."""
    command = queue.held
    for sent, due in zip(reversed(queue.sent), reversed(queue.due), strict=True):
        received_by_now = due <= time + 1e-6
        command = Command(*(jnp.where(received_by_now, new, old) for new, old in zip(sent, command, strict=True)))
    return command


def hold(queue: CommandQueue, time) -> CommandQueue:
    """Return the queue at the end of a tick in which the last command was read at `time` s."""
    return queue._replace(held=received(queue, time))


TERMS = {
    "command_latency": Term(
        CommandLatency,
        check=fits_queue,
        idle={"delay": 0.0, "jitter": 0.0},
        example={"delay": 0.01, "jitter": 0.002},
        effects=(
            Effect(
                id="command_latency",
                layer="command",
                parameters=(scalar_parameter("delay", "s", "command_latency", step=2e-3, low=0.0, high=0.05),),
                equation="received command(t) = sent command(t - d)",
                sentence="commands act {delay:.4g} s late",
                manoeuvre="roll and pitch doublets above 3 Hz",
                channels=COMMAND_CHANNELS,
            ),
            Effect(
                id="command_jitter",
                layer="command",
                parameters=(scalar_parameter("jitter", "s", "command_latency", step=5e-4, low=0.0, high=0.01),),
                equation="received command(t) = sent command(t - d), d random and uniform",
                sentence="the delay of the commands varies with a standard deviation of {jitter:.4g} s",
                manoeuvre="a minute of lively flight",
                channels=COMMAND_CHANNELS,
            ),
        ),
    ),
    "dropped_commands": Term(
        DroppedCommands,
        idle={"share": 0.0},
        example={"share": 0.01},
        effects=(
            Effect(
                id="dropped_commands",
                layer="command",
                parameters=(scalar_parameter("share", "", "dropped_commands", step=5e-3, low=0.0, high=0.9),),
                equation="a lost command leaves the last one in force",
                sentence="{share:.2%} of the commands are lost",
                manoeuvre="a minute of lively flight",
                channels=COMMAND_CHANNELS,
            ),
        ),
    ),
    "throttle_curve": Term(
        ThrottleCurve,
        idle={"gain": 0.0, "curve": 0.0},
        example={"gain": 0.05, "curve": -0.1},
        effects=(
            Effect(
                id="throttle_curve",
                layer="command",
                parameters=(
                    scalar_parameter("gain", "", "throttle_curve", step=5e-3, low=-0.5, high=1.0),
                    scalar_parameter("curve", "", "throttle_curve", step=5e-3, low=-1.0, high=1.0),
                ),
                equation="received throttle = (1 + gain) u + curve u (1 - u)",
                sentence="the throttle acts by another curve: gain {gain:.3g}, curve {curve:.3g}",
                manoeuvre="a slow ramp of the throttle",
                channels=COMMAND_CHANNELS,
            ),
        ),
    ),
    "rate_scale": Term(
        RateScale,
        idle={"scale": [1.0, 1.0, 1.0], "offset": [0.0, 0.0, 0.0]},
        example={"scale": [1.05, 0.95, 0.9], "offset": [0.1, -0.05, 0.02], "cubic": [1e-3, -2e-3, 3e-3]},
        effects=(
            Effect(
                id="rate_scale",
                layer="command",
                parameters=(
                    *vector_parameters("scale", "", "rate_scale", step=5e-3, bounds=(0.2, 3.0)),
                    *vector_parameters("offset", "rad/s", "rate_scale", step=5e-3, bounds=(-1.0, 1.0)),
                ),
                equation="received rate = scale sent rate + offset",
                sentence="commanded rates act by {values} (factors, then rad/s)",
                manoeuvre="spins about each axis",
                channels=COMMAND_CHANNELS,
            ),
        ),
        units={"cubic": "s^2/rad^2"},
    ),
}
