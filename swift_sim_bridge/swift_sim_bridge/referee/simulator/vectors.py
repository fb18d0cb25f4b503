"""Vectors and quaternions as tuples of numbers or arrays."""


def parts(rows) -> tuple:
    """Return the leading axis as a tuple."""
    return tuple(rows[i] for i in range(len(rows)))


def add(a, b):
    """Return the sum of two vectors."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def subtract(a, b):
    """Return the difference of two vectors."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


def scale(factor, a):
    """Return a vector times a factor."""
    return tuple(factor * x for x in a)


def dot(a, b):
    """Return the scalar product."""
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    """Return the cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def times(matrix, a):
    """Return a matrix (3, 3) times a vector."""
    return tuple(sum(matrix[i][j] * a[j] for j in range(3)) for i in range(3))


def product(a, b):
    """Return the quaternion a b (x, y, z, w)."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(q, a):
    """Return a vector rotated by a unit quaternion."""
    axis, twice = q[:3], scale(2.0, cross(q[:3], a))
    return add(a, add(scale(q[3], twice), cross(axis, twice)))


def rotate_back(q, a):
    """Return a vector rotated by the inverse of a unit quaternion."""
    return rotate((-q[0], -q[1], -q[2], q[3]), a)
