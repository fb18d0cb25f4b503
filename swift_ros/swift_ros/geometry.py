"""Rotations and rigid transforms, for any array library and any leading batch dimensions.

Quaternions have length one and the order (x, y, z, w). `q_a_b` rotates vectors from frame b to frame a.
Positions are `p_frame`, velocities `v_frame`, body rates `omega_body` (rad/s). Body frame: x forward, y left, z up.
Every function takes NumPy or JAX arrays and returns arrays of the same library.
"""

import math
from functools import partial
from typing import Any

import array_api_compat
import numpy as np

_NUMPY = array_api_compat.array_namespace(np.empty(0))
# Of each entry of a skew-symmetric matrix: the component of the vector, and its sign.
SKEW_COMPONENTS = np.array([[0, 2, 1], [2, 0, 0], [1, 0, 0]])
SKEW_SIGNS = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])


def array_namespace(*arrays):
    """Return the array library of the arrays, with a fast path for NumPy."""
    if all(type(array) is np.ndarray for array in arrays):
        return _NUMPY
    return array_api_compat.array_namespace(*arrays)


def _floats(*arrays) -> list[list[float]] | None:
    """Return the components of single NumPy vectors as lists of Python floats, None for all other arrays.

    Arithmetic on floats has the same results as on arrays so short, in a tenth of the time.
    """
    floats = []
    for array in arrays:  # a generator in all() would take longer than the arithmetic
        if type(array) is not np.ndarray or array.ndim != 1 or array.dtype.char != "d":
            return None
        floats.append(array.tolist())
    return floats


def _components(*arrays):
    """Return a function that joins k components to an array (..., k), and the components of each array."""
    if floats := _floats(*arrays):
        return np.array, *floats
    join = partial(array_namespace(*arrays).stack, axis=-1)
    return join, *(tuple(array[..., i] for i in range(array.shape[-1])) for array in arrays)


def normalize(vector, floor: float = 1e-12) -> Any:
    """Return `vector` (..., n) scaled to length one along its last axis; the result is finite for a zero vector."""
    if floats := _floats(vector):
        return vector / math.hypot(*floats[0], floor)
    xp = array_namespace(vector)
    return vector / xp.sqrt(xp.sum(vector * vector, axis=-1, keepdims=True) + floor**2)


def cross(a, b):
    """Return the cross product of (..., 3) vectors."""
    join, (ax, ay, az), (bx, by, bz) = _components(a, b)
    return join([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def skew(vector):
    """Return the skew-symmetric matrix (..., 3, 3) of a vector: its product with u is `vector` x u."""
    if floats := _floats(vector):
        x, y, z = floats[0]
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return vector[..., SKEW_COMPONENTS] * SKEW_SIGNS.astype(vector.dtype)


def quaternion_multiply(q_a_b, q_b_c):
    """Return q_a_c (..., 4)."""
    join, (x1, y1, z1, w1), (x2, y2, z2, w2) = _components(q_a_b, q_b_c)
    return join(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )


def quaternion_conjugate(q_a_b):
    """Return q_b_a (..., 4)."""
    if floats := _floats(q_a_b):
        x, y, z, w = floats[0]
        return np.array([-x, -y, -z, w])
    xp = array_namespace(q_a_b)
    return xp.concat([-q_a_b[..., :3], q_a_b[..., 3:]], axis=-1)


def rotate(q_a_b, v_b) -> Any:
    """Return v_a (..., 3): the vector `v_b` in frame a."""
    if floats := _floats(q_a_b, v_b):
        (x, y, z, w), (vx, vy, vz) = floats
        tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
        return np.array(
            [vx + w * tx + (y * tz - z * ty), vy + w * ty + (z * tx - x * tz), vz + w * tz + (x * ty - y * tx)]
        )
    axis, w = q_a_b[..., :3], q_a_b[..., 3:]
    twice = 2.0 * cross(axis, v_b)
    return v_b + w * twice + cross(axis, twice)


def rotate_inverse(q_a_b, v_a):
    """Return v_b (..., 3): the vector `v_a` in frame b."""
    return rotate(quaternion_conjugate(q_a_b), v_a)


def rotation_matrix(q_a_b):
    """Return the (..., 3, 3) matrix R with v_a = R v_b."""
    join, (x, y, z, w) = _components(q_a_b)
    entries = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    matrix = join(entries)  # a single stack takes a third of the time of four in NumPy
    return matrix.reshape(*matrix.shape[:-1], 3, 3)


def quaternion_from_matrix(rotation):
    """Return q (..., 4), w >= 0, of rotation matrices (..., 3, 3), by the best conditioned of four forms."""
    xp = array_namespace(rotation)
    m = rotation
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    d0, d1, d2 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # Rows of 4 q q^T: the row with the largest diagonal is the best conditioned multiple of q.
    xx, yy, zz, ww = 1 + 2 * d0 - trace, 1 + 2 * d1 - trace, 1 + 2 * d2 - trace, 1 + trace
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    xw, yw, zw = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    rows = [xp.stack(row, axis=-1) for row in ((xx, xy, xz, xw), (xy, yy, yz, yw), (xz, yz, zz, zw), (xw, yw, zw, ww))]
    diagonal = xp.stack([xx, yy, zz, ww], axis=-1)
    best = xp.argmax(diagonal, axis=-1)[..., None]
    q = sum(xp.where(best == i, rows[i], xp.zeros_like(rows[i])) for i in range(4))
    q = normalize(q)
    return xp.where(q[..., 3:] < 0, -q, q)


def quaternion_from_rotation_vector(rotation_vector):
    """Return q (..., 4) of a rotation by |v| rad about v (..., 3); exact and differentiable at v = 0."""
    if floats := _floats(rotation_vector):
        x, y, z = floats[0]
        squared = x * x + y * y + z * z
        if squared < 1e-8:
            scale, w = 0.5 - squared / 48.0, 1.0 - squared / 8.0
        else:
            angle = math.sqrt(squared)
            scale, w = float(np.sin(0.5 * angle)) / angle, float(np.cos(0.5 * angle))
        return np.array([scale * x, scale * y, scale * z, w])
    xp = array_namespace(rotation_vector)
    squared = xp.sum(rotation_vector * rotation_vector, axis=-1, keepdims=True)
    small = squared < 1e-8
    angle = xp.sqrt(xp.where(small, 1.0, squared))
    scale = xp.where(small, 0.5 - squared / 48.0, xp.sin(0.5 * angle) / angle)
    w = xp.where(small, 1.0 - squared / 8.0, xp.cos(0.5 * angle))
    return xp.concat([scale * rotation_vector, w], axis=-1)


def rotation_vector_from_quaternion(q_a_b):
    """Return the rotation vector (..., 3) of `q_a_b`, of length at most pi."""
    if floats := _floats(q_a_b):
        x, y, z, w = (-each for each in floats[0]) if floats[0][3] < 0 else floats[0]
        squared = x * x + y * y + z * z
        sine = math.sqrt(squared)
        scale = 2.0 + squared / 3.0 if squared < 1e-12 else 2.0 * float(np.arctan2(sine, w)) / sine
        return np.array([scale * x, scale * y, scale * z])
    xp = array_namespace(q_a_b)
    q = xp.where(q_a_b[..., 3:] < 0, -q_a_b, q_a_b)
    squared = xp.sum(q[..., :3] * q[..., :3], axis=-1, keepdims=True)
    small = squared < 1e-12
    sine = xp.sqrt(xp.where(small, xp.ones_like(squared), squared))
    scale = xp.where(small, 2.0 + squared / 3.0, 2.0 * xp.atan2(sine, q[..., 3:]) / sine)
    return scale * q[..., :3]


def quaternion_from_yaw(yaw):
    """Return q (..., 4) of a rotation by `yaw` rad about z."""
    if isinstance(yaw, float):
        return np.array([0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    xp = array_namespace(yaw)
    zero = xp.zeros_like(yaw)
    return xp.stack([zero, zero, xp.sin(0.5 * yaw), xp.cos(0.5 * yaw)], axis=-1)


def yaw_of(q_world_body):
    """Return the heading (...) of the body's x axis about the world's z axis, rad."""
    xp = array_namespace(q_world_body)
    x, y, z, w = (q_world_body[..., i] for i in range(4))
    return xp.atan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))


def tilt_of(q_world_body):
    """Return the angle (...) between the body's z axis and the world's, rad."""
    xp = array_namespace(q_world_body)
    x, y = q_world_body[..., 0], q_world_body[..., 1]
    return xp.acos(xp.clip(1 - 2 * (x * x + y * y), -1.0, 1.0))


def integrate_quaternion(q_world_body, omega_body, dt: float):
    """Return the attitude after a rotation at constant `omega_body` for `dt` s (exponential map, length one)."""
    return normalize(quaternion_multiply(q_world_body, quaternion_from_rotation_vector(omega_body * dt)))
