"""The effects that a vehicle file switches on: one entry of its `terms` each, absent ones are not simulated.

A term is a dataclass of its coefficients (which mirrors the file's entry) and one function or more (see `term.Term`).
One more effect is one more function in the file where it belongs and one more row in the registry of its kind:
`wrenches.WRENCHES`, `air.AIR`, `airframe.AIRFRAME`, `command_path.COMMANDS`, `sensors.terms.SENSOR_TERMS`.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.configuration import build
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.physics.terms import noise, rotors
from swift_sim_bridge.physics.terms.air import AIR
from swift_sim_bridge.physics.terms.airframe import AIRFRAME
from swift_sim_bridge.physics.terms.command_path import COMMANDS
from swift_sim_bridge.physics.terms.motion import Instant, Motion, instant_of, wrench_of
from swift_sim_bridge.physics.terms.term import salt
from swift_sim_bridge.physics.terms.vectors import ZERO, Vector, add, kept, stack
from swift_sim_bridge.physics.terms.wrenches import WRENCHES
from swift_sim_bridge.sensors.terms import SENSOR_TERMS

PHYSICS = {**WRENCHES, **AIR, **AIRFRAME, **COMMANDS}
ACTING = ("hubs", "wrench", "air", "motor", "tow", "advance")  # hooks of what does anything in flight
NOISE = "noise"  # where the random streams stand among what the effects remember


def coefficients_from_vehicle(vehicle: Vehicle) -> dict:
    """Return the coefficients by name of the vehicle's terms but its sensors' (see `sensors.terms`).

    Raises UsageError for an unknown name or coefficient.
    """
    for name in vehicle.terms:
        if name not in PHYSICS and name not in SENSOR_TERMS:
            known = ", ".join([*PHYSICS, *SENSOR_TERMS])
            raise UsageError(f"the vehicle '{vehicle.name}' has the unknown term '{name}' in terms; known are {known}")
    built = {name: _built(name, entry, vehicle) for name, entry in vehicle.terms.items() if name in PHYSICS}
    return jax.tree.map(np.asarray, built, is_leaf=lambda leaf: isinstance(leaf, tuple))


def _built(name: str, entry, vehicle: Vehicle):
    where = f"the vehicle '{vehicle.name}', terms.{name}"
    coefficients = build(PHYSICS[name].coefficients, entry, where)
    if PHYSICS[name].check:
        try:
            PHYSICS[name].check(coefficients, vehicle)
        except ValueError as error:
            raise UsageError(f"{where} {error}") from error
    return coefficients


def having(parameters, hook: str):
    """Return [(name, the term's `hook`, coefficients)] of the parameters' terms that have one."""
    rows = ((name, getattr(PHYSICS[name], hook), own) for name, own in parameters.terms.items())
    return [row for row in rows if row[1]]


def with_airframe(parameters):
    """Return the parameters as their airframe terms change them."""
    for _, change, own in having(parameters, "airframe"):
        parameters = change(parameters, own)
    return parameters


def flying(parameters):
    """Return the parameters with the terms that act in flight alone: neither those that have changed the airframe, nor
    those of commands on their way. With and without such is one compiled program where no commands are sent."""
    acts = {name: any(getattr(PHYSICS[name], hook) for hook in ACTING) for name in parameters.terms}
    return replace(parameters, terms={name: own for name, own in parameters.terms.items() if acts[name]})


def start_memory(parameters, like, key=None) -> dict:
    """Return what the effects remember at first, by name, in arrays shaped as `like` (...); empty where none does."""
    remembering = having(parameters, "start")
    if not remembering:
        return {}
    keys = iter(jax.random.split(jax.random.key(0) if key is None else key, 64))
    zero, count = jnp.zeros_like(like), parameters.rotors.spin.shape[-1]

    def normal():
        return jax.random.normal(next(keys), zero.shape, zero.dtype)

    memory = {name: start(own, zero, normal, count) for name, start, own in remembering}
    if any(PHYSICS[name].randoms for name in memory):
        memory[NOISE] = noise.start(next(keys), zero.shape)
    return memory


def check_memory(memory: dict, parameters) -> None:
    """Raise UsageError when a state lacks what an effect must remember: it was made without the parameters."""
    for name, _, _ in having(parameters, "start"):
        if name not in memory:
            raise UsageError(f"a state without '{name}' cannot fly with that term; make it with the parameters given")


def advance_memory(memory: dict, passed, parameters) -> dict:
    """Return what the effects remember after a step; `passed.random` is filled for each."""
    moved = dict(memory)
    for name, advance, own in having(parameters, "advance"):
        randoms = PHYSICS[name].randoms
        if randoms:
            count = randoms(len(passed.instant.rotor_speed))
            passed = passed.drawing(noise.white(memory[NOISE], salt(name), count, passed.power_w.dtype))
        moved[name] = kept(advance(memory[name], passed, own, parameters), parameters)
    if NOISE in memory:
        moved[NOISE] = noise.advance(memory[NOISE])
    return moved


def air_velocity(p_world: Vector, memory: dict, parameters) -> Vector:
    """Return the velocity of the air (world, m/s) at a position."""
    velocity = ZERO
    for name, air, own in having(parameters, "air"):
        velocity = add(velocity, air(p_world, own, memory.get(name)))
    return velocity


def motor_factors(memory: dict, parameters) -> list[tuple]:
    """Return for each effect on the motors n factors of their steady speeds."""
    count = parameters.rotors.spin.shape[-1]
    return [motor(own, memory.get(name), count) for name, motor, own in having(parameters, "motor")]


def towed(specific_force_world: Vector, memory: dict, parameters) -> Vector:
    """Return what hangs on the vehicle gives it (world, m/s^2), given what all other forces but gravity do."""
    pull = ZERO
    for name, tow, own in having(parameters, "tow"):
        pull = add(pull, tow(specific_force_world, own, memory.get(name), parameters))
    return pull


def wrench_at(instant: Instant, parameters) -> tuple[Vector, Vector]:
    """Return (force, moment) Vectors (body frame) of thrust and of every term that the parameters switch on."""
    at_hubs = rotors.thrust_forces(instant)
    for _, hubs, own in having(parameters, "hubs"):
        at_hubs = tuple(map(add, at_hubs, hubs(instant, own)))
    force, moment = wrench_of(kept(at_hubs, parameters), instant.hubs)
    moment = add(rotors.reaction(instant), moment)
    for _, wrench_term, own in having(parameters, "wrench"):
        more_force, more_moment = wrench_term(instant, own, parameters)
        force, moment = add(force, more_force), add(moment, more_moment)
    return force, moment


def wrench(motion: Motion, parameters, memory=None):
    """Return (force_body, moment_body) (..., 3) of thrust and of every term that the parameters switch on.

    Without `memory` (see `start_memory`) effects that remember act by their mean: no gust, buffet or vibration.
    """
    instant = instant_of(motion, parameters, memory)
    return tuple(stack(part, like=instant.collective) for part in wrench_at(instant, parameters))
