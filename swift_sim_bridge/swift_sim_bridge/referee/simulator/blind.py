"""Physics that no effect of the gap tool names, by someone who had not read the tool: five laws, three with memory.

bistable_wake       a blunt body's wake leans to one side, s, and stays there until a sideslip flips it:
                    F_y = -1/2 rho v_p^2 A s,  ds/dt = (v_p + 0.5 m/s) / l (g s - s^3 + tanh(v_p / v_c) (k slip + b))
                    with v_p = |(v_x, v_z)|, slip = v_y / sqrt(|v|^2 + 1 m^2/s^2), g = (v_p^2 - v_c^2) / (v_p^2 + v_c^2)
twisting_arm        an arm, soft in torsion, twists by a = a_max tanh(tau / (K a_max)); the thrust tilts with it, which
                    yaws the vehicle; tau = gyroscopic moment of the arm's rotor, along the arm, + e T
sliding_battery     a pack that slides by x within its slack, held by friction: M_y = (m_b / m) x T,
                    dx/dt = mobility times what the pull along x exceeds the friction by
arm_resonance       an unbalanced rotor shakes its arm, which takes power from it (Sommerfeld effect):
                    dOmega_i/dt -= p_i 4 z^2 r^5 / ((1 - r^2)^2 + 4 z^2 r^2),  r = |Omega_i| / mode_i
fretting_connector  a worn plug opens by o: do/dt = c (1 - o) max(a - a_0, 0) - o / t, a its specific force;
                    U -= U_max tanh(R o I / U_max), U_max = 0.15 U

Each law depends on the vehicle's own mass, rotor places, directions of rotation and static thrusts T_i = c_l Omega_i^2.
Their memory is part of the state, as the tuple (side of the wake, place of the pack in m, opening of the plug).
"""

from collections.abc import Iterable

import jax.numpy as jnp

from swift_sim_bridge.referee.simulator.vectors import add, cross

AIR_DENSITY = 1.2  # kg/m^3, as its author took it
TWIST_LIMIT_RAD = 0.12
SIDE_LIMIT = 1.4  # of the wake
CREEP_LIMIT_M_S = 0.5  # of the pack
PLUG_M = (-0.06, 0.0, 0.02)  # place of the connector in the body
MAX_VOLTAGE_SHARE = 0.15  # of the voltage that the connector may take
IDLE = {  # numbers with which a law does nothing
    "bistable_wake": {
        "lift_area": 0.0,
        "slip_gain": 0.0,
        "bias": 0.0,
        "relaxation_length": 1.0,
        "critical_speed": 1.0,
    },
    "twisting_arm": {"softness": [0.0] * 4, "rotor_inertia": 0.0, "shear_offset": 0.0},
    "sliding_battery": {
        "battery": 0.0,
        "slack": 0.0,
        "height": 0.0,
        "preload": 0.0,
        "friction": 0.0,
        "mobility": 0.0,
    },
    "arm_resonance": {"mode": [1.0] * 4, "damping": 1.0, "peak": [0.0] * 4},
    "fretting_connector": {"resistance": 0.0, "threshold": 0.0, "opening_rate": 0.0, "healing_time": 1.0},
}
REST = (0.0, 0.0, 0.0)  # memory of a vehicle that has not moved


def any_in(contents: Iterable[dict]) -> bool:
    """Return whether a vehicle file's content has one of the laws."""
    return any("blind" in content for content in contents)


def parameters_of(content: dict) -> dict:
    """Return the numbers of each law for a vehicle file's content, in SI units: those of its key `blind`, else idle."""
    given = content.get("blind", {})
    return {law: idle | given.get(law, {}) for law, idle in IDLE.items()}


def memory_rate(memory: tuple, v, w, outputs, plant: dict) -> tuple:
    """Return the memory's time derivative.

    Args:
        memory: see the module.
        v: velocity through the air, m/s, body.
        w: angular velocity, rad/s, body.
        outputs: `plant.Outputs` at this instant.
        plant: parameters of the vehicle.
    """
    side, place, opening = memory
    laws = plant["blind"]
    return (
        _side_rate(side, v, laws["bistable_wake"]),
        _place_rate(place, w, outputs, laws["sliding_battery"]),
        _opening_rate(opening, w, outputs, laws["fretting_connector"]),
    )


def limited(memory: tuple, plant: dict) -> tuple:
    """Return the memory within its limits: the wake's largest lean, the pack's slack, a plug that is open."""
    side, place, opening = memory
    slack = plant["blind"]["sliding_battery"]["slack"]
    return jnp.clip(side, -SIDE_LIMIT, SIDE_LIMIT), jnp.clip(place, -slack, slack), jnp.clip(opening, 0.0, 1.0)


def wrench(memory: tuple, v, w, speeds, plant: dict):
    """Return force (N, body) and moment (N m, body) of the wake, the arm and the pack.

    Args:
        memory: see the module.
        v: velocity through the air, m/s, body.
        w: angular velocity, rad/s, body.
        speeds: of the rotors, rad/s.
        plant: parameters of the vehicle.
    """
    laws, (side, place, _) = plant["blind"], memory
    pressure = 0.5 * AIR_DENSITY * (v[0] ** 2 + v[2] ** 2)
    force = (0.0, -pressure * laws["bistable_wake"]["lift_area"] * side, 0.0)
    thrusts = [plant["lift"][i] * speed**2 for i, speed in enumerate(speeds)]
    moment = (0.0, laws["sliding_battery"]["battery"] / plant["mass"] * place * sum(thrusts), 0.0)
    for i, (speed, thrust) in enumerate(zip(speeds, thrusts, strict=True)):
        more_force, more_moment = _arm(i, speed, thrust, w, plant)
        force, moment = add(force, more_force), add(moment, more_moment)
    return force, moment


def speed_loss(speed, i: int, plant: dict):
    """Return the angular acceleration (rad/s^2) that rotor i loses to its arm's resonance at a speed, rad/s."""
    law = plant["blind"]["arm_resonance"]
    r, width = jnp.abs(speed) / law["mode"][i], 4.0 * law["damping"] ** 2
    return jnp.sign(speed) * law["peak"][i] * width * r**5 / ((1.0 - r**2) ** 2 + width * r**2)


def voltage_loss(memory: tuple, voltage, current, plant: dict):
    """Return the voltage (V) that the connector takes from a supply of `voltage` (V) and `current` (A)."""
    most = MAX_VOLTAGE_SHARE * voltage
    return most * jnp.tanh(plant["blind"]["fretting_connector"]["resistance"] * memory[2] * current / most)


def _side_rate(side, v, law: dict):
    """Return how fast the wake changes sides, 1/s."""
    plane, critical = jnp.sqrt(v[0] ** 2 + v[2] ** 2 + 1e-12), law["critical_speed"]
    slip = v[1] / jnp.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + 1.0)
    growth = (plane**2 - critical**2) / (plane**2 + critical**2)
    forcing = jnp.tanh(plane / critical) * (law["slip_gain"] * slip + law["bias"])
    return (plane + 0.5) / law["relaxation_length"] * (growth * side - side**3 + forcing)


def _place_rate(place, w, outputs, law: dict):
    """Return how fast the pack slides forward, m/s: not beyond its slack."""
    x, _, z = _force_at((place, 0.0, law["height"]), w, outputs)
    excess = jnp.maximum(jnp.abs(x) - law["preload"] - law["friction"] * jnp.abs(z), 0.0)
    creep = -jnp.sign(x) * jnp.minimum(law["mobility"] * excess, CREEP_LIMIT_M_S)
    at_end = jnp.abs(place) >= law["slack"]
    return jnp.where(at_end & (creep * place > 0.0), 0.0, creep)


def _opening_rate(opening, w, outputs, law: dict):
    """Return how fast the connector's contacts open, 1/s."""
    x, y, z = _force_at(PLUG_M, w, outputs)
    excess = jnp.maximum(jnp.sqrt(x**2 + y**2 + z**2) - law["threshold"], 0.0)
    return law["opening_rate"] * excess * (1.0 - opening) - opening / law["healing_time"]


def _force_at(r, w, outputs):
    """Return the specific force (m/s^2, body) at a place r of the body."""
    turning = add(cross(outputs.angular_acceleration, r), cross(w, cross(w, r)))
    return add(outputs.specific_force, turning)


def _arm(i: int, speed, thrust, w, plant: dict):
    """Return force and moment by which the thrust of rotor i changes with the twist of its arm."""
    law, (x, y, z) = plant["blind"]["twisting_arm"], plant["position"][i]
    length = jnp.sqrt(x**2 + y**2)
    along = (x / length, y / length, 0.0 * x)
    spin = law["rotor_inertia"] * plant["turn"][i] * jnp.abs(speed)
    gyroscopic = -(w[1] * along[0] - w[0] * along[1]) * spin  # along the arm, of -w x (0, 0, spin)
    torsion = gyroscopic + law["shear_offset"] * thrust
    twist = TWIST_LIMIT_RAD * jnp.tanh(law["softness"][i] * torsion / TWIST_LIMIT_RAD)
    force = (
        thrust * jnp.sin(twist) * along[1],
        -thrust * jnp.sin(twist) * along[0],
        thrust * (jnp.cos(twist) - 1.0),
    )
    return force, cross((x, y, z), force)
