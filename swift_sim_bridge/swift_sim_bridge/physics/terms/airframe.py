"""What changes the airframe itself: made once, when the vehicle is built from its file."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms import propeller
from swift_sim_bridge.physics.terms.term import Term


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ComOffset:
    """position: (3,) m of the true centre of mass from where the file has it, 1..8 mm."""

    position: tuple[float, float, float]


def com_offset(parameters, coefficients):
    """Return the parameters with the hubs seen from the true centre of mass; the inertia is left as it is."""
    return _seen_from(parameters, coefficients.position)


def _seen_from(parameters, position):
    """Return the parameters with the hubs' positions taken from `position` (..., 3)."""
    rotors = parameters.rotors
    return replace(parameters, rotors=replace(rotors, position=rotors.position - position[..., None, :]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Payload:
    """mass: kg, 0.02..0.1, rigidly fixed at position: (3,) m from the centre of mass without it."""

    mass: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


def payload(parameters, coefficients):
    """Return the parameters with the load on: heavier, turned harder (Steiner), hubs seen from the common centre."""
    position, mass = coefficients.position, parameters.mass + coefficients.mass
    reduced = (coefficients.mass * parameters.mass / mass)[..., None, None]
    squared = jnp.sum(position * position, axis=-1)[..., None, None]
    outer = position[..., :, None] * position[..., None, :]
    inertia = parameters.inertia + reduced * (squared * jnp.eye(3) - outer)
    loaded = replace(parameters, mass=mass, inertia=inertia, inertia_inverse=jnp.linalg.inv(inertia))
    return _seen_from(loaded, (coefficients.mass / mass)[..., None] * position)


AIRFRAME = {
    "com_offset": Term(ComOffset, airframe=com_offset),
    "payload": Term(Payload, airframe=payload),
    "damaged_propeller": Term(
        propeller.DamagedPropeller,
        airframe=propeller.weaken,
        wrench=propeller.shake,
        start=propeller.start,
        advance=propeller.advance,
        check=propeller.exists,
    ),
}
