"""A flight in which every effect of the physics can be planted, and the search that finds one coefficient again.

One program holds all effects, each idle until its coefficients are planted: compiling costs more than flying, and what
is flown are batches, one member a coefficient.
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
IDLE = {  # every term, doing nothing
    "rotor_drag": {"k_d": 0.0},
    "linear_drag": {"c": [0.0, 0.0, 0.0]},
    "body_drag": {"c": [0.0, 0.0, 0.0]},
    "drag_center": {"position": [0.0, 0.0, 0.0]},
    "lift_cross": {},
    "flapping_moment": {"k_f": 0.0},
    "aerodynamic_polynomial": {},
    "axial_inflow": {"k_z": 0.0},
    "translational_lift": {"k_h": 0.0},
    "ground_effect": {"k": 0.0},
    "vortex_ring": {"loss": 0.0},
    "thrust_axis_tilt": {"tilt": [0.0, 0.0]},
    "rotor_gyroscopic": {"inertia": 0.0},
    "rotor_gain": {"gain": [0.0, 0.0, 0.0, 0.0]},
    "motor_heat": {"speed_loss": 0.0},
    "slung_load": {"mass": 0.0, "length": 0.3},
    "wind": {"velocity": [0.0, 0.0, 0.0]},
    "gust": {"wind_20ft": 0.0},
    "local_draught": {"center": [0.5, 0.0, 3.0], "radius": 6.0, "velocity": [0.0, 0.0, 0.0]},
    "com_offset": {"position": [0.0, 0.0, 0.0]},
    "payload": {"mass": 0.0},
    "damaged_propeller": {"rotor": 2, "loss": 0.0},
    "command_latency": {"delay": 0.0},
    "dropped_commands": {"share": 0.0},
    "throttle_curve": {},
    "rate_scale": {},
}
RICH_PACK = {
    "open_circuit_curve": (16.8, 16.2, 15.8, 15.5, 14.9),
    "rc2_resistance": 0.004,
    "rc2_time": 0.3,
    "energy": 500.0,
    "temperature": 15.0,
    "temperature_slope": -0.01,
    "heat_capacity": 2.0,
}
DRAG = {"body_drag": {"c": [0.02, 0.03, 0.04]}}
PLANTED = {  # one story each: what is planted, and beside it what the effect needs to show
    "rotor_drag": {"rotor_drag": {"k_d": 6e-5}},
    "linear_drag": {"linear_drag": {"c": [0.2, 0.3, 0.1]}},
    "body_drag": DRAG,
    "drag_center": {"drag_center": {"position": [0.004, -0.006, 0.01]}, **DRAG},
    "lift_cross": {"lift_cross": {"a": 0.01, "b": -0.02}},
    "flapping_moment": {"flapping_moment": {"k_f": 1e-6}},
    "aerodynamic_polynomial": {
        "aerodynamic_polynomial": {
            "f_x": [-0.1, -0.01, 1e-8, -6e-8],
            "f_y": [-0.1, -0.01, -1e-8, -7e-8],
            "f_z": [-0.1, -0.02, 0.05, 0.01, 2e-8, -9e-8, 5e-9],
            "tau_x": [0.002, 1e-4, 1e-9, 2e-9, 1e-10],
            "tau_y": [-0.002, 1e-4, -1e-9, 3e-9, 1e-10],
            "tau_z": [1e-4, -2e-4],
        }
    },
    "axial_inflow": {"axial_inflow": {"k_z": 6e-5}},
    "translational_lift": {"translational_lift": {"k_h": 5e-3, "saturation": 9.0}},
    "ground_effect": {"ground_effect": {"k": 2.0}},
    "vortex_ring": {"vortex_ring": {"loss": 0.3}},
    "thrust_axis_tilt": {"thrust_axis_tilt": {"tilt": [0.02, -0.01]}},
    "rotor_gyroscopic": {"rotor_gyroscopic": {"inertia": 1e-5}},
    "rotor_gain": {"rotor_gain": {"gain": [0.02, -0.03, 0.04, 0.01]}},
    "motor_heat": {"motor_heat": {"speed_loss": 4e-4, "warming": 0.2, "time_constant": 20.0}},
    "slung_load": {"slung_load": {"mass": 0.03, "length": 0.2, "damping": 0.5}},
    "wind": {"wind": {"velocity": [3.0, -2.0, 0.5]}, **DRAG},
    "local_draught": {
        "local_draught": {"center": [0.5, 0.3, 3.0], "radius": 6.0, "velocity": [2.0, -3.0, 1.0]},
        **DRAG,
    },
    "com_offset": {"com_offset": {"position": [0.003, -0.002, 0.005]}, "rotor_drag": {"k_d": 6e-5}},
    "payload": {"payload": {"mass": 0.05, "position": [0.03, -0.02, 0.04]}},
    "damaged_propeller": {"damaged_propeller": {"rotor": 2, "loss": 0.1, "imbalance": 2e-6}},
    "throttle_curve": {"throttle_curve": {"gain": 0.05, "curve": -0.1}},
    "rate_scale": {
        "rate_scale": {"scale": [1.05, 0.95, 0.9], "offset": [0.1, -0.05, 0.02], "cubic": [1e-3, -2e-3, 3e-3]}
    },
}
KNOWN = {("terms", "damaged_propeller", "rotor")}  # a number, not a size
ORDINARY = {  # the vehicle file's other keys, planted as they are
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
}
FAST = {"p_world": [0.0, 0.0, 3.0], "v_world": [6.0, -4.0, 2.0]}


@cache
def everything():
    """Return the shipped vehicle with every term idle and a pack with everything that a pack can have."""
    return replace(shipped(), terms=IDLE, battery=replace(shipped().battery, **RICH_PACK))


def commands():
    """Return rates (ticks, 3) rad/s and throttle (ticks,) that shake all axes."""
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


def paths_of(story: str) -> list[tuple]:
    """Return the paths of the coefficients that a story plants and finds."""
    if story in ORDINARY:
        return ORDINARY[story]
    base = parameters_from_vehicle(everything())
    found = []
    for key, value in PLANTED[story][story].items():
        for index in np.ndindex(np.shape(value)):
            found.append(("terms", story, key, *index))
    assert all(path[2] in vars(base.terms[path[1]]) for path in found)
    return [path for path in found if path not in KNOWN]


def fly(rows, stories):
    """Return what is seen (n, ticks, channels) of flights with values {path: value} planted in each row."""
    base = parameters_from_vehicle(everything())
    count = len(rows)
    full = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *leaf.shape)).copy(), base)
    for i, row in enumerate(rows):
        for path, value in row.items():
            leaf, index = _leaf(full, path)
            leaf[(i, *index)] = value
    places = [{**FAST, **START.get(story, {})} for story in stories]
    start = {key: np.array([place[key] for place in places]) for key in FAST}
    return np.asarray(_flown(full, start))


def _leaf(tree, path):
    for depth, name in enumerate(path):
        tree = tree[name] if isinstance(tree, dict) else getattr(tree, name)
        if isinstance(tree, np.ndarray):
            return tree, path[depth + 1 :]
    raise KeyError(path)


def _context(story: str) -> dict:
    """Return {path: value} of all that a story plants."""
    values = {}
    for name, entry in PLANTED.get(story, {}).items():
        for key, value in entry.items():
            for index in np.ndindex(np.shape(value)):
                values[("terms", name, key, *index)] = np.asarray(value)[index]
    return values


def _value(path) -> float:
    leaf, index = _leaf(jax.tree.map(np.asarray, parameters_from_vehicle(everything())), path)
    return float(leaf[index])


def fly_without_terms():
    """Return what is seen of (a flight with every term idle, the same without any)."""
    bare = parameters_from_vehicle(replace(everything(), terms={}))
    start = {key: np.array([value]) for key, value in FAST.items()}
    return fly([{}], ["mass"])[0], np.asarray(_flown(jax.tree.map(lambda leaf: leaf[None], bare), start))[0]


@cache
def found_again(rounds: int = 5) -> dict:
    """Return {story: {path: found / planted}}: each coefficient sought alone, from 20 % off, by Gauss-Newton steps."""
    tasks = [(story, path) for story in (*PLANTED, *ORDINARY) for path in paths_of(story)]
    stories = [story for story, _ in tasks]
    contexts = [_context(story) for story in stories]
    truth = np.array(
        [context.get(path, None) or _value(path) for context, (_, path) in zip(contexts, tasks, strict=True)]
    )
    seen = fly(_rows(contexts, tasks, truth), stories)
    guess = 0.8 * truth
    for _ in range(rounds):
        now = fly(_rows(contexts, tasks, guess), stories)
        slope = fly(_rows(contexts, tasks, guess + 1e-5 * truth), stories) - now
        size = np.sum(slope * slope, axis=(1, 2))
        assert np.all(size > 1e-20), [task for task, s in zip(tasks, size, strict=True) if s <= 1e-20]
        guess = guess + 1e-5 * truth * np.clip(np.sum(slope * (seen - now), axis=(1, 2)) / size, -5e4, 5e4)
    result = {}
    for (story, path), share in zip(tasks, guess / truth, strict=True):
        result.setdefault(story, {})[path] = share
    return result


def _rows(contexts, tasks, values):
    return [{**context, path: value} for context, (_, path), value in zip(contexts, tasks, values, strict=True)]
