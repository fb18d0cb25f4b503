"""Rotations of single NumPy vectors, which have a fast path, beside those of arrays."""

import numpy as np
import pytest

from swift_ros import geometry

RNG = np.random.default_rng(0)
QUATERNIONS = geometry.normalize(RNG.standard_normal((200, 4)))
VECTORS = RNG.standard_normal((200, 3)) * 10.0 ** RNG.uniform(-6.0, 2.0, (200, 1))


@pytest.mark.parametrize(
    ("function", "arrays"),
    [
        (geometry.normalize, (VECTORS,)),
        (geometry.normalize, (np.zeros((1, 3)),)),
        (geometry.cross, (VECTORS, VECTORS[::-1])),
        (geometry.skew, (VECTORS,)),
        (geometry.quaternion_multiply, (QUATERNIONS, QUATERNIONS[::-1])),
        (geometry.quaternion_conjugate, (QUATERNIONS,)),
        (geometry.rotate, (QUATERNIONS, VECTORS)),
        (geometry.rotate_inverse, (QUATERNIONS, VECTORS)),
        (geometry.rotation_matrix, (QUATERNIONS,)),
        (geometry.quaternion_from_rotation_vector, (VECTORS,)),
        (geometry.quaternion_from_rotation_vector, (np.zeros((1, 3)),)),
        (geometry.rotation_vector_from_quaternion, (QUATERNIONS,)),
        (geometry.rotation_vector_from_quaternion, (np.array([[0.0, 0.0, 0.0, -1.0]]),)),
        (geometry.quaternion_from_yaw, (VECTORS[:, 0],)),
    ],
)
def test_a_single_vector_gives_what_its_row_of_an_array_gives(function, arrays):
    rows = function(*arrays)
    for row, *vectors in zip(rows, *arrays, strict=True):
        np.testing.assert_allclose(function(*vectors), row, rtol=4e-16, atol=0.0)


def test_numbers_that_are_not_finite_stay_so():
    for function in (geometry.normalize, geometry.quaternion_from_rotation_vector):
        assert np.isnan(function(np.array([np.nan, 0.0, 1.0]))).all()
    assert np.isnan(geometry.rotation_vector_from_quaternion(np.array([np.nan, 0.0, 0.0, 1.0]))).all()
