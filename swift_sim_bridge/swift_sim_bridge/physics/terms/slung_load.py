"""A load that swings under the vehicle: a pendulum, free in two angles, on a rigid massless rod at the centre of mass.

With n the unit vector from vehicle to load and f what all other forces but gravity would give the vehicle (m/s^2), both
bodies obey Newton and the rod keeps its length:

    pull on the vehicle, per its mass M: m/(m + M) (l n'^2 - n.f) n,   n'' = -n'^2 n - (f - (n.f) n)/l - c n'
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms.vectors import Vector, add, dot, scale, subtract


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SlungLoad:
    """mass: kg, 0.005..0.03; length: m, 0.05..0.5; damping: 1/s of the swing's rate, 0..2."""

    mass: float
    length: float
    damping: float = 0.0


def hangs(coefficients, vehicle):
    """Raise ValueError when the load has nothing to hang on."""
    if not (coefficients.length > 0 and coefficients.mass >= 0):
        raise ValueError("must have a positive 'length', in m, and a 'mass' of at least 0, in kg")


def start(coefficients, zero, normal, count):
    """Return the load at rest straight below."""
    return {"direction": Vector(zero, zero, zero - 1.0), "rate": Vector(zero, zero, zero)}


def pull(specific_force_world, coefficients, remembered, parameters):
    """Return the rod's pull on the vehicle (world, m/s^2), given what all other forces but gravity give it."""
    if not remembered:
        return Vector()
    n, rate = remembered["direction"], remembered["rate"]
    share = coefficients.mass / (coefficients.mass + parameters.mass)
    return scale(share * (coefficients.length * dot(rate, rate) - dot(n, specific_force_world)), n)


def advance(remembered, passed, coefficients, parameters):
    """Return direction (unit) and rate (1/s) of the load a step later, semi-implicit."""
    n, rate, force = remembered["direction"], remembered["rate"], passed.specific_force_world
    across = subtract(force, scale(dot(n, force), n))
    pushed = scale(-1.0 / coefficients.length, across)
    bent = subtract(pushed, scale(dot(rate, rate), n))
    rate = add(rate, scale(passed.dt, subtract(bent, scale(coefficients.damping, rate))))
    moved = add(n, scale(passed.dt, rate))
    n = scale(1.0 / jnp.sqrt(dot(moved, moved)), moved)
    return {"direction": n, "rate": subtract(rate, scale(dot(n, rate), n))}
