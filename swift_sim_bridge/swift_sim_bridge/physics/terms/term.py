"""What a term is, and the numbers of random ones."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Term:
    """One effect of the file's `terms`. coefficients: dataclass that mirrors its entry; what it does is one or more of

    hubs(instant, coefficients) -> n Vectors, forces (body frame, N) at the hubs;
    wrench(instant, coefficients, parameters) -> (force, moment) Vectors about the centre of mass, body frame, N, N m;
    air(p_world, coefficients, remembered) -> Vector, velocity of the air in the world, m/s;
    motor(coefficients, remembered, n) -> n factors of the motors' steady speed;
    airframe(parameters, coefficients) -> parameters: a change made once, when the vehicle is built;
    tow(specific_force_world, coefficients, remembered, parameters) -> Vector, m/s^2 in the world, which hangs on what
    all other forces but gravity give the vehicle;
    start(coefficients, zero, normal, n) -> what the effect remembers at first: a dict of arrays shaped as `zero`;
    normal() gives standard normal numbers of that shape, new ones at each call;
    advance(remembered, passed, coefficients, parameters) -> the same, one step (`Passed`) later;
    randoms(n) -> how many random numbers a step of `advance` takes.
    check(coefficients, vehicle) raises ValueError for a coefficient that does not fit the vehicle. n: number of rotors.
    """

    coefficients: type
    hubs: Callable | None = None
    wrench: Callable | None = None
    air: Callable | None = None
    motor: Callable | None = None
    airframe: Callable | None = None
    tow: Callable | None = None
    start: Callable | None = None
    advance: Callable | None = None
    randoms: Callable | None = None
    check: Callable | None = None


def salt(name: str) -> int:
    """Return the number (32 bit) by which an effect's random stream differs from the others'."""
    return zlib.crc32(name.encode())
