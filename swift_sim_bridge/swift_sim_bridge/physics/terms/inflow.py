"""Changes of a rotor's thrust by the air that flows through and under it.

Each is computed at the velocity of the hub, so that it damps rotation as well.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.effects import FORCE_CHANNELS, Effect, scalar_parameter
from swift_sim_bridge.physics.terms.air import AIR_DENSITY
from swift_sim_bridge.physics.terms.motion import along_z
from swift_sim_bridge.physics.terms.term import Term


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AxialInflow:
    """Loss of thrust in a climb.

    Attributes:
        k_z: N/(rad/s m/s) for each rotor, 3e-5 to 1e-4.
    """

    k_z: float


def axial_inflow(instant, coefficients):
    """Return forces F_i = -k_z Omega_i v_iz along the body's z axis: inflow reduces the blades' angle of attack.

    Source: blade-element theory to first order in the inflow; RotorPy's `k_z` (rotorpy/vehicles/multirotor.py).
    """
    pairs = zip(instant.rotor_speed, instant.hub_velocity, strict=True)
    return along_z(-coefficients.k_z * speed * v.z for speed, v in pairs)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TranslationalLift:
    """Gain of thrust by lateral flow.

    Attributes:
        k_h: N/(m/s)^2 for each rotor, 1e-3 to 1e-2.
        saturation: m/s of lateral flow at which half of the final gain is reached; 0: no saturation.
    """

    k_h: float
    saturation: float = 0.0


def translational_lift(instant, coefficients):
    """Return forces F_i = k_h v_i,xy^2 / (1 + (v_i,xy / saturation)^2) along the body's z axis.

    Lateral flow supplies undisturbed air: thrust grows with its square at first (RotorPy's `k_h`), then saturates.
    """
    saturation = coefficients.saturation
    inverse = jnp.where(saturation > 0, 1.0 / jnp.maximum(saturation, 1e-3) ** 2, 0.0)
    return along_z(coefficients.k_h * u / (1.0 + inverse * u) for u in instant.hub_lateral_squared)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GroundEffect:
    """Gain of thrust near the ground.

    Attributes:
        k: dimensionless; 1 for an isolated rotor (Cheeseman and Bennett), 1 to 3 measured on small quadrotors.
    """

    k: float = 1.0


def ground_effect(instant, coefficients):
    """Return forces T_i (1/(1 - k (R/4h_i)^2) - 1) along the body's z axis, h_i the height of hub i over z = 0.

    Source: Cheeseman and Bennett 1955. Heights below half a radius are replaced by half a radius.
    """
    radius = instant.hubs.radius

    def gain(height):
        reach = 0.25 * radius / jnp.maximum(height, 0.5 * radius)
        x = jnp.minimum(coefficients.k * reach * reach, 0.9)
        return x / (1.0 - x)

    return along_z(thrust * gain(h) for thrust, h in zip(instant.thrust, instant.hub_height, strict=True))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class VortexRing:
    """Loss of thrust in a descent into the rotor's own wake.

    Attributes:
        loss: share of the thrust lost at the middle of the vortex ring state, 0.1 to 0.4.
        buffet: standard deviation of the fluctuation there, share of the thrust, 0 to 0.2.
        bandwidth: Hz of the fluctuation, 5 to 20.
    """

    loss: float
    buffet: float = 0.0
    bandwidth: float = 10.0


# Vortex ring state in descent speed over the induced velocity of hover: -1.5 < v_z/v_h < -0.3 (Leishman).
MIDDLE, HALF_WIDTH = 0.9, 0.6


def vortex_ring(instant, coefficients):
    """Return forces -(loss - buffet n_i) T_i b_i along the body's z axis; n_i is noise of variance 1.

    A rotor that sinks into its own wake at 0.3..1.5 times the induced velocity v_h = Omega sqrt(c_l / (2 rho pi R^2))
    recirculates it. b_i is a bump over that range, 1 in its middle; lateral flow of v_h or more removes it.
    Source: range as in Leishman, "Principles of Helicopter Aerodynamics", ch. 2; the shape of the bump is our choice.
    """
    hubs = instant.hubs
    noise = instant.memory.get("vortex_ring", {}).get("buffet", (0.0,) * len(hubs.spin))
    forces = []
    for i, (speed, v) in enumerate(zip(instant.rotor_speed, instant.hub_velocity, strict=True)):
        area = jnp.pi * hubs.radius * hubs.radius
        induced = jnp.sqrt(hubs.thrust_coefficient[i] / (2.0 * AIR_DENSITY * area))
        inverse = 1.0 / (induced * (speed + 1.0))  # + 1 rad/s: a rotor at rest has no ring
        off_middle = (v.z * inverse + MIDDLE) * (1.0 / HALF_WIDTH)
        across = jnp.maximum(1.0 - instant.hub_lateral_squared[i] * inverse * inverse, 0.0)
        bump = jnp.maximum(1.0 - off_middle * off_middle, 0.0)
        lost = coefficients.loss - coefficients.buffet * noise[i]
        forces.append(-lost * instant.thrust[i] * bump * bump * across)
    return along_z(forces)


def start_buffet(coefficients, zero, normal, count):
    """Return the noise of the buffet at the start: zero."""
    return {"buffet": (zero,) * count}


def advance_buffet(memory, step, coefficients, parameters):
    """Return the noise of the buffet after a step: an Ornstein-Uhlenbeck process of variance 1 for each rotor."""
    keep = jnp.exp(-2.0 * jnp.pi * coefficients.bandwidth * step.dt)
    fresh = jnp.sqrt(1.0 - keep * keep)
    return {"buffet": tuple(keep * n + fresh * w for n, w in zip(memory["buffet"], step.random, strict=True))}


TERMS = {
    "axial_inflow": Term(
        AxialInflow,
        hubs=axial_inflow,
        idle={"k_z": 0.0},
        example={"k_z": 6e-5},
        effects=(
            Effect(
                id="axial_inflow",
                layer="force",
                parameters=(scalar_parameter("k_z", "N/(rad/s m/s)", "axial_inflow", step=2e-6, low=0.0, high=1e-3),),
                equation="F_i,z = -k_z Omega_i v_i,z",
                sentence="a climb takes thrust from the rotors: {k_z:.3g} N/(rad/s m/s) each",
                manoeuvre="level climbs and descents at 2, 4 and 8 m/s",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "translational_lift": Term(
        TranslationalLift,
        hubs=translational_lift,
        idle={"k_h": 0.0},
        example={"k_h": 5e-3, "saturation": 9.0},
        effects=(
            Effect(
                id="translational_lift",
                layer="force",
                parameters=(scalar_parameter("k_h", "N/(m/s)^2", "translational_lift", step=2e-4, low=0.0, high=0.1),),
                equation="F_i,z = k_h v_i,xy^2",
                sentence="lateral flow adds thrust to the rotors: {k_h:.3g} N/(m/s)^2 each",
                manoeuvre="level passes at high speed, both ways",
                channels=FORCE_CHANNELS,
            ),
        ),
        units={"saturation": "m/s"},
    ),
    "ground_effect": Term(
        GroundEffect,
        hubs=ground_effect,
        idle={"k": 0.0},
        example={"k": 2.0},
        effects=(
            Effect(
                id="ground_effect",
                layer="force",
                parameters=(scalar_parameter("k", "", "ground_effect", step=0.1, low=0.0, high=10.0),),
                equation="T_i / (1 - k (R/4h_i)^2)",
                sentence="the ground adds thrust, k = {k:.3g}",
                manoeuvre="low passes at 0.1, 0.2, 0.4 and 1 m",
                channels=FORCE_CHANNELS,
            ),
        ),
    ),
    "vortex_ring": Term(
        VortexRing,
        hubs=vortex_ring,
        start=start_buffet,
        advance=advance_buffet,
        randoms=lambda count: count,
        idle={"loss": 0.0},
        example={"loss": 0.3, "buffet": 0.1, "bandwidth": 10.0},
        effects=(
            Effect(
                id="vortex_ring",
                layer="force",
                parameters=(scalar_parameter("loss", "", "vortex_ring", step=0.01, low=0.0, high=0.9),),
                equation="T_i (1 - loss b(v_i,z / v_h))",
                sentence="a descent into the rotors' own wake takes {loss:.1%} of the thrust",
                manoeuvre="straight descents at 2 to 12 m/s",
                channels=FORCE_CHANNELS,
            ),
        ),
        units={"buffet": "", "bandwidth": "Hz"},
    ),
}
