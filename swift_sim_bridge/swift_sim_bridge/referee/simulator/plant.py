"""The referee's own quadrotor: its equations of motion, written from the vehicle file's contract and the effects'
equations, independently of the production simulator.

    m dv/dt = R (F_hubs + F_body) - m g e_z,     J dw/dt = M - w x J w,     tau dOmega/dt = Omega_ss(u, U) - Omega
    F_i = [T_i (1 + ground - ring - stall) - k_z Omega_i v_iz + k_h v_ixy^2 / (1 + v_ixy^2/s^2)] e_z
          + T_i (e_y, -e_x, 0) - k_d Omega_i (v_ix, v_iy, 0),     T_i = c_l Omega_i^2,     v_i = v + w x r_i
    F_body = -c v - c2 |v| v + (a v_x v_z, a v_y v_z, b v_xy v_z)
    M = sum (r_i x F_i - s_i c_d Omega_i^2 e_z + k_f Omega_i (v_iy, -v_ix, 0)) + r_cp x F_drag - w x h - dh/dt

v is the velocity through the air in the body frame. Rotors and battery are integrated with the body; only the motor
commands, the gusts and the process noise are constant during a step. Numbers are arrays with any trailing batch;
vectors are tuples of three such arrays, in SI units.
"""

from collections.abc import Iterable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.referee.simulator import blind, polynomial, strange
from swift_sim_bridge.referee.simulator.vectors import (
    add,
    cross,
    dot,
    parts,
    product,
    rotate,
    rotate_back,
    scale,
    subtract,
    times,
)

GRAVITY = 9.80665  # m/s^2, standard gravity
AIR_DENSITY = 1.225  # kg/m^3 at sea level and 15 deg C (ISO 2533)
IDLE_TERMS = {  # coefficients with which a term of the vehicle file does nothing
    "rotor_drag": {"k_d": 0.0},
    "linear_drag": {"c": [0.0, 0.0, 0.0]},
    "body_drag": {"c": [0.0, 0.0, 0.0]},
    "drag_center": {"position": [0.0, 0.0, 0.0]},
    "lift_cross": {"a": 0.0, "b": 0.0},
    "flapping_moment": {"k_f": 0.0},
    "axial_inflow": {"k_z": 0.0},
    "translational_lift": {"k_h": 0.0, "saturation": 0.0},
    "propeller_stall": {"slope": 0.0, "onset": 0.1},
    "ground_effect": {"k": 0.0},
    "vortex_ring": {"loss": 0.0, "buffet": 0.0, "bandwidth": 10.0},
    "thrust_axis_tilt": {"tilt": [0.0, 0.0]},
    "rotor_gyroscopic": {"inertia": 0.0},
    "wind": {"velocity": [0.0, 0.0, 0.0]},
    "local_draught": {"center": [0.0, 0.0, 0.0], "radius": 1.0, "velocity": [0.0, 0.0, 0.0]},
}


class State(NamedTuple):
    """State of the vehicle.

    Attributes:
        p: Position, m, world.
        q: Quaternion (x, y, z, w) that rotates body vectors into the world.
        v: Velocity, m/s, world.
        w: Angular velocity, rad/s, body.
        rotor_speed: Speed of each rotor, rad/s.
        charge: Charge drawn from the battery, A s.
        rc: Voltage of the battery's RC element, V.
        memory: Of the laws in `blind`; empty for a vehicle without them.
    """

    p: tuple
    q: tuple
    v: tuple
    w: tuple
    rotor_speed: tuple
    charge: object
    rc: object
    memory: tuple = ()


class Inputs(NamedTuple):
    """Inputs that are constant during a step.

    Attributes:
        u: Command of each motor, 0 to 1.
        gust: Velocity of the air, m/s, world.
        force_noise: Process noise, m/s^2, world.
        moment_noise: Process noise, rad/s^2, body.
        ring_noise: Noise of each rotor's vortex ring.
    """

    u: tuple
    gust: tuple
    force_noise: tuple
    moment_noise: tuple
    ring_noise: tuple


class Outputs(NamedTuple):
    """Quantities that instruments measure and that are not part of the state.

    Attributes:
        specific_force: m/s^2, body.
        angular_acceleration: rad/s^2, body.
        voltage: Of the battery, V.
        current: Of the battery, A.
    """

    specific_force: tuple
    angular_acceleration: tuple
    voltage: object
    current: object


def plant_of(content: dict, summands: dict | None = None, among: Iterable[dict] = ()) -> dict:
    """Return the parameters of the equations of motion for a vehicle file's content: arrays by name.

    Args:
        content: the content; physics without a name stands in its keys `strange` and `blind`, see these modules.
        summands: of an equation, see `polynomial.summands_of`; None for no equation.
        among: contents of vehicles that fly in the same call, all of which have the laws of `blind` if one has any: no
            other flight pays for them.
    """
    count, given = len(content["rotors"]), content.get("terms", {})
    lift = np.full(count, content["thrust_coefficient"])
    if "damaged_propeller" in given:
        lift[given["damaged_propeller"]["rotor"] - 1] *= 1.0 - given["damaged_propeller"]["loss"]
    motor, battery = content["motor"], content["battery"]
    plant = _body_of(content) | {
        "turn": np.array([rotor["spin"] for rotor in content["rotors"]], dtype=float),
        "lift": lift,
        "torque": content["torque_coefficient"],
        "radius": content["rotor_radius"],
        "speed_range": np.asarray(content["rotor_speed_range"], dtype=float),
        "tau_up": motor["time_constant_up"],
        "tau_down": motor["time_constant_down"],
        "map": np.asarray(motor["map"]["coefficients"], dtype=float),
        "gain": np.asarray(given.get("rotor_gain", {}).get("gain", [0.0] * count), dtype=float),
        "battery": {
            name: battery[name]
            for name in (
                "open_circuit_full",
                "open_circuit_slope",
                "capacity",
                "resistance",
                "rc_resistance",
                "rc_time",
                "efficiency",
                "avionics_w",
            )
        },
    }
    plant["strange"] = strange.IDLE | content.get("strange", {})
    plant["blind"] = blind.parameters_of(content) if blind.any_in((content, *among)) else {}
    plant["equation"] = polynomial.coefficients_of(content, summands or {})
    for name, idle in IDLE_TERMS.items():
        plant[name] = idle | given.get(name, {})
    return plant


def _body_of(content: dict) -> dict:
    """Return mass, inertia with its inverse, and rotor positions from the centre of mass, with load and offset."""
    given, mass, inertia = content.get("terms", {}), content["mass"], np.asarray(content["inertia"], dtype=float)
    inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
    position = np.array([rotor["position"] for rotor in content["rotors"]], dtype=float)
    if "payload" in given:
        load, at = given["payload"]["mass"], np.asarray(given["payload"].get("position", [0.0] * 3), dtype=float)
        centre = load / (mass + load) * at
        for m, r in ((mass, -centre), (load, at - centre)):  # parallel axis theorem about the common centre of mass
            inertia = inertia + m * (r @ r * np.eye(3) - np.outer(r, r))
        mass, position = mass + load, position - centre
    if "com_offset" in given:
        position = position - np.asarray(given["com_offset"]["position"], dtype=float)
    return {"mass": mass, "inertia": inertia, "inverse": np.linalg.inv(inertia), "position": position}


def derivative(state: State, inputs: Inputs, plant: dict) -> tuple[State, Outputs]:
    """Return the state's time derivative and the outputs."""
    count = range(len(state.rotor_speed))
    voltage, current = supply(state, plant)
    target = [(1.0 + plant["gain"][i]) * steady_speed(inputs.u[i], voltage, plant) for i in count]
    if "rotor_speed" in plant["equation"]:
        target = [target[i] + _added_speed(i, inputs.u[i], voltage, state.rotor_speed, plant) for i in count]
    tau = [jnp.where(target[i] > state.rotor_speed[i], plant["tau_up"], plant["tau_down"]) for i in count]
    spin_up = tuple((target[i] - state.rotor_speed[i]) / tau[i] for i in count)
    if plant["blind"]:
        spin_up = tuple(spin_up[i] - blind.speed_loss(state.rotor_speed[i], i, plant) for i in count)
    air = add(add(parts(plant["wind"]["velocity"]), local_wind(state.p, plant["local_draught"])), inputs.gust)
    v = rotate_back(state.q, subtract(state.v, air))
    force, moment = wrench(state, v, spin_up, inputs.ring_noise, plant)
    specific = add(scale(1.0 / plant["mass"], force), rotate_back(state.q, inputs.force_noise))
    coriolis = cross(state.w, times(plant["inertia"], state.w))
    angular_acceleration = add(times(plant["inverse"], subtract(moment, coriolis)), inputs.moment_noise)
    x, y, z = rotate(state.q, specific)
    battery, outputs = plant["battery"], Outputs(specific, angular_acceleration, voltage, current)
    slope = State(
        p=state.v,
        q=tuple(0.5 * part for part in product(state.q, (*state.w, 0.0))),
        v=(x, y, z - GRAVITY),
        w=angular_acceleration,
        rotor_speed=spin_up,
        charge=current,
        rc=(current * battery["rc_resistance"] - state.rc) / battery["rc_time"],
        memory=blind.memory_rate(state.memory, v, state.w, outputs, plant) if plant["blind"] else (),
    )
    return slope, outputs


def supply(state: State, plant: dict):
    """Return the battery's voltage and current under the rotors' load: U^2 - E U + R P = 0, I = P / U."""
    b = plant["battery"]
    power = sum(plant["torque"] * jnp.abs(spin) ** 3 for spin in state.rotor_speed) / b["efficiency"] + b["avionics_w"]
    source = b["open_circuit_full"] - b["open_circuit_slope"] * state.charge / b["capacity"] - state.rc
    voltage = 0.5 * (source + jnp.sqrt(jnp.maximum(source**2 - 4.0 * b["resistance"] * power, 0.0)))
    if "voltage" in plant["equation"]:
        load = polynomial.of_pack(power / voltage, state.charge, state.rotor_speed)
        voltage = voltage + polynomial.added(load, plant["equation"]["voltage"])
    if plant["blind"]:
        voltage = voltage - blind.voltage_loss(state.memory, voltage, power / voltage, plant)
    return voltage, power / voltage


def _added_speed(i: int, u, voltage, speeds, plant: dict):
    """Return what the equation of a repaired vehicle file adds to the steady speed of motor i, rad/s."""
    drive = polynomial.of_motor(u, voltage, speeds[i], i + 1, len(speeds))
    added = polynomial.added(drive, plant["equation"]["rotor_speed"])
    return jnp.where(u > 0, added, 0.0)


def steady_speed(u, voltage, plant: dict):
    """Return the speed that a motor reaches under command u, by the vehicle file's map, within its range."""
    c, (low, high) = plant["map"], plant["speed_range"]
    root = jnp.sqrt(jnp.maximum(u, 0.0))
    speed = c[0] + c[1] * voltage + c[2] * root + c[3] * u + c[4] * voltage * root
    return jnp.where(u > 0, jnp.clip(speed, low, high), 0.0)


def local_wind(p, entry: dict):
    """Return the wind of a local draught: (1 - d^2/radius^2)^2 times its velocity at a distance d within its radius."""
    apart = subtract(p, parts(entry["center"]))
    share = jnp.maximum(1.0 - dot(apart, apart) / entry["radius"] ** 2, 0.0)
    return scale(share**2, parts(entry["velocity"]))


def wrench(state: State, v, spin_up, ring, plant: dict):
    """Return force and moment (body) about the centre of mass at airspeed v."""
    force, moment, momentum, momentum_rate = (0.0,) * 3, (0.0,) * 3, 0.0, 0.0
    for i, spin in enumerate(state.rotor_speed):
        r, way = parts(plant["position"][i]), plant["turn"][i]
        at_hub = add(v, cross(state.w, r))
        push = hub_force(spin, at_hub, height(state, r), plant["lift"][i], ring[i], plant)
        static = plant["lift"][i] * spin**2
        induced = jnp.sqrt(static / (2.0 * AIR_DENSITY * jnp.pi * plant["radius"] ** 2) + 1e-6)
        push = (push[0], push[1], push[2] + strange.hub_gain(static, spin, at_hub, state.p, induced, plant))
        if more := plant["equation"].get("rotor_thrust"):
            own = polynomial.of_rotor(static, spin, at_hub, height(state, r), state.p, plant["radius"])
            push = (push[0], push[1], push[2] + polynomial.added(own, more))
        flap = plant["flapping_moment"]["k_f"] * spin
        force = add(force, push)
        moment = add(moment, cross(r, push))
        moment = add(moment, (flap * at_hub[1], -flap * at_hub[0], -way * plant["torque"] * spin**2))
        momentum = momentum + plant["rotor_gyroscopic"]["inertia"] * way * spin
        momentum_rate = momentum_rate + plant["rotor_gyroscopic"]["inertia"] * way * spin_up[i]
    drag = body_drag(v, plant)
    moment = add(moment, cross(parts(plant["drag_center"]["position"]), drag))
    moment = subtract(moment, cross(state.w, (0.0, 0.0, momentum)))
    moment = subtract(moment, (0.0, 0.0, momentum_rate))
    a, b = plant["lift_cross"]["a"], plant["lift_cross"]["b"]
    across = jnp.sqrt(v[0] ** 2 + v[1] ** 2)
    lift = (a * v[0] * v[2], a * v[1] * v[2], b * across * v[2])
    force = add(force, add(drag, lift))
    for more_force, more_moment in _without_a_name(state, v, spin_up, plant):
        force, moment = add(force, more_force), add(moment, more_moment)
    return force, moment


def _without_a_name(state: State, v, spin_up, plant: dict):
    """Yield force and moment (body) of physics without a name, and of the equation of a repaired vehicle file."""
    yield strange.wrench(v, plant)
    if plant["blind"]:
        yield blind.wrench(state.memory, v, state.w, state.rotor_speed, plant)
    yield _equation(state, v, spin_up, plant)


def _equation(state: State, v, spin_up, plant: dict):
    """Return force and moment (body) of the equation of a repaired vehicle file."""
    if not plant["equation"]:
        return (0.0,) * 3, (0.0,) * 3
    one = 0.0 * v[0] + 1.0
    axes = [rotate_back(state.q, tuple(one if i == k else 0.0 * one for i in range(3))) for k in range(3)]
    rotors = {"speed": state.rotor_speed, "rate": spin_up, "spin": parts(plant["turn"])}
    at = polynomial.quantities(state.p, axes, v, state.w, rotors, plant)
    return polynomial.wrench(at, plant["equation"])


def hub_force(spin, v, h, lift, ring, plant: dict):
    """Return the force (body) of one rotor at hub velocity v and height h over the ground."""
    thrust, lateral = lift * spin**2, v[0] ** 2 + v[1] ** 2
    reach = 0.25 * plant["radius"] / jnp.maximum(h, 0.5 * plant["radius"])
    near = jnp.minimum(plant["ground_effect"]["k"] * reach**2, 0.9)
    up = thrust * (1.0 + near / (1.0 - near) - ring_loss(spin, v, lateral, lift, ring, plant))
    up = up - thrust * stall_loss(spin, lateral, plant)
    up = up - plant["axial_inflow"]["k_z"] * spin * v[2]
    gain = plant["translational_lift"]
    saturating = jnp.where(gain["saturation"] > 0, lateral / jnp.maximum(gain["saturation"], 1e-3) ** 2, 0.0)
    up = up + gain["k_h"] * lateral / (1.0 + saturating)
    drag, tilt = -plant["rotor_drag"]["k_d"] * spin, plant["thrust_axis_tilt"]["tilt"]
    return (drag * v[0] + thrust * tilt[1], drag * v[1] - thrust * tilt[0], up)


def ring_loss(spin, v, lateral, lift, ring, plant: dict):
    """Return the share of thrust that a rotor loses in its own vortex ring.

    It is largest at a sink speed of 0.9 of the induced velocity in hover, zero outside 0.3 to 1.5, and decreases with
    the lateral airspeed.
    """
    induced = jnp.sqrt(lift / (2.0 * AIR_DENSITY * jnp.pi * plant["radius"] ** 2)) * (jnp.abs(spin) + 1.0)
    inside = jnp.maximum(1.0 - ((v[2] / induced + 0.9) / 0.6) ** 2, 0.0) ** 2
    fresh = jnp.maximum(1.0 - lateral / induced**2, 0.0)
    return (plant["vortex_ring"]["loss"] - plant["vortex_ring"]["buffet"] * ring) * inside * fresh


def stall_loss(spin, lateral, plant: dict):
    """Return the share of thrust, at most 0.9, that a rotor loses above an advance ratio: slope (mu - onset)."""
    stall, tip = plant["propeller_stall"], jnp.maximum(jnp.abs(spin) * plant["radius"], 1.0)
    return jnp.clip(stall["slope"] * (jnp.sqrt(lateral + 1e-12) / tip - stall["onset"]), 0.0, 0.9)


def body_drag(v, plant: dict):
    """Return the drag (body) of the airframe, linear and quadratic in each axis."""
    speed = jnp.sqrt(dot(v, v))
    linear, quadratic = plant["linear_drag"]["c"], plant["body_drag"]["c"]
    return tuple(-(linear[i] + quadratic[i] * speed) * v[i] for i in range(3))


def height(state: State, r):
    """Return z in the world of a point r of the body."""
    return state.p[2] + rotate(state.q, r)[2]
