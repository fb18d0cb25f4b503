"""The functions by which a term acts on the simulated vehicle, and the random stream of each term."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass

from swift_sim_bridge.effects import TermSpecification


@dataclass(frozen=True)
class Term(TermSpecification):
    """A term of the physics: its specification and one or more functions (n: number of rotors).

    Attributes:
        hubs: (instant, coefficients) -> n Vectors: forces at the hubs, body frame, N.
        wrench: (instant, coefficients, parameters) -> (force, moment): Vectors about the centre of mass, body frame,
            N and N m.
        air: (p_world, coefficients, memory) -> Vector: velocity of the air in the world, m/s.
        motor: (coefficients, memory, n) -> n factors of the motors' steady speeds.
        steady_speed: (coefficients, drive) -> rad/s added to the steady speed of a motor (`quantities.Drive`).
        supply: (coefficients, load) -> V added to the voltage of the pack (`quantities.Load`).
        airframe: (parameters, coefficients) -> parameters: a change made once, when the vehicle is built.
        tow: (specific_force_world, coefficients, memory, parameters) -> Vector, m/s^2 in the world: acceleration by
            something attached, given the sum of all other forces but gravity.
        start: (coefficients, zero, normal, n) -> first memory of the term: a dict of arrays shaped as `zero`;
            `normal()` returns new standard normal numbers of that shape at each call.
        advance: (memory, step, coefficients, parameters) -> the memory after a step (`motion.CompletedStep`).
        randoms: (n) -> number of random numbers that a step of `advance` takes.
        check: (coefficients, vehicle); raises ValueError for a coefficient that does not fit the vehicle.
    """

    hubs: Callable | None = None
    wrench: Callable | None = None
    air: Callable | None = None
    motor: Callable | None = None
    steady_speed: Callable | None = None
    supply: Callable | None = None
    airframe: Callable | None = None
    tow: Callable | None = None
    start: Callable | None = None
    advance: Callable | None = None
    randoms: Callable | None = None
    check: Callable | None = None


def salt(name: str) -> int:
    """Return the 32 bit number that makes a term's random stream independent of the others'."""
    return zlib.crc32(name.encode())
