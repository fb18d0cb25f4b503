"""Inputs of the terms: `Motion` as arrays, `Instant` by components with quantities that several terms share."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics.terms.vectors import (
    Quaternion,
    Vector,
    cross,
    parts,
    quaternion,
    total,
    up_in_body,
    vector,
)


class Motion(NamedTuple):
    """A moving vehicle.

    Attributes:
        p_world: (..., 3) m.
        q_world_body: (..., 4), x y z w.
        v_body: (..., 3) m/s, velocity through the air.
        omega_body: (..., 3) rad/s.
        rotor_speed: (..., n) rad/s.
        rotor_acceleration: (..., n) rad/s^2.
    """

    p_world: jax.Array
    q_world_body: jax.Array
    v_body: jax.Array
    omega_body: jax.Array
    rotor_speed: jax.Array
    rotor_acceleration: jax.Array


@dataclass(frozen=True)
class Hubs:
    """The rotors by components.

    Attributes:
        position: n Vectors, m from the centre of mass.
        spin: n of (...), +1 counter-clockwise seen from above.
        thrust_coefficient: n of (...), N s^2/rad^2.
        torque_coefficient: n of (...), N m s^2/rad^2.
        radius: (...) m, of all rotors.
    """

    position: tuple
    spin: tuple
    thrust_coefficient: tuple
    torque_coefficient: tuple
    radius: jax.Array


def hubs_of(rotors) -> Hubs:
    """Return `state.Rotors` by components."""
    count = range(rotors.spin.shape[-1])
    position = tuple(vector(rotors.position[..., i, :]) for i in count)
    singles = (parts(rotors.spin), parts(rotors.thrust_coefficient), parts(rotors.torque_coefficient))
    return Hubs(position, *singles, rotors.radius)


@dataclass(frozen=True)
class Instant:
    """A vehicle at one instant, by components.

    Attributes:
        p_world: m.
        q_world_body: attitude.
        v_body: m/s, velocity through the air.
        omega_body: rad/s.
        rotor_speed: n of (...) rad/s.
        rotor_acceleration: n of (...) rad/s^2.
        hubs: the rotors.
        memory: memory of the terms by name.
    """

    p_world: Vector
    q_world_body: Quaternion
    v_body: Vector
    omega_body: Vector
    rotor_speed: tuple
    rotor_acceleration: tuple
    hubs: Hubs
    memory: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def hub_velocity(self) -> tuple:
        """n Vectors, m/s: velocity of each hub through the air, v + omega x r."""
        v, w = self.v_body, self.omega_body
        return tuple(
            Vector(v.x + w.y * r.z - w.z * r.y, v.y + w.z * r.x - w.x * r.z, v.z + w.x * r.y - w.y * r.x)
            for r in self.hubs.position
        )

    @cached_property
    def squared_speed(self) -> tuple:
        """n squared rotor speeds, rad^2/s^2."""
        return tuple(speed * speed for speed in self.rotor_speed)

    @cached_property
    def thrust(self) -> tuple:
        """n static thrusts c_l Omega^2, N."""
        return tuple(c * squared for c, squared in zip(self.hubs.thrust_coefficient, self.squared_speed, strict=True))

    @cached_property
    def collective(self):
        """Static thrust of all rotors, N."""
        return total(self.thrust)

    @cached_property
    def mean_squared_speed(self):
        """Mean squared rotor speed, rad^2/s^2 (eq. 5)."""
        return total(self.squared_speed) * (1.0 / len(self.rotor_speed))

    @cached_property
    def airspeed(self):
        """Speed through the air, m/s."""
        v = self.v_body
        return jnp.sqrt(v.x * v.x + v.y * v.y + v.z * v.z + 1e-12)

    @cached_property
    def lateral_squared(self):
        """Square of `lateral`, m^2/s^2."""
        return self.v_body.x * self.v_body.x + self.v_body.y * self.v_body.y

    @cached_property
    def lateral(self):
        """Speed through the air across the body's z axis, m/s."""
        return jnp.sqrt(self.lateral_squared + 1e-12)

    @cached_property
    def hub_lateral_squared(self) -> tuple:
        """n squared speeds of the hubs through the air across the body's z axis, m^2/s^2."""
        return tuple(v.x * v.x + v.y * v.y for v in self.hub_velocity)

    @cached_property
    def hub_height(self) -> tuple:
        """n heights of the hubs: z in the world, m."""
        up = up_in_body(self.q_world_body)
        return tuple(self.p_world.z + (up.x * r.x + up.y * r.y + up.z * r.z) for r in self.hubs.position)


def instant_of(motion: Motion, parameters, memory=None) -> Instant:
    """Return a `Motion` by components."""
    p, q, v, omega, speed, acceleration = motion
    turning = (parts(speed), parts(acceleration), hubs_of(parameters.rotors))
    return Instant(vector(p), quaternion(q), vector(v), vector(omega), *turning, memory or {})


@dataclass(frozen=True)
class CompletedStep:
    """A step of the physics, for the memory of the terms.

    Attributes:
        instant: at which its forces were computed.
        specific_force_world: Vector, m/s^2, of all forces but gravity and attached loads.
        dt: s.
        power_w: (...) W, electrical power.
        random: random numbers of mean 0 and variance 1.
    """

    instant: Instant
    specific_force_world: Vector
    dt: float
    power_w: jax.Array
    random: tuple = ()

    def with_random(self, random):
        """Return the same step with other random numbers."""
        return replace(self, random=tuple(random))


def along_z(forces) -> tuple:
    """Return n Vectors of forces along the body's z axis."""
    return tuple(Vector(z=force) for force in forces)


def wrench_of(forces, hubs: Hubs):
    """Return (force, moment) about the centre of mass of forces (n Vectors) at the hubs."""
    moments = [cross(r, f) for r, f in zip(hubs.position, forces, strict=True)]
    return tuple(Vector(*(total(row[i] for row in rows) for i in range(3))) for rows in (forces, moments))
