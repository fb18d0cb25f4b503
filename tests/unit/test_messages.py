"""Messages that nodes read from their CDR bytes: the same numbers as by the classes of ROS."""

import dataclasses

import numpy as np
import pytest

from swift_ros.messages.motion import (
    from_imu,
    from_odometry,
    imu_from_bytes,
    odometry_bytes,
    odometry_from_bytes,
    to_imu,
    to_odometry,
)
from swift_ros.messages.serialization import serialize
from swift_ros.types import Odometry

STAMP_NS = 12_345_678_901_234


def big_endian(data: bytes, words: int) -> bytes:
    """Return CDR bytes whose last `words` numbers of 8 bytes, and whose stamp, have the other byte order."""
    start = len(data) - 8 * words
    numbers = np.frombuffer(data, "<f8", words, start).astype(">f8").tobytes()
    stamp = np.frombuffer(data, "<i4", 2, 4).astype(">i4").tobytes()
    return bytes([data[0], data[1] & ~1, *data[2:4]]) + stamp + data[12:start] + numbers


@pytest.mark.parametrize("frame", ["", "map", "odom", "a_frame_with_a_longer_name"])  # its length moves what follows
@pytest.mark.parametrize("child", ["base_link", "t265_pose"])
@pytest.mark.parametrize("known", [True, False])
def test_odometry_of_any_frame_is_read_from_its_bytes(frame, child, known):
    rng = np.random.default_rng(len(frame) + len(child))
    p, q, v, omega = (rng.normal(size=n) for n in (3, 4, 3, 3))
    sent = Odometry(STAMP_NS, p, q, v, omega, rng.normal(size=(6, 6)) if known else None)
    message = to_odometry(sent, frame, child)
    assert odometry_bytes(sent, frame, child) == serialize(message)
    for data in (serialize(message), big_endian(serialize(message), 85)):
        read = odometry_from_bytes(data)
        for field in dataclasses.fields(Odometry):
            expected, got = getattr(from_odometry(message), field.name), getattr(read, field.name)
            assert (expected is None) == (got is None), field.name
            assert expected is None or np.array_equal(got, expected), field.name


def test_a_measurement_of_the_imu_is_read_from_its_bytes():
    message = to_imu(STAMP_NS, (0.1, -0.2, 0.3), (1.0, 2.0, -9.8))
    message.header.frame_id = "imu"
    for data in (serialize(message), big_endian(serialize(message), 37)):
        read = imu_from_bytes(data)
        assert read.stamp_ns == from_imu(message).stamp_ns == STAMP_NS
        assert np.array_equal(np.hstack(dataclasses.astuple(read)[1:]), (0.1, -0.2, 0.3, 1.0, 2.0, -9.8))


def test_bytes_that_are_cut_short_are_refused():
    data = serialize(to_imu(STAMP_NS, np.zeros(3), np.zeros(3)))
    with pytest.raises(ValueError, match="offset"):
        imu_from_bytes(data[:200])
