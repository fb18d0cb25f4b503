"""Drag of the rotors and of the body: summands of the grey-box aerodynamics (Methods, eq. 5), each on its own."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RotorDrag:
    """k_d: N/(rad/s m/s) a rotor."""

    k_d: float


def rotor_drag(motion, coefficients, parameters):
    """Return the wrench of F_i = -k_d Omega_i v_i in the rotors' plane, v_i the velocity of hub i through the air."""
    x, y, z = (parameters.rotors.position[..., i] for i in range(3))
    vx, vy = motion.v_body[..., 0, None], motion.v_body[..., 1, None]
    wx, wy, wz = (motion.omega_body[..., i, None] for i in range(3))
    drag = -coefficients.k_d[..., None] * motion.rotor_speed
    force_x = drag * (vx + wy * z - wz * y)
    force_y = drag * (vy + wz * x - wx * z)
    total_x, total_y = jnp.sum(force_x, axis=-1), jnp.sum(force_y, axis=-1)
    moment_x, moment_y = -jnp.sum(z * force_y, axis=-1), jnp.sum(z * force_x, axis=-1)
    moment_z = jnp.sum(x * force_y - y * force_x, axis=-1)
    force = jnp.stack([total_x, total_y, jnp.zeros_like(total_x)], axis=-1)
    return force, jnp.stack([moment_x, moment_y, moment_z], axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BodyDrag:
    """c: (3,) N/(m/s)^2 along the body's axes."""

    c: tuple[float, float, float]


def body_drag(motion, coefficients, parameters):
    """Return the wrench of F = -c |v| v along each body axis, acting at the centre of mass."""
    speed = jnp.sqrt(jnp.sum(motion.v_body * motion.v_body, axis=-1, keepdims=True) + 1e-12)
    force = -coefficients.c * speed * motion.v_body
    return force, jnp.zeros_like(force)
