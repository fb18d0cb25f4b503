"""The terms of the physics: which a vehicle file switches on, and the sums of what they do.

Every module of this package may have a table `TERMS` of its terms by name (see `term.Term`); `PHYSICS` collects them.
A new term is one new module, or one more row in the table of the module where it belongs.
"""

import importlib
import pkgutil
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.configuration import build
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import refuse_unknown_terms
from swift_sim_bridge.physics import terms as package
from swift_sim_bridge.physics.terms import noise, rotors
from swift_sim_bridge.physics.terms.motion import Instant, Motion, instant_of, wrench_of
from swift_sim_bridge.physics.terms.quantities import Drive, Load
from swift_sim_bridge.physics.terms.term import Term, salt
from swift_sim_bridge.physics.terms.vectors import ZERO, Vector, add, kept, plus, stack, total

FLIGHT_HOOKS = (
    "hubs",
    "wrench",
    "air",
    "motor",
    "steady_speed",
    "supply",
    "tow",
    "advance",
)  # functions that act during flight
NOISE = "noise"  # key of the random streams in the terms' memory


def _collected() -> dict[str, Term]:
    """Return the terms of all modules of this package, in alphabetical order of the modules.

    Raises ValueError for a name that stands in two modules.
    """
    found: dict[str, Term] = {}
    for module in sorted(info.name for info in pkgutil.iter_modules(package.__path__)):
        if f"{package.__name__}.{module}" == __name__:
            continue
        terms = getattr(importlib.import_module(f"{package.__name__}.{module}"), "TERMS", {})
        if repeated := sorted(found.keys() & terms):
            raise ValueError(f"the term '{repeated[0]}' of {module} stands in another module as well")
        found |= terms
    return found


PHYSICS = _collected()


def coefficients_from_vehicle(vehicle: Vehicle) -> dict:
    """Return the coefficients by name of the vehicle's terms without those of its sensors.

    Raises UsageError for an unknown name or coefficient.
    """
    refuse_unknown_terms(vehicle)
    built = {name: _built(name, entry, vehicle) for name, entry in vehicle.terms.items() if name in PHYSICS}
    return jax.tree.map(np.asarray, built, is_leaf=lambda leaf: isinstance(leaf, tuple))  # a vector is one leaf


def _built(name: str, entry, vehicle: Vehicle):
    """Return the checked coefficients of an entry. Raises UsageError for a wrong one."""
    where = f"the vehicle '{vehicle.name}', terms.{name}"
    coefficients = build(PHYSICS[name].coefficients, entry, where)
    check = PHYSICS[name].check
    if check:
        try:
            check(coefficients, vehicle)
        except ValueError as error:
            raise UsageError(f"{where} {error}") from error
    return coefficients


def terms_with(parameters, hook: str):
    """Return [(name, function, coefficients)] of the parameters' terms that have the function `hook` of `Term`."""
    rows = ((name, getattr(PHYSICS[name], hook), own) for name, own in parameters.terms.items())
    return [row for row in rows if row[1]]


def with_airframe(parameters):
    """Return the parameters after the changes by their airframe terms."""
    for _, change, own in terms_with(parameters, "airframe"):
        parameters = change(parameters, own)
    return parameters


def with_flight_terms(parameters):
    """Return the parameters without the terms that only change the airframe or the commands.

    Where no commands are sent, vehicles with and without such terms then share one compiled program.
    """
    acts = {name: any(getattr(PHYSICS[name], hook) for hook in FLIGHT_HOOKS) for name in parameters.terms}
    return replace(parameters, terms={name: own for name, own in parameters.terms.items() if acts[name]})


def start_memory(parameters, like, key=None) -> dict:
    """Return the first memory of the terms by name, in arrays shaped as `like` (...); empty where none has a memory.

    Args:
        parameters: of the vehicle.
        like: an array (...) of the batch's shape and type.
        key: of the random numbers; a fixed one where None.
    """
    with_memory = terms_with(parameters, "start")
    if not with_memory:
        return {}
    keys = iter(jax.random.split(jax.random.key(0) if key is None else key, 64))
    zero, count = jnp.zeros_like(like), parameters.rotors.spin.shape[-1]

    def normal():
        return jax.random.normal(next(keys), zero.shape, zero.dtype)

    memory = {name: start(own, zero, normal, count) for name, start, own in with_memory}
    if any(PHYSICS[name].randoms for name in memory):
        memory[NOISE] = noise.start(next(keys), zero.shape)
    return memory


def check_memory(memory: dict, parameters) -> None:
    """Raise UsageError when a state lacks the memory of a term: it was made without the parameters."""
    for name, _, _ in terms_with(parameters, "start"):
        if name not in memory:
            raise UsageError(f"a state without '{name}' cannot fly with that term; make it with the parameters given")


def advance_memory(memory: dict, step, parameters) -> dict:
    """Return the terms' memory after a `motion.CompletedStep`, with random numbers drawn for each term."""
    moved = dict(memory)
    for name, advance, own in terms_with(parameters, "advance"):
        randoms = PHYSICS[name].randoms
        if randoms:
            count = randoms(len(step.instant.rotor_speed))
            step = step.with_random(noise.white(memory[NOISE], salt(name), count, step.power_w.dtype))
        moved[name] = kept(advance(memory[name], step, own, parameters), parameters)
    if NOISE in memory:
        moved[NOISE] = noise.advance(memory[NOISE])
    return moved


def air_velocity(p_world: Vector, memory: dict, parameters) -> Vector:
    """Return the velocity of the air (world, m/s) at a position."""
    velocity = ZERO
    for name, air, own in terms_with(parameters, "air"):
        velocity = add(velocity, air(p_world, own, memory.get(name)))
    return velocity


def motor_factors(memory: dict, parameters) -> list[tuple]:
    """Return n factors of the motors' steady speeds for each term that changes them."""
    count = parameters.rotors.spin.shape[-1]
    return [motor(own, memory.get(name), count) for name, motor, own in terms_with(parameters, "motor")]


def added_speeds(speeds, motor_commands, voltage, parameters) -> tuple:
    """Return what the terms add to the motors' n steady speeds (...) rad/s; plain zeros where none does.

    Args:
        speeds: n present speeds (...) rad/s.
        motor_commands: n of (...), 0 to 1.
        voltage: (...) V.
        parameters: of the vehicle.
    """
    added = (0.0,) * len(speeds)
    for _, steady_speed, own in terms_with(parameters, "steady_speed"):
        rows = enumerate(zip(motor_commands, speeds, strict=True), start=1)
        drives = (Drive(u, voltage, speed, number) for number, (u, speed) in rows)
        added = tuple(plus(sum_, steady_speed(own, drive)) for sum_, drive in zip(added, drives, strict=True))
    return added


def supply_voltage(load: Load, parameters):
    """Return what the terms add to the voltage (...) V of the pack; a plain zero where none does."""
    return total(supply(own, load) for _, supply, own in terms_with(parameters, "supply"))


def tow_acceleration(specific_force_world: Vector, memory: dict, parameters) -> Vector:
    """Return the acceleration (world, m/s^2) by attached loads, given the specific force of all other forces."""
    pull = ZERO
    for name, tow, own in terms_with(parameters, "tow"):
        pull = add(pull, tow(specific_force_world, own, memory.get(name), parameters))
    return pull


def wrench_at(instant: Instant, parameters) -> tuple[Vector, Vector]:
    """Return (force, moment) Vectors (body frame) of thrust, drag torque and every term of the parameters."""
    at_hubs = rotors.thrust_forces(instant)
    for _, hubs, own in terms_with(parameters, "hubs"):
        at_hubs = tuple(map(add, at_hubs, hubs(instant, own)))
    force, moment = wrench_of(kept(at_hubs, parameters), instant.hubs)
    moment = add(rotors.reaction(instant), moment)
    for _, wrench_term, own in terms_with(parameters, "wrench"):
        more_force, more_moment = wrench_term(instant, own, parameters)
        force, moment = add(force, more_force), add(moment, more_moment)
    return force, moment


def wrench(motion: Motion, parameters, memory=None):
    """Return (force_body, moment_body) (..., 3) of thrust, drag torque and every term of the parameters.

    Without `memory` (see `start_memory`) terms with a memory act by their mean: no gust, buffet or vibration.
    """
    instant = instant_of(motion, parameters, memory)
    return tuple(stack(part, like=instant.collective) for part in wrench_at(instant, parameters))
