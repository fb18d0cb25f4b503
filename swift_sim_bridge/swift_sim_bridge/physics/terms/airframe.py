"""Changes of the airframe itself, made once when the vehicle is built from its file."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import FORCE_CHANNELS, MOMENT_CHANNELS, Effect, scalar_parameter, vector_parameters
from swift_sim_bridge.physics.terms.term import Term

REACH_M = 0.2  # m from the centre of mass, within which a load can be fixed to a vehicle of this size


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ComOffset:
    """Error of the centre of mass in the vehicle file.

    Attributes:
        position: (3,) m of the true centre of mass from the one of the file, 1 to 8 mm.
    """

    position: tuple[float, float, float]


def com_offset(parameters, coefficients):
    """Return the parameters with hub positions from the true centre of mass; the inertia is not changed."""
    return _relative_to(parameters, coefficients.position)


def _relative_to(parameters, position):
    """Return the parameters with the hubs' positions relative to `position` (..., 3)."""
    rotors = parameters.rotors
    return replace(parameters, rotors=replace(rotors, position=rotors.position - position[..., None, :]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Payload:
    """Load that is rigidly fixed to the vehicle.

    Attributes:
        mass: kg, 0.02 to 0.1.
        position: (3,) m from the centre of mass without the load.
    """

    mass: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


def payload(parameters, coefficients):
    """Return the parameters with the load: mass, inertia (Steiner) and hub positions from the common centre of mass."""
    position, mass = coefficients.position, parameters.mass + coefficients.mass
    reduced = (coefficients.mass * parameters.mass / mass)[..., None, None]
    squared = jnp.sum(position * position, axis=-1)[..., None, None]
    outer = position[..., :, None] * position[..., None, :]
    inertia = parameters.inertia + reduced * (squared * jnp.eye(3) - outer)
    loaded = replace(parameters, mass=mass, inertia=inertia, inertia_inverse=jnp.linalg.inv(inertia))
    return _relative_to(loaded, (coefficients.mass / mass)[..., None] * position)


def payload_effect(position=(0.0, 0.0, 0.0)) -> Effect:
    """Return the effect of a fixed load, estimated from a first guess of its position (3,) m."""
    return Effect(
        id="payload",
        layer="force",
        parameters=(
            scalar_parameter("mass", "kg", "payload", step=2e-3, low=0.0, high=1.0),
            *vector_parameters("position", "m", "payload", step=2e-3, bounds=(-REACH_M, REACH_M)),
        ),
        equation="m = M + m_p, c = r m_p / m, J = J_0 + (r^2 1 - r r^T) M m_p / m",
        sentence="it carries a load of {mass:.3g} kg at {position_0:.3g}, {position_1:.3g}, {position_2:.3g} m from "
        "the centre of mass without the load",
        manoeuvre="throttle punches with roll and pitch doublets",
        channels=tuple(dict.fromkeys((*FORCE_CHANNELS[:-1], *MOMENT_CHANNELS))),
        idle={"payload": {"mass": 0.0, "position": [float(x) for x in position]}},
        own_search=True,
    )


TERMS = {
    "com_offset": Term(
        ComOffset,
        airframe=com_offset,
        idle={"position": [0.0, 0.0, 0.0]},
        example={"position": [0.003, -0.002, 0.005]},
        effects=(
            Effect(
                id="com_offset",
                layer="moment",
                parameters=vector_parameters("position", "m", "com_offset", step=1e-4, bounds=(-0.05, 0.05)),
                equation="tau += -c x T e_z",
                sentence="the centre of mass is off by {values} m",
                manoeuvre="throttle punches in level flight",
                channels=MOMENT_CHANNELS,
            ),
        ),
    ),
    "payload": Term(
        Payload,
        airframe=payload,
        idle={"mass": 0.0},
        example={"mass": 0.05, "position": [0.03, -0.02, 0.04]},
        effects=lambda vehicle, gates: (payload_effect(),),
    ),
}
