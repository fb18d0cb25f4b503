"""A flight with any term of the physics at its example entry, and a search that recovers one coefficient.

One program has all terms, each idle until its coefficients are planted, because compiling takes longer than flying. It
flies a batch with one member for each coefficient.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from free_flight import profile
from free_flight import vehicle as shipped

from swift_ros import geometry
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.simulation import simulator

TICKS, TICK_S, SUBSTEPS = 40, 0.01, 5


def numbers(entry, keys: tuple = ()):
    """Yield (keys, value) of each number of an entry of `terms`; the ranges of an equation are no coefficients."""
    if isinstance(entry, dict):
        for key in entry.keys() - {"range"}:
            yield from numbers(entry[key], (*keys, key))
    else:
        yield from (((*keys, *index), np.asarray(entry)[index]) for index in np.ndindex(np.shape(entry)))


def without_effect(example: dict) -> dict:
    """Return an equation whose coefficients are zero."""
    return {
        side: {product: {**summand, "coefficient": 0.0} for product, summand in own.items()}
        for side, own in example.items()
    }


IDLE = {name: term.idle for name, term in registry.PHYSICS.items()}
IDLE["equation"] = without_effect(registry.PHYSICS["equation"].example)
RICH_PACK = {
    "open_circuit_curve": (16.8, 16.2, 15.8, 15.5, 14.9),
    "rc2_resistance": 0.004,
    "rc2_time": 0.3,
    "energy": 500.0,
    "temperature": 15.0,
    "temperature_slope": -0.01,
    "heat_capacity": 2.0,
}
EXAMPLES = {name: term.example for name, term in registry.PHYSICS.items()}
RANDOM = {"gust", "command_latency", "dropped_commands"}  # tested by their statistics
NEEDED = {  # terms without which another one has no effect on the flight
    "drag_center": ("body_drag",),
    "wind": ("body_drag",),
    "local_draught": ("body_drag",),
    "com_offset": ("rotor_drag",),
}
UNPLANTED = {"vortex_ring": ("buffet", "bandwidth")}  # random part of a term
PLANTED = {  # by term: the entries that are planted
    name: {
        name: {key: value for key, value in example.items() if key not in UNPLANTED.get(name, ())},
        **{other: EXAMPLES[other] for other in NEEDED.get(name, ())},
    }
    for name, example in EXAMPLES.items()
    if name not in RANDOM
}
KNOWN = {("terms", "damaged_propeller", "rotor")}  # an index, not a size
ORDINARY = {  # other keys of the vehicle file, at their values
    "mass": [("mass",)],
    "thrust_coefficient": [("rotors", "thrust_coefficient", i) for i in range(4)],
    "torque_coefficient": [("rotors", "torque_coefficient", i) for i in range(4)],
    "motor": [("motors", "time_constant_up"), ("motors", "time_constant_down")],
    "motor_map": [("motors", "map_coefficients", i) for i in (2, 3, 4)],
    "battery": [("battery", name) for name in ("resistance", "rc_resistance", "rc_time", "efficiency", "avionics_w")],
    "rich_battery": [("battery", "open_circuit_curve", 0), ("battery", "open_circuit_curve", 1)]
    + [("battery", name) for name in ("rc2_resistance", "rc2_time", "energy", "temperature_slope", "heat_capacity")],
}
START = {
    "ground_effect": {"p_world": [0.0, 0.0, 0.3], "v_world": [3.0, 1.0, 0.2]},
    "vortex_ring": {"v_world": [1.0, -1.0, -6.0]},
    "equation": {"v_world": [6.0, -4.0, -3.0]},
}
FAST = {"p_world": [0.0, 0.0, 3.0], "v_world": [6.0, -4.0, 2.0]}


@cache
def vehicle_with_idle_terms():
    """Return the shipped vehicle with every term idle and a pack with every optional key."""
    return replace(shipped(), terms=IDLE, battery=replace(shipped().battery, **RICH_PACK))


def commands():
    """Return rates (ticks, 3) rad/s and throttle (ticks,) that excite all axes."""
    t = TICK_S * np.arange(TICKS)
    rates = np.stack([4 * np.sin(25 * t), 3 * np.sin(19 * t + 1), 2.5 * np.sin(31 * t + 2)], axis=-1)
    return rates, 0.4 + 0.3 * np.sin(22 * t + 0.5)


@jax.jit
def _flown(parameters, start):
    parameters = registry.with_airframe(parameters)
    attitude = geometry.normalize(jnp.array([0.15, -0.2, 0.1, 1.0]))
    attitude = jnp.broadcast_to(attitude, (*start["p_world"].shape[:-1], 4))
    flight = simulator.initial_flight(start["p_world"], attitude, parameters=parameters)
    speeds = jnp.broadcast_to(jnp.array([1200.0, 1350.0, 1300.0, 1150.0]), attitude.shape)
    state = replace(flight.state, v_world=start["v_world"], rotor_speed=speeds)

    def tick(flight, command):
        rates, throttle = (jnp.broadcast_to(value, (len(attitude), *value.shape)) for value in command)
        frame = ReceiverFrame(rates, throttle, jnp.ones(len(attitude), bool))
        model = simulator.FlightModel(parameters, profile())
        flight, trace = simulator.advance(flight, frame, model, simulator.Stepping(SUBSTEPS))
        state = flight.state
        seen = (state.v_world, state.omega_body, 0.01 * state.rotor_speed, 10.0 * trace.voltage[-1][:, None])
        return flight, jnp.concatenate(seen, axis=-1)

    moves = tuple(jnp.asarray(value) for value in commands())
    return jnp.moveaxis(jax.lax.scan(tick, replace(flight, state=state), moves)[1], 0, 1)


def paths_of(name: str) -> list[tuple]:
    """Return the paths of the coefficients that are planted and recovered for a term or a section."""
    if name in ORDINARY:
        return ORDINARY[name]
    base = parameters_from_vehicle(vehicle_with_idle_terms())
    found = []
    for keys, _ in sorted(numbers(PLANTED[name][name]), key=str):
        found.append(("terms", name, *keys))
    assert all(path[2] in vars(base.terms[path[1]]) for path in found)
    return [path for path in found if path not in KNOWN]


def fly(rows, names):
    """Return the measurements (n, ticks, channels) of flights with values {path: value} planted in each row."""
    base = parameters_from_vehicle(vehicle_with_idle_terms())
    count = len(rows)
    full = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *leaf.shape)).copy(), base)
    for i, row in enumerate(rows):
        for path, value in row.items():
            leaf, index = _leaf(full, path)
            leaf[(i, *index)] = value
    places = [{**FAST, **START.get(name, {})} for name in names]
    start = {key: np.array([place[key] for place in places]) for key in FAST}
    return np.asarray(_flown(full, start))


def _leaf(tree, path):
    for depth, name in enumerate(path):
        tree = tree[name] if isinstance(tree, dict) else getattr(tree, name)
        if isinstance(tree, np.ndarray):
            return tree, path[depth + 1 :]
    raise KeyError(path)


def _context(name: str) -> dict:
    """Return {path: value} of all entries that are planted for a term."""
    values = {}
    for term, entry in PLANTED.get(name, {}).items():
        for keys, value in numbers(entry):
            values[("terms", term, *keys)] = value
    return values


def _value(path) -> float:
    leaf, index = _leaf(jax.tree.map(np.asarray, parameters_from_vehicle(vehicle_with_idle_terms())), path)
    return float(leaf[index])


def fly_without_terms():
    """Return the measurements of (a flight with every term idle, the same flight without terms)."""
    bare = parameters_from_vehicle(replace(vehicle_with_idle_terms(), terms={}))
    start = {key: np.array([value]) for key, value in FAST.items()}
    return fly([{}], ["mass"])[0], np.asarray(_flown(jax.tree.map(lambda leaf: leaf[None], bare), start))[0]


@cache
def recovered(rounds: int = 5) -> dict:
    """Return {term: {path: recovered / planted}}: one coefficient at a time, from 80 % of it, by Gauss-Newton steps."""
    tasks = [(name, path) for name in (*PLANTED, *ORDINARY) for path in paths_of(name)]
    names = [name for name, _ in tasks]
    contexts = [_context(name) for name in names]
    truth = np.array(
        [context.get(path, None) or _value(path) for context, (_, path) in zip(contexts, tasks, strict=True)]
    )
    seen = fly(_rows(contexts, tasks, truth), names)
    guess = 0.8 * truth
    for _ in range(rounds):
        now = fly(_rows(contexts, tasks, guess), names)
        slope = fly(_rows(contexts, tasks, guess + 1e-5 * truth), names) - now
        size = np.sum(slope * slope, axis=(1, 2))
        assert np.all(size > 1e-20), [task for task, s in zip(tasks, size, strict=True) if s <= 1e-20]
        guess = guess + 1e-5 * truth * np.clip(np.sum(slope * (seen - now), axis=(1, 2)) / size, -5e4, 5e4)
    result = {}
    for (name, path), share in zip(tasks, guess / truth, strict=True):
        result.setdefault(name, {})[path] = share
    return result


def _rows(contexts, tasks, values):
    return [{**context, path: value} for context, (_, path), value in zip(contexts, tasks, values, strict=True)]
