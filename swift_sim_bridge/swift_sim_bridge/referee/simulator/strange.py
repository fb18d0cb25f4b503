"""Physics that no effect of the gap tool's catalogue names: six laws, each with one size.

vortex_bump   F_i,z -= s T_i exp(-((v_iz / v_h + 0.8) / 0.3)^2): a narrow loss in the rotor's own wake
              (shape after Johnson, "Model for Vortex Ring State Influence", 2005)
pad           F_i,z += s T_i exp(-(d / 1.5 m)^2): ground effect of a raised place, d the distance from it
              (Cheeseman and Bennett 1955, over a part of the ground)
lift          F_y = s v_x v_z: side force of an asymmetric body in oblique flow
stall         F_i,z -= T_i min(s max(mu_i - 0.04, 0)^2, 0.9): stall of the retreating blades, soft
              (Leishman, "Principles of Helicopter Aerodynamics", ch. 7)
cross_drag    F = -s (v_y, v_x, 0): drag whose principal axes are not the body's
weathercock   M_z = s |v| v_y: a fin behind the centre of mass
"""

import jax.numpy as jnp

LAWS = ("vortex_bump", "pad", "lift", "stall", "cross_drag", "weathercock")
IDLE = dict.fromkeys(LAWS, 0.0) | {"center": [0.0, 0.0, 0.0]}
PAD_RADIUS_M = 1.5


def hub_gain(thrust, spin, v, p, induced, plant: dict):
    """Return what the laws add to the thrust of one rotor, N.

    Args:
        thrust: static thrust, N.
        spin: rotor speed, rad/s.
        v: velocity of the hub through the air, m/s, body.
        p: position of the vehicle, m, world.
        induced: velocity that the rotor induces in hover at this thrust, m/s.
        plant: parameters of the vehicle.
    """
    strange = plant["strange"]
    bump = jnp.exp(-(((v[2] / induced + 0.8) / 0.3) ** 2))
    apart = sum((p[i] - strange["center"][i]) ** 2 for i in range(3))
    place = jnp.exp(-apart / PAD_RADIUS_M**2)
    mu = jnp.sqrt(v[0] ** 2 + v[1] ** 2 + 1e-12) / jnp.maximum(jnp.abs(spin) * plant["radius"], 1.0)
    loss = jnp.clip(strange["stall"] * jnp.maximum(mu - 0.04, 0.0) ** 2, 0.0, 0.9)
    return thrust * (strange["pad"] * place - strange["vortex_bump"] * bump - loss)


def wrench(v, plant: dict):
    """Return the force (N, body) and the moment (N m, body) of the laws that act on the body at airspeed v (m/s)."""
    strange = plant["strange"]
    cross, speed = strange["cross_drag"], jnp.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + 1e-12)
    force = (-cross * v[1], -cross * v[0] + strange["lift"] * v[0] * v[2], 0.0 * v[2])
    return force, (0.0 * v[0], 0.0 * v[1], strange["weathercock"] * speed * v[1])
