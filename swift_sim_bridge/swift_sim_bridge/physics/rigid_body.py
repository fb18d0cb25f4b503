"""The rigid body: accelerations by the sum of forces and moments (Methods, eq. 1); effects of mass and inertia."""

import jax.numpy as jnp
import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import (
    FORCE_CHANNELS,
    MASS_AND_THRUST_RANGE,
    MIN_THRUST_TO_WEIGHT,
    MOMENT_CHANNELS,
    Effect,
    Parameter,
)
from swift_sim_bridge.physics.terms import vectors
from swift_sim_bridge.physics.terms.vectors import Quaternion, Vector, cross, is_zero, rotate, subtract


def apply(matrix, vector):
    """Return matrix (..., 3, 3) times vector (..., 3), elementwise: faster than a batch of small matrix products."""
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


def specific_force(force_body: Vector, q_world_body: Quaternion, parameters) -> Vector:
    """Return the acceleration (m/s^2, world) by a force (N, body)."""
    components = (jnp.zeros_like(q_world_body.w) if is_zero(part) else part / parameters.mass for part in force_body)
    return rotate(q_world_body, Vector(*components))


def turn_acceleration(omega_body: Vector, moment_body: Vector, parameters, coasting: bool = True) -> Vector:
    """Return domega_body/dt, rad/s^2; without `coasting` without the gyroscopic part -omega x J omega."""
    if coasting:
        moment_body = subtract(moment_body, cross(omega_body, vectors.apply(parameters.inertia, omega_body)))
    return vectors.apply(parameters.inertia_inverse, moment_body)


def effects(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return the effects of a wrong mass and a wrong inertia."""
    mass, diagonal = vehicle.mass, np.diag(vehicle.inertia_matrix)
    least, most = MASS_AND_THRUST_RANGE
    is_matrix = np.ndim(vehicle.inertia) == 2
    return (
        Effect(
            id="mass",
            layer="force",
            parameters=(
                Parameter(
                    "mass",
                    "kg",
                    ("mass",),
                    step=0.005 * mass,
                    low=least * mass,
                    high=min(most, vehicle.thrust_to_weight / MIN_THRUST_TO_WEIGHT) * mass,
                    inverse=True,
                ),
            ),
            equation="a = (T + F) / m",
            sentence="the vehicle weighs {mass:.4g} kg",
            manoeuvre="weigh it; or throttle punches with roll and pitch doublets",
            channels=FORCE_CHANNELS,
        ),
        Effect(
            id="inertia",
            layer="moment",
            parameters=tuple(
                Parameter(
                    f"inertia[{i}]",
                    "kg m^2",
                    ("inertia", i, i) if is_matrix else ("inertia", i),
                    step=0.02 * value,
                    low=0.4 * value,
                    high=2.5 * value,
                    inverse=True,
                )
                for i, value in enumerate(diagonal)
            ),
            equation="J domega/dt = tau - omega x J omega",
            sentence="the moments of inertia are {values} kg m^2",
            manoeuvre="roll, pitch and yaw doublets above 3 Hz",
            channels=MOMENT_CHANNELS,
        ),
    )
