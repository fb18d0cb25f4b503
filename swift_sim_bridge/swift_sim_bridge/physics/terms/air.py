"""Motion of the air: steady wind and a local draught; gusts are in `gust`. Velocities in the world, m/s."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import FORCE_CHANNELS, Effect, Parameter, vector_parameters
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import dot, scale, subtract, vector

AIR_DENSITY = 1.225  # kg/m^3 at sea level and 15 deg C (ISO 2533, standard atmosphere)
DRAGS = ("linear_drag", "body_drag", "rotor_drag", "axial_inflow")  # through one of which moving air acts on a vehicle
REACH_M = 3.0  # m from the point where the search begins, within which the centre of a draught is estimated
MAX_DRAUGHT = 8.0  # m/s, twice the strongest fan or door, on each axis; a force that needs more has another cause
IDLE_WIND = [0.0, 0.0, 0.0]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Wind:
    """Steady wind, the same everywhere.

    Attributes:
        velocity: (3,) m/s in the world: 0 to 6 outdoors, 0 to 1 indoors.
    """

    velocity: tuple[float, float, float]


def wind(p_world, coefficients, memory):
    """Return the velocity of the steady wind."""
    return vector(coefficients.velocity)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LocalDraught:
    """Moving air around one place: a fan, an open door.

    Attributes:
        center: (3,) m in the world.
        radius: m, 0.5 to 3.
        velocity: (3,) m/s at the centre, 1 to 4.
    """

    center: tuple[float, float, float]
    radius: float
    velocity: tuple[float, float, float]


def local_draught(p_world, coefficients, memory):
    """Return velocity (1 - d^2/radius^2)^2 within `radius` of the centre, d the distance from it; zero beyond."""
    offset = subtract(p_world, vector(coefficients.center))
    share = jnp.maximum(1.0 - dot(offset, offset) / (coefficients.radius * coefficients.radius), 0.0)
    return scale(share * share, vector(coefficients.velocity))


def has_radius(coefficients, vehicle):
    """Raise ValueError when the draught has no extent."""
    if not coefficients.radius > 0:
        raise ValueError("must have a positive 'radius', in m")


def draught_effect(center=(0.0, 0.0, 0.0), radius: float = 1.0) -> Effect:
    """Return the effect of a local draught, estimated from a first guess.

    Args:
        center: (3,) m, first guess of the centre.
        radius: m, first guess.
    """
    path, parameters = ("terms", "local_draught"), []
    for key, unit, reach, middles in (("velocity", "m/s", MAX_DRAUGHT, IDLE_WIND), ("center", "m", REACH_M, center)):
        parameters += [
            Parameter(f"{key}[{i}]", unit, (*path, key, i), 0.05, middle - reach, middle + reach)
            for i, middle in enumerate(middles)
        ]
    parameters.append(Parameter("radius", "m", (*path, "radius"), 0.05, 0.3, 10.0))
    idle = {"velocity": IDLE_WIND, "center": [float(x) for x in center], "radius": float(radius)}
    return Effect(
        id="local_draught",
        layer="force",
        parameters=tuple(parameters),
        equation="v_air = w (1 - d^2/r^2)^2 within r of a place",
        sentence="a draught of {velocity_0:.3g}, {velocity_1:.3g}, {velocity_2:.3g} m/s blows within {radius:.3g} m "
        "of {center_0:.3g}, {center_1:.3g}, {center_2:.3g} m",
        manoeuvre="slow passes through the place from several sides",
        channels=FORCE_CHANNELS,
        idle={"local_draught": idle},
        requires=DRAGS,
        own_search=True,
    )


TERMS = {
    "wind": Term(
        Wind,
        air=wind,
        idle={"velocity": IDLE_WIND},
        example={"velocity": [3.0, -2.0, 0.5]},
        effects=(
            Effect(
                id="wind",
                layer="force",
                parameters=vector_parameters("velocity", "m/s", "wind", step=0.05, bounds=(-30.0, 30.0)),
                equation="v_b = R^T (v - w)",
                sentence="a steady wind of {values} m/s blows",
                manoeuvre="the same laps in both directions",
                channels=FORCE_CHANNELS,
                requires=DRAGS,
            ),
        ),
    ),
    "local_draught": Term(
        LocalDraught,
        air=local_draught,
        check=has_radius,
        idle={"velocity": IDLE_WIND, "center": [0.0, 0.0, 0.0], "radius": 1.0},
        example={"center": [0.5, 0.3, 3.0], "radius": 6.0, "velocity": [2.0, -3.0, 1.0]},
        effects=lambda vehicle, gates: (draught_effect(),),
    ),
}
