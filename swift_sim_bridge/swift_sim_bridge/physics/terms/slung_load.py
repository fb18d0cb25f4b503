"""A load that swings under the vehicle: a pendulum, free in two angles, on a rigid massless rod at the centre of mass.

n is the unit vector from vehicle to load, f the acceleration of the vehicle by all other forces but gravity (m/s^2).
Newton's law of both bodies and the constant length of the rod give:

    pull on the vehicle, per its mass M: m/(m + M) (l n'^2 - n.f) n,   n'' = -n'^2 n - (f - (n.f) n)/l - c n'
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import NotIdentified
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import Vector, add, dot, scale, subtract

MAX_LENGTH_M = 100.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SlungLoad:
    """Load on a rod.

    Attributes:
        mass: kg, 0.005 to 0.03.
        length: m, 0.05 to 0.5.
        damping: 1/s of the swing's rate, 0 to 2.
    """

    mass: float
    length: float
    damping: float = 0.0


def has_length(coefficients, vehicle):
    """Raise ValueError when the rod has no length, or one that no hall holds, or the mass is negative."""
    if not (0 < coefficients.length <= MAX_LENGTH_M and coefficients.mass >= 0):
        raise ValueError(
            f"must have a positive 'length' of at most {MAX_LENGTH_M:g}, in m, and a 'mass' of at least 0, in kg"
        )


def start(coefficients, zero, normal, count):
    """Return the load at rest straight below."""
    return {"direction": Vector(zero, zero, zero - 1.0), "rate": Vector(zero, zero, zero)}


def pull(specific_force_world, coefficients, memory, parameters):
    """Return the rod's pull on the vehicle (world, m/s^2), given the specific force of all other forces."""
    if not memory:
        return Vector()
    n, rate = memory["direction"], memory["rate"]
    share = coefficients.mass / (coefficients.mass + parameters.mass)
    return scale(share * (coefficients.length * dot(rate, rate) - dot(n, specific_force_world)), n)


def advance(memory, step, coefficients, parameters):
    """Return direction (unit vector) and rate (1/s) of the load after a step, semi-implicit."""
    n, rate, force = memory["direction"], memory["rate"], step.specific_force_world
    across = subtract(force, scale(dot(n, force), n))
    pushed = scale(-1.0 / coefficients.length, across)
    bent = subtract(pushed, scale(dot(rate, rate), n))
    rate = add(rate, scale(step.dt, subtract(bent, scale(coefficients.damping, rate))))
    moved = add(n, scale(step.dt, rate))
    n = scale(1.0 / jnp.sqrt(dot(moved, moved)), moved)
    return {"direction": n, "rate": subtract(rate, scale(dot(n, rate), n))}


TERMS = {
    "slung_load": Term(
        SlungLoad,
        tow=pull,
        start=start,
        advance=advance,
        check=has_length,
        idle={"mass": 0.0, "length": 0.3},
        example={"mass": 0.03, "length": 0.2, "damping": 0.5},
        units={"mass": "kg", "length": "m", "damping": "1/s"},
        not_identified=NotIdentified(
            reason="a load that swings depends on its earlier swing, and the gap tool compares single moments",
            equation="F/M = m/(m + M) (l n'^2 - n.f) n, n'' = -n'^2 n - (f - (n.f) n)/l - c n', with n from vehicle to "
            "load and f (m/s^2) of all other forces but gravity",
            manoeuvre="sudden stops to a hover: the load swings on",
        ),
    ),
}
