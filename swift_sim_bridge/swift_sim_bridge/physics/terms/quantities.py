"""Named quantities of a flying vehicle, and products of them: the summands of an equation in the vehicle file.

A product is a text of factors with spaces between them, each with an optional power: "thrust v_xy^2". The number 1 is
the product without a factor.
"""

import re
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge import units
from swift_sim_bridge.physics.terms.air import AIR_DENSITY
from swift_sim_bridge.physics.terms.motion import Instant
from swift_sim_bridge.physics.terms.vectors import Vector, rotate_inverse, total, up_in_body

MIN_HEIGHT_RADII = 0.5  # lower bound of the height over ground in rotor radii, as in the ground effect
MIN_THRUST_N = 1e-6  # of rotors at rest, whose induced velocity would be zero
NUMBER = r"(-?\d+(?:\.\d*)?)"
NEAR = re.compile(rf"near\({NUMBER},{NUMBER},{NUMBER},(\d+(?:\.\d*)?)\)")  # x, y, z, radius in m
OVER = re.compile(r"over\((.+),(\d+(?:\.\d*)?)\)")  # a quantity, and the value from which on it counts
AROUND = re.compile(r"around\((.+),(\d+(?:\.\d*)?),(\d+(?:\.\d*)?)\)")  # a quantity, a value, and a reach
OF_ROTOR = re.compile(r"(thrust|Omega)_(\d+)")
ROTOR_ALONE = re.compile(r"rotor_([1-9]\d*)")  # 1 for the motor of this rotor, 0 for the others
SPEED, RATE = "m/s", "rad/s"


class Quantity(NamedTuple):
    """A named quantity.

    Attributes:
        unit: its unit; empty for a ratio.
        value: function of an `Instant` that returns it, (...).
        meaning: for a reader.
    """

    unit: str
    value: Callable
    meaning: str


class Drive(NamedTuple):
    """A motor at one instant, for the quantities of MOTOR.

    Attributes:
        command: (...) motor command, 0 to 1.
        voltage: (...) V.
        speed: (...) rad/s.
        number: of its rotor, from 1.
    """

    command: jax.Array
    voltage: jax.Array
    speed: jax.Array
    number: int


class Hub(NamedTuple):
    """A rotor at one instant, for the quantities of ROTOR.

    Attributes:
        thrust: (...) N, static thrust c_l Omega^2.
        speed: (...) rad/s.
        v: Vector, m/s, velocity of the hub through the air, body frame.
        height: (...) m, of the hub.
        p_world: Vector, m, position of the vehicle.
        radius: (...) m.
    """

    thrust: jax.Array
    speed: jax.Array
    v: Vector
    height: jax.Array
    p_world: Vector
    radius: jax.Array

    @property
    def lateral(self):
        """Speed of the hub through the air across the body's z axis, m/s."""
        return jnp.sqrt(self.v.x * self.v.x + self.v.y * self.v.y + 1e-12)


class Load(NamedTuple):
    """The load of the pack at one instant, for the quantities of SUPPLY.

    Attributes:
        current: (...) A.
        charge: (...) A s drawn from the full pack.
        rotor_speed: n of (...) rad/s.
    """

    current: jax.Array
    charge: jax.Array
    rotor_speed: tuple


def _horizontal(instant: Instant, axis: int):
    """Return a horizontal axis of the world (0: x, 1: y) in the body."""
    one = jnp.ones_like(instant.q_world_body.w)
    return rotate_inverse(instant.q_world_body, Vector(*(one if i == axis else 0.0 * one for i in range(3))))


def _sink_ratio(v_z, thrust, radius, rotors: int):
    """Return the sink speed over the velocity that rotors induce in hover at a thrust, from 0 to 2."""
    area = jnp.pi * radius * radius * rotors
    induced = jnp.sqrt(jnp.maximum(thrust, MIN_THRUST_N) / (2.0 * AIR_DENSITY * area))
    return jnp.clip(-v_z / induced, 0.0, 2.0)


def _sink(instant: Instant):
    """Return `_sink_ratio` of all rotors together."""
    return _sink_ratio(instant.v_body.z, instant.collective, instant.hubs.radius, len(instant.rotor_speed))


def _sink_of(hub: Hub):
    """Return `_sink_ratio` of one rotor."""
    return _sink_ratio(hub.v.z, hub.thrust, hub.radius, 1)


def _near_ground(height, radius):
    """Return (R / 4 h)^2."""
    return (0.25 * radius / jnp.maximum(height, MIN_HEIGHT_RADII * radius)) ** 2


def _spinning(values, instant: Instant):
    """Return the sum of values of the rotors, each with its direction of rotation."""
    return total(spin * value for spin, value in zip(instant.hubs.spin, values, strict=True))


MOTION = {
    "v_x": Quantity(SPEED, lambda i: i.v_body.x, "velocity through the air, body frame"),
    "v_y": Quantity(SPEED, lambda i: i.v_body.y, "the same, to the left"),
    "v_z": Quantity(SPEED, lambda i: i.v_body.z, "the same, upwards"),
    "|v|": Quantity(SPEED, lambda i: i.airspeed, "airspeed"),
    "|v_x|": Quantity(SPEED, lambda i: jnp.abs(i.v_body.x), "amount of v_x"),
    "|v_y|": Quantity(SPEED, lambda i: jnp.abs(i.v_body.y), "amount of v_y"),
    "|v_z|": Quantity(SPEED, lambda i: jnp.abs(i.v_body.z), "amount of v_z"),
    "v_xy": Quantity(SPEED, lambda i: i.lateral, "airspeed across the body's z axis"),
    "min(v_z,0)": Quantity(SPEED, lambda i: jnp.minimum(i.v_body.z, 0.0), "v_z while sinking, else 0"),
    "omega_x": Quantity(RATE, lambda i: i.omega_body.x, "body rate in roll"),
    "omega_y": Quantity(RATE, lambda i: i.omega_body.y, "body rate in pitch"),
    "omega_z": Quantity(RATE, lambda i: i.omega_body.z, "body rate in yaw"),
    "thrust": Quantity("N", lambda i: i.collective, "thrust of all rotors by their speeds"),
    "Omega": Quantity(RATE, lambda i: total(i.rotor_speed) / len(i.rotor_speed), "mean rotor speed"),
    "mu": Quantity(
        "",
        lambda i: i.lateral * len(i.rotor_speed) / jnp.maximum(total(i.rotor_speed) * i.hubs.radius, 1.0),
        "advance ratio: v_xy over the mean speed of the blade tips",
    ),
    "spin_Omega": Quantity(RATE, lambda i: _spinning(i.rotor_speed, i), "sum of the rotors' speeds, signed by spin"),
    "spin_Omega'": Quantity("rad/s^2", lambda i: _spinning(i.rotor_acceleration, i), "its rate"),
    "up_x": Quantity("", lambda i: up_in_body(i.q_world_body).x, "world's z axis in the body"),
    "up_y": Quantity("", lambda i: up_in_body(i.q_world_body).y, "the same, y"),
    "up_z": Quantity("", lambda i: up_in_body(i.q_world_body).z, "the same, z"),
    "east_x": Quantity("", lambda i: _horizontal(i, 0).x, "world's x axis in the body"),
    "east_y": Quantity("", lambda i: _horizontal(i, 0).y, "the same, y"),
    "east_z": Quantity("", lambda i: _horizontal(i, 0).z, "the same, z"),
    "north_x": Quantity("", lambda i: _horizontal(i, 1).x, "world's y axis in the body"),
    "north_y": Quantity("", lambda i: _horizontal(i, 1).y, "the same, y"),
    "north_z": Quantity("", lambda i: _horizontal(i, 1).z, "the same, z"),
    "ground": Quantity(
        "", lambda i: _near_ground(i.p_world.z, i.hubs.radius), "(R / 4 h)^2, R the rotor radius and h the height"
    ),
    "sink": Quantity("", _sink, "sink speed over the induced velocity, from 0 to 2"),
    "ring": Quantity("", lambda i: _sink(i) * (2.0 - _sink(i)), "sink (2 - sink): largest in the vortex ring"),
}
MOTOR = {
    "u": Quantity("", lambda d: d.command, "motor command, 0 to 1"),
    "sqrt(u)": Quantity("", lambda d: jnp.sqrt(d.command), "its square root"),
    "U": Quantity("V", lambda d: d.voltage, "voltage of the pack"),
    "Omega": Quantity(RATE, lambda d: d.speed, "speed of this rotor"),
}
ROTOR = {
    "thrust": Quantity("N", lambda h: h.thrust, "thrust of this rotor by its speed"),
    "Omega": Quantity(RATE, lambda h: h.speed, "speed of this rotor"),
    "v_z": Quantity(SPEED, lambda h: h.v.z, "velocity of the hub through the air, upwards"),
    "min(v_z,0)": Quantity(SPEED, lambda h: jnp.minimum(h.v.z, 0.0), "v_z while sinking, else 0"),
    "v_xy": Quantity(SPEED, lambda h: h.lateral, "airspeed of the hub across the body's z axis"),
    "mu": Quantity(
        "",
        lambda h: h.lateral / jnp.maximum(h.speed * h.radius, 1.0),
        "advance ratio: v_xy over that of the blade tips",
    ),
    "sink": Quantity("", _sink_of, "sink speed over the velocity that this rotor induces, from 0 to 2"),
    "ring": Quantity("", lambda h: _sink_of(h) * (2.0 - _sink_of(h)), "sink (2 - sink)"),
    "ground": Quantity("", lambda h: _near_ground(h.height, h.radius), "(R / 4 h)^2, h the height of the hub"),
}
SUPPLY = {
    "current": Quantity("A", lambda p: p.current, "current of the pack"),
    "charge": Quantity("A s", lambda p: p.charge, "charge drawn from the full pack"),
    "Omega^3": Quantity("rad^3/s^3", lambda p: total(x * x * x for x in p.rotor_speed), "sum over the rotors"),
}


def factors(product: str) -> tuple[tuple[str, int], ...]:
    """Return the (name, power) of each factor of a product."""
    found = []
    for factor in product.split():
        name, _, power = factor.partition("^")
        found.append((factor, 1) if factor in SUPPLY else (name, int(power or 1)))
    return tuple((name, power) for name, power in found if name != "1")


@cache
def product_of(product: str, known: str = "motion") -> Quantity:
    """Return a product as one quantity.

    Args:
        product: such as "thrust v_xy^2".
        known: quantities that it may have: `motion`, `rotor`, `motor` or `supply`.

    Raises:
        ValueError: a factor is unknown.
    """
    rows = [(_quantity(name, known), power) for name, power in factors(product)]

    def value(at):
        result = 1.0
        for quantity, power in rows:
            for _ in range(power):
                result = result * quantity.value(at)
        return result

    unit = units.product(*(quantity.unit for quantity, power in rows for _ in range(power)))
    return Quantity(unit, value, product)


def _quantity(name: str, known: str) -> Quantity:
    """Return a quantity by its name. Raises ValueError for an unknown one."""
    table = {"motion": MOTION, "rotor": ROTOR, "motor": MOTOR, "supply": SUPPLY}[known]
    if name in table:
        return table[name]
    if (bend := OVER.fullmatch(name)) and bend[1] in table:
        return _over(table[bend[1]], float(bend[2]))
    if (peak := AROUND.fullmatch(name)) and peak[1] in table and float(peak[3]) > 0:
        return _around(table[peak[1]], float(peak[2]), float(peak[3]))
    if known in ("motion", "rotor") and (place := NEAR.fullmatch(name)):
        return _near(*map(float, place.groups()))
    if known == "motion" and (rotor := OF_ROTOR.fullmatch(name)):
        return _of_rotor(rotor[1], int(rotor[2]))
    if known == "motor" and (rotor := ROTOR_ALONE.fullmatch(name)):
        return _alone(int(rotor[1]))
    raise ValueError(f"has no quantity '{name}'; there are {', '.join(table)}")


def _over(one: Quantity, bend: float) -> Quantity:
    """Return by how much a quantity exceeds a value; zero below."""
    return Quantity(one.unit, lambda at: jnp.maximum(one.value(at) - bend, 0.0), f"{one.meaning}, less {bend:g}, or 0")


def _around(one: Quantity, center: float, reach: float) -> Quantity:
    """Return (1 - d^2/reach^2)^2 within `reach` of a value of a quantity, d the distance from it; zero beyond."""

    def value(at):
        return jnp.maximum(1.0 - ((one.value(at) - center) / reach) ** 2, 0.0) ** 2

    return Quantity("", value, f"1 where it is {center:g}, 0 farther than {reach:g} from it: {one.meaning}")


def _near(x: float, y: float, z: float, radius: float) -> Quantity:
    """Return (1 - d^2/radius^2)^2 within `radius` m of a place, d the distance from it; zero beyond."""

    def value(at: Instant | Hub):
        p = at.p_world
        apart = (p.x - x) ** 2 + (p.y - y) ** 2 + (p.z - z) ** 2
        return jnp.maximum(1.0 - apart / (radius * radius), 0.0) ** 2

    return Quantity("", value, "1 at a place, 0 beyond a radius from it")


def hubs(instant: Instant) -> tuple[Hub, ...]:
    """Return each rotor of a vehicle at an instant."""
    rows = zip(instant.thrust, instant.rotor_speed, instant.hub_velocity, instant.hub_height, strict=True)
    return tuple(Hub(*row, instant.p_world, instant.hubs.radius) for row in rows)


def _of_rotor(name: str, number: int) -> Quantity:
    """Return thrust or speed of one rotor, from 1; 0 for a rotor that the vehicle lacks."""

    def value(instant: Instant):
        values = instant.thrust if name == "thrust" else instant.rotor_speed
        return values[number - 1] if 1 <= number <= len(values) else 0.0 * values[0]

    return Quantity(MOTION[name].unit, value, f"{name} of rotor {number}")


def _alone(number: int) -> Quantity:
    """Return 1 for the motor of one rotor, from 1, and 0 for the others."""
    meaning = f"1 for the motor of rotor {number}, 0 for the others"
    return Quantity("", lambda drive: float(drive.number == number), meaning)
