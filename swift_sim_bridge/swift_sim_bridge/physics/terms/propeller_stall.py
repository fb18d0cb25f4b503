"""Stall of a propeller's retreating blades: thrust lost above an advance ratio."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import FORCE_CHANNELS, Effect, scalar_parameter
from swift_sim_bridge.physics.terms.motion import along_z
from swift_sim_bridge.physics.terms.term import Term

MIN_TIP_SPEED_M_S = 1.0  # of a rotor at rest, whose advance ratio has no bound; a flying rotor's is above 10 m/s
MAX_LOSS = 0.9  # share of the thrust: a stalled propeller still pushes


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PropellerStall:
    """Loss of thrust where the flow across the rotor stalls the retreating blades.

    Attributes:
        slope: share of the thrust lost per unit of advance ratio above the onset, 0.5 to 3.
        onset: advance ratio, lateral speed of the hub over the speed of the blade tips, at which the loss begins.
    """

    slope: float
    onset: float = 0.1


def propeller_stall(instant, coefficients):
    """Return forces -slope max(mu_i - onset, 0) T_i along the body's z axis, mu_i = v_i,xy / (Omega_i R).

    Source: retreating-blade stall as in Leishman, "Principles of Helicopter Aerodynamics", ch. 7; the line above a
    threshold is our choice.
    """
    rows = zip(instant.thrust, instant.rotor_speed, instant.hub_lateral_squared, strict=True)
    forces = []
    for thrust, speed, lateral_squared in rows:
        tip_speed = jnp.maximum(speed * instant.hubs.radius, MIN_TIP_SPEED_M_S)
        excess = jnp.maximum(jnp.sqrt(lateral_squared + 1e-12) / tip_speed - coefficients.onset, 0.0)
        forces.append(-jnp.minimum(coefficients.slope * excess, MAX_LOSS) * thrust)
    return along_z(forces)


TERMS = {
    "propeller_stall": Term(
        PropellerStall,
        hubs=propeller_stall,
        idle={"slope": 0.0},
        example={"slope": 1.5, "onset": 0.08},
        effects=(
            Effect(
                id="propeller_stall",
                layer="force",
                parameters=(scalar_parameter("slope", "", "propeller_stall", step=0.02, low=0.0, high=10.0),),
                equation="T_i (1 - slope max(v_i,xy / (Omega_i R) - onset, 0))",
                sentence="the propellers stall in lateral flow: {slope:.3g} of the thrust per unit of advance ratio",
                manoeuvre="level passes at the highest speed, with low and with high thrust",
                channels=FORCE_CHANNELS,
            ),
        ),
        units={"onset": ""},
    ),
}
