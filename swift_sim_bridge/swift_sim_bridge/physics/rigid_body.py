"""The rigid body: accelerations from the sum of the wrenches (Methods, eq. 1)."""

import jax.numpy as jnp

from swift_ros import geometry


def apply(matrix, vector):
    """Return matrix (..., 3, 3) times vector (..., 3), elementwise: far quicker than a batch of tiny products."""
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


def accelerations(q_world_body, omega_body, force_body, moment_body, parameters):
    """Return (dv_world/dt, domega_body/dt), each (..., 3), m/s^2 and rad/s^2."""
    specific_force_world = geometry.rotate(q_world_body, force_body / parameters.mass[..., None])
    down = jnp.asarray([0.0, 0.0, 1.0], dtype=force_body.dtype) * parameters.gravity[..., None]
    gyroscopic = geometry.cross(omega_body, apply(parameters.inertia, omega_body))
    return specific_force_world - down, apply(parameters.inertia_inverse, moment_body - gyroscopic)
