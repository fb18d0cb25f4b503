"""Vectors, attitudes and poses."""

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3, Vector3Stamped

from swift_ros.messages.stamps import to_time


def to_vector(values) -> Vector3:
    """Return the Vector3 of (3,)."""
    x, y, z = (float(v) for v in values)
    return Vector3(x=x, y=y, z=z)


def from_xyz(message) -> np.ndarray:
    """Return the components (3,) of a Vector3 or Point."""
    return np.array([message.x, message.y, message.z])


def to_quaternion(q) -> Quaternion:
    """Return the Quaternion of (4,) x y z w."""
    x, y, z, w = (float(v) for v in q)
    return Quaternion(x=x, y=y, z=z, w=w)


def from_quaternion(message: Quaternion) -> np.ndarray:
    """Return the components (4,) x y z w, not normalised."""
    return np.array([message.x, message.y, message.z, message.w])


def to_pose(position, q) -> Pose:
    """Return the Pose of a position (3,) and a quaternion (4,)."""
    x, y, z = (float(v) for v in position)
    return Pose(position=Point(x=x, y=y, z=z), orientation=to_quaternion(q))


def to_stamped_vector(now_ns: int, values) -> Vector3Stamped:
    """Return geometry_msgs/Vector3Stamped from values (3,) in base_link."""
    message = Vector3Stamped(vector=to_vector(values))
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    return message
