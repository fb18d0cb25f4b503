"""Vectors and attitudes by components: each component an array (...) of its own.

A step is one long chain of sums and products. On separate components the compiler fuses it into one loop over the
batch; on arrays (..., 3) it moves memory between the operations and is three times slower. A component that is the
plain number 0.0 is known to be zero and costs nothing.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp


class Vector(NamedTuple):
    """Components x, y, z (...); a plain 0.0 is a component known to be zero."""

    x: jax.Array | float = 0.0
    y: jax.Array | float = 0.0
    z: jax.Array | float = 0.0


class Quaternion(NamedTuple):
    """Components x, y, z, w (...) of q_a_b, which rotates vectors of frame b into frame a."""

    x: jax.Array | float
    y: jax.Array | float
    z: jax.Array | float
    w: jax.Array | float


ZERO = Vector()
SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(7))  # series of sin(x)/x in powers of x^2
COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(7))  # series of cos(x) in powers of x^2


def vector(array) -> Vector:
    """Return an array (..., 3) by components."""
    return Vector(*(array[..., i] for i in range(3)))


def quaternion(array) -> Quaternion:
    """Return an array (..., 4) by components."""
    return Quaternion(*(array[..., i] for i in range(4)))


def parts(array) -> tuple:
    """Return the entries (...) of an array (..., n)."""
    return tuple(array[..., i] for i in range(array.shape[-1]))


def stack(components, like=None):
    """Return components as an array (..., k); plain zeros get the shape and type of `like` (...)."""
    if like is not None:
        components = [jnp.zeros_like(like) if is_zero(value) else value for value in components]
    return jnp.stack(jnp.broadcast_arrays(*components), axis=-1)


def is_zero(value) -> bool:
    """Return whether a component is the plain zero, known when the program is traced."""
    return isinstance(value, float) and value == 0.0


def plus(a, b):
    """Return a + b of two components."""
    if is_zero(a):
        return b
    return a if is_zero(b) else a + b


def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return Vector(*map(plus, a, b))


def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return Vector(*(p if is_zero(q) else p - q for p, q in zip(a, b, strict=True)))


def scale(factor, a: Vector) -> Vector:
    """Return factor * a."""
    return Vector(*(0.0 if is_zero(value) else factor * value for value in a))


def total(values):
    """Return the sum of components, left to right."""
    result = 0.0
    for value in values:
        result = plus(result, value)
    return result


def kept(values, parameters):
    """Return a tree of components unchanged, so that the compiler computes it once and stores it.

    Otherwise the compiler recomputes a chain of sums and products for each use, which multiplies the work of a step. It
    does not fuse across a division, and it cannot know that this divisor is one.
    """
    one = parameters.mass / parameters.mass
    return jax.tree.map(lambda value: value if isinstance(value, float) else value / one, values)


def dot(a: Vector, b: Vector):
    """Return the scalar product."""
    return total(0.0 if is_zero(p) or is_zero(q) else p * q for p, q in zip(a, b, strict=True))


def _difference(a, b, c, d):
    """Return a b - c d where any of them may be a plain zero."""
    left = 0.0 if is_zero(a) or is_zero(b) else a * b
    right = 0.0 if is_zero(c) or is_zero(d) else c * d
    if is_zero(right):
        return left
    return -right if is_zero(left) else left - right


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product a x b."""
    return Vector(_difference(a.y, b.z, a.z, b.y), _difference(a.z, b.x, a.x, b.z), _difference(a.x, b.y, a.y, b.x))


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return the vector rotated by q."""
    axis = Vector(q.x, q.y, q.z)
    twice = Vector(*(2.0 * value for value in cross(axis, v)))
    back = cross(axis, twice)
    return Vector(*(p + q.w * t + b for p, t, b in zip(v, twice, back, strict=True)))


def rotate_inverse(q: Quaternion, v: Vector) -> Vector:
    """Return the vector rotated by the inverse of q."""
    return rotate(Quaternion(-q.x, -q.y, -q.z, q.w), v)


def up_in_body(q: Quaternion) -> Vector:
    """Return the world's z axis in the body frame: the last row of the rotation matrix."""
    return Vector(2.0 * (q.x * q.z - q.y * q.w), 2.0 * (q.y * q.z + q.x * q.w), 1.0 - 2.0 * (q.x * q.x + q.y * q.y))


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return q_a_c of q_a_b and q_b_c."""
    return Quaternion(
        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
        a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
    )


def normalize(q: Quaternion) -> Quaternion:
    """Return the unit quaternion."""
    length = jnp.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w + 1e-24)
    return Quaternion(*(value / length for value in q))


def exponential(turn: Vector) -> Quaternion:
    """Return the quaternion of a rotation by |turn| rad about `turn`, by the series of sine and cosine.

    Exact to rounding (1e-15) for rotations up to 1 rad: 500 rad/s in a step of 2 ms.
    """
    squared = 0.25 * dot(turn, turn)
    factor, w = 0.5 * series(squared, SINE), series(squared, COSINE)
    return Quaternion(factor * turn.x, factor * turn.y, factor * turn.z, w)


def series(x, coefficients):
    """Return the polynomial with these coefficients, lowest power first, at x (...)."""
    value = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


def turned(q: Quaternion, omega_body: Vector, dt) -> Quaternion:
    """Return the attitude after `dt` s at constant `omega_body` (rad/s), by the exponential map."""
    return normalize(multiply(q, exponential(Vector(*(rate * dt for rate in omega_body)))))


def apply(matrix, v: Vector) -> Vector:
    """Return matrix (..., 3, 3) times the vector."""
    return Vector(*(total(matrix[..., i, k] * v[k] for k in range(3)) for i in range(3)))
