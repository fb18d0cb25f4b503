"""Air that moves: steady wind and a draught at one place; gusts are in `gust`. Velocities in the world, m/s."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms import gust
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import dot, scale, subtract, vector


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Wind:
    """velocity: (3,) m/s in the world: 0..6 outdoors, 0..1 indoors."""

    velocity: tuple[float, float, float]


def wind(p_world, coefficients, remembered):
    """Return the steady wind, the same everywhere."""
    return vector(coefficients.velocity)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LocalDraught:
    """center: (3,) m in the world; radius: m, 0.5..3; velocity: (3,) m/s at the centre, 1..4: a fan, an open door."""

    center: tuple[float, float, float]
    radius: float
    velocity: tuple[float, float, float]


def local_draught(p_world, coefficients, remembered):
    """Return velocity (1 - d^2/radius^2)^2 within `radius` of the centre, d the distance from it; still air beyond."""
    apart = subtract(p_world, vector(coefficients.center))
    share = jnp.maximum(1.0 - dot(apart, apart) / (coefficients.radius * coefficients.radius), 0.0)
    return scale(share * share, vector(coefficients.velocity))


def has_size(coefficients, vehicle):
    """Raise ValueError when the draught is nowhere."""
    if not coefficients.radius > 0:
        raise ValueError("must have a positive 'radius', in m")


AIR = {
    "wind": Term(Wind, air=wind),
    "gust": Term(gust.Gust, air=gust.gust, start=gust.start, advance=gust.advance, randoms=lambda n: 3),
    "local_draught": Term(LocalDraught, air=local_draught, check=has_size),
}
