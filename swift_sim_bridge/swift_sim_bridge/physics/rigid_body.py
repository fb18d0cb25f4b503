"""The rigid body: accelerations from the sum of the wrenches (Methods, eq. 1)."""

import jax.numpy as jnp

from swift_sim_bridge.physics.terms import vectors
from swift_sim_bridge.physics.terms.vectors import Quaternion, Vector, cross, is_zero, rotate, subtract


def apply(matrix, vector):
    """Return matrix (..., 3, 3) times vector (..., 3), elementwise: far quicker than a batch of tiny products."""
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


def specific_force(force_body: Vector, q_world_body: Quaternion, parameters) -> Vector:
    """Return what a force (N, body) gives the vehicle, m/s^2 in the world."""
    components = (jnp.zeros_like(q_world_body.w) if is_zero(part) else part / parameters.mass for part in force_body)
    return rotate(q_world_body, Vector(*components))


def turn_acceleration(omega_body: Vector, moment_body: Vector, parameters, coasting: bool = True) -> Vector:
    """Return domega_body/dt, rad/s^2; without `coasting` that of the moment alone, not of turning on."""
    if coasting:
        moment_body = subtract(moment_body, cross(omega_body, vectors.apply(parameters.inertia, omega_body)))
    return vectors.apply(parameters.inertia_inverse, moment_body)
