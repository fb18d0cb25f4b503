"""The flight of `flown_logs` as bags of ROS 1 and as SQLite bags of ROS 2, written by the library rosbags."""

from pathlib import Path

import numpy as np
from flown_logs import flight
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

BEGIN_NS = 1_700_000_000_000_000_000
IMU, POSE, TWIST, MOTORS = (
    "sensor_msgs/msg/Imu",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TwistStamped",
    "lab_msgs/msg/Motors",
)
TOPICS = {"/drone/imu": IMU, "/vrpn/drone/pose": POSE, "/vrpn/drone/twist": TWIST, "/drone/motors": MOTORS}
MOTOR_DEFINITION = "std_msgs/Header header\nfloat32[4] share\n"  # a type that no installation has


def write(path: Path) -> Path:
    """Write the flight as a bag of ROS 1 (.bag) or as a folder with an SQLite bag, and return its path."""
    is_ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(MOTOR_DEFINITION, MOTORS))
    bag = rosbag1.Writer(path) if is_ros1 else rosbag2.Writer(path, version=8)
    serialize = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    with bag as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in TOPICS.items()}
        for i in range(len(flight().t)):
            stamp_ns = BEGIN_NS + round(flight().t[i] * 1e9)
            for topic, message in messages(store, i, stamp_ns, is_ros1).items():
                writer.write(connections[topic], stamp_ns, serialize(message, TOPICS[topic]))
    return path


def messages(store, i: int, stamp_ns: int, is_ros1: bool) -> dict:
    """Return the messages of row i by topic."""
    types, flown = store.types, flight()
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **({"seq": i} if is_ros1 else {}))
    vector, none = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    quaternion, point = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Point"]
    pose = types["geometry_msgs/msg/Pose"](position=point(*flown.p[i]), orientation=quaternion(*flown.q[i]))
    twist = types["geometry_msgs/msg/Twist"](linear=vector(*flown.v[i]), angular=vector(0.0, 0.0, 0.0))
    imu = types[IMU](
        header, quaternion(0.0, 0.0, 0.0, 1.0), none, vector(*flown.gyro[i]), none, vector(*flown.force[i]), none
    )
    motors = types[MOTORS](header, flown.motors[i].astype(np.float32))
    found = imu, types[POSE](header, pose), types[TWIST](header, twist), motors
    return dict(zip(TOPICS, found, strict=True))
