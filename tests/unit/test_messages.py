"""Messages that nodes read from their CDR bytes: the same numbers as by the classes of ROS."""

import dataclasses

import numpy as np
import pytest
from nav_msgs.msg import Odometry as OdometryMessage

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


def message_by_hand(state: Odometry, frame: str, child: str) -> OdometryMessage:
    """Return a message, field by field."""
    message = OdometryMessage(child_frame_id=child)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(state.stamp_ns, 10**9)
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.position.z = state.p_world
    orientation = pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = state.q_world_body
    twist.linear.x, twist.linear.y, twist.linear.z = state.v_body
    twist.angular.x, twist.angular.y, twist.angular.z = state.omega_body
    if state.covariance_pose is not None:
        message.pose.covariance = state.covariance_pose.ravel()
    return message


@pytest.mark.parametrize("frame", ["", "map", "odom", "a_frame_with_a_longer_name"])  # its length moves what follows
@pytest.mark.parametrize("child", ["base_link", "t265_pose"])
@pytest.mark.parametrize("known", [True, False])
def test_odometry_of_any_frame_is_written_and_read_as_a_message_made_by_hand(frame, child, known):
    rng = np.random.default_rng(len(frame) + len(child))
    p, q, v, omega = (rng.normal(size=n) for n in (3, 4, 3, 3))
    sent = Odometry(STAMP_NS, p, q, v, omega, rng.normal(size=(6, 6)) if known else None)
    message = message_by_hand(sent, frame, child)
    assert to_odometry(sent, frame, child) == message
    assert odometry_bytes(sent, frame, child) == serialize(message)
    whole = serialize(message)
    for read in (from_odometry(message), *map(odometry_from_bytes, (whole, big_endian(whole, 85)))):
        for field in dataclasses.fields(Odometry):
            expected, got = getattr(sent, field.name), getattr(read, field.name)
            assert (expected is None) == (got is None), field.name
            assert expected is None or np.array_equal(got, expected), field.name


def test_a_measurement_of_the_imu_is_read_from_its_bytes():
    message = to_imu(STAMP_NS, (0.1, -0.2, 0.3), (1.0, 2.0, -9.8))
    message.header.frame_id = "imu"
    whole = serialize(message)
    for read in (from_imu(message), *map(imu_from_bytes, (whole, big_endian(whole, 37)))):
        assert read.stamp_ns == STAMP_NS
        assert np.array_equal(np.hstack(dataclasses.astuple(read)[1:]), (0.1, -0.2, 0.3, 1.0, 2.0, -9.8))


def test_bytes_that_are_cut_short_are_refused():
    data = serialize(to_imu(STAMP_NS, np.zeros(3), np.zeros(3)))
    with pytest.raises(ValueError, match="offset"):
        imu_from_bytes(data[:200])
