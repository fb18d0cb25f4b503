"""What the air through and under a rotor does to its thrust, at each hub's own velocity: so it damps rotation too."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms.motion import along_z

AIR_DENSITY = 1.225  # kg/m^3, ISO standard atmosphere at sea level


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AxialInflow:
    """k_z: N/(rad/s m/s) a rotor, 3e-5..1e-4: thrust lost in a climb."""

    k_z: float


def axial_inflow(instant, coefficients):
    """Return forces F_i = -k_z Omega_i v_iz along the body's z axis: inflow takes the blades' angle of attack.

    Source: blade-element theory to first order in the inflow; RotorPy's `k_z` (rotorpy/vehicles/multirotor.py).
    """
    pairs = zip(instant.rotor_speed, instant.hub_velocity, strict=True)
    return along_z(-coefficients.k_z * speed * v.z for speed, v in pairs)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TranslationalLift:
    """k_h: N/(m/s)^2 a rotor, 1e-3..1e-2; saturation: m/s across at which half of the lift is reached, 0 = never."""

    k_h: float
    saturation: float = 0.0


def translational_lift(instant, coefficients):
    """Return forces F_i = k_h v_i,xy^2 / (1 + (v_i,xy / saturation)^2) along the body's z axis.

    Flow across a rotor brings fresh air: thrust grows with its square at first (RotorPy's `k_h`), then no more.
    """
    saturation = coefficients.saturation
    inverse = jnp.where(saturation > 0, 1.0 / jnp.maximum(saturation, 1e-3) ** 2, 0.0)
    return along_z(coefficients.k_h * u / (1.0 + inverse * u) for u in instant.hub_lateral_squared)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GroundEffect:
    """k: 1, dimensionless (Cheeseman and Bennett); measured on small quadrotors 1..3."""

    k: float = 1.0


def ground_effect(instant, coefficients):
    """Return forces T_i (1/(1 - k (R/4h_i)^2) - 1) along the body's z axis, h_i the height of hub i over z = 0.

    Source: Cheeseman and Bennett 1955. Heights below half a radius count as that.
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
    """loss: share of a rotor's thrust lost in the middle of the ring, 0.1..0.4; buffet: standard deviation of its
    fluctuation there, share of thrust, 0..0.2; bandwidth: Hz of the fluctuation, 5..20."""

    loss: float
    buffet: float = 0.0
    bandwidth: float = 10.0


MIDDLE, HALF_WIDTH = 0.9, 0.6  # of the ring, in descent speed over hover's induced velocity: -1.5 < v_z/v_h < -0.3


def vortex_ring(instant, coefficients):
    """Return forces -(loss - buffet n_i) T_i b_i along the body's z axis; n_i is noise of variance 1.

    A rotor that sinks into its own wake at 0.3..1.5 times the induced velocity v_h = Omega sqrt(c_l / (2 rho pi R^2))
    recirculates it. b_i is a bump over that range, 1 in its middle, which flow across of v_h washes away.
    Source: shape as in Leishman, "Principles of Helicopter Aerodynamics", ch. 2; the bump is ours.
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


def calm(coefficients, zero, normal, count):
    """Return the buffet's noise at first: none."""
    return {"buffet": (zero,) * count}


def buffeted(remembered, passed, coefficients, parameters):
    """Return the buffet's noise after a step: one Ornstein-Uhlenbeck process of variance 1 a rotor."""
    keep = jnp.exp(-2.0 * jnp.pi * coefficients.bandwidth * passed.dt)
    fresh = jnp.sqrt(1.0 - keep * keep)
    return {"buffet": tuple(keep * n + fresh * w for n, w in zip(remembered["buffet"], passed.random, strict=True))}
