"""How the vehicle moves: odometry and the measurements of the IMU."""

import numpy as np
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import Imu

from swift_ros.messages.stamps import from_time, to_time
from swift_ros.messages.vectors import from_quaternion, from_xyz, to_pose, to_vector
from swift_ros.types import ImuSample, Odometry


def to_odometry(state: Odometry, frame: str, child_frame: str = "base_link") -> OdometryMessage:
    """Return nav_msgs/Odometry: pose in `frame`, twist in `child_frame`."""
    message = OdometryMessage(child_frame_id=child_frame)
    message.header.stamp = to_time(state.stamp_ns)
    message.header.frame_id = frame
    message.pose.pose = to_pose(state.p_world, state.q_world_body)
    message.twist.twist.linear = to_vector(state.v_body)
    message.twist.twist.angular = to_vector(state.omega_body)
    if state.covariance_pose is not None:
        message.pose.covariance = np.asarray(state.covariance_pose, dtype=float).ravel()
    return message


def from_odometry(message: OdometryMessage) -> Odometry:
    """Return the odometry of a message with its twist in the body frame; a covariance of zeros is None."""
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    return Odometry(
        stamp_ns=from_time(message.header.stamp),
        p_world=from_xyz(message.pose.pose.position),
        q_world_body=from_quaternion(message.pose.pose.orientation),
        v_body=from_xyz(message.twist.twist.linear),
        omega_body=from_xyz(message.twist.twist.angular),
        covariance_pose=covariance if covariance.any() else None,
    )


def to_imu(sample_stamp_ns: int, gyro, specific_force_body) -> Imu:
    """Return sensor_msgs/Imu from rates (3,) rad/s and specific force (3,) m/s^2, without orientation."""
    message = Imu()
    message.header.stamp = to_time(sample_stamp_ns)
    message.header.frame_id = "base_link"
    message.angular_velocity = to_vector(gyro)
    message.linear_acceleration = to_vector(specific_force_body)
    message.orientation_covariance[0] = -1.0
    return message


def from_imu(message: Imu) -> ImuSample:
    """Return rates and specific force of a message."""
    omega, force = from_xyz(message.angular_velocity), from_xyz(message.linear_acceleration)
    return ImuSample(from_time(message.header.stamp), omega, force)
