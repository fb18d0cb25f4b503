"""Node topics: receives topics of a running graph, for the commands that inspect it. It is not a row of the table."""

import time

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from swift_ros.graph.discovery import confine
from swift_ros.graph.topic_table import TOPICS, VEHICLE_NAMESPACE, full_name
from swift_ros.messages.serialization import message_type

DISCOVERY_S = 1.5  # s spent on the discovery of a running graph; longer finds slower nodes and delays each command
NAMES_S = 3.0  # s spent at most on the names of the nodes behind the topics; DDS sends them after the topics
UNNAMED = "_NODE_NAME_UNKNOWN_"  # rmw's name of a node whose name has not arrived
POLL_S = 0.05  # s; longest wait for a message before the end of the time is checked
QUEUE_DEPTH = 1000  # messages between two polls; at 100 Hz they are 10 s


class DomainListener:
    """Receives topics of a ROS domain. Use it as a context manager: on entry it waits for discovery."""

    def __init__(self, domain: int):
        confine()
        rclpy.init(domain_id=domain)
        self.node = rclpy.create_node("topics", namespace=VEHICLE_NAMESPACE)

    def __enter__(self):
        self.spin(DISCOVERY_S)
        self.spin(NAMES_S, until=self._publishers_have_names)
        return self

    def __exit__(self, *exception):
        self.node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, seconds: float, until=lambda: False) -> None:
        """Receive messages for `seconds` or until a condition is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            rclpy.spin_once(self.node, timeout_sec=POLL_S)

    def published_topics(self) -> dict[str, str]:
        """Return the types of all topics that have a publisher, by full name."""
        names_and_types = self.node.get_topic_names_and_types()
        return {name: types[0] for name, types in names_and_types if self.node.count_publishers(name)}

    def _publishers_have_names(self) -> bool:
        topics = (name for name, _ in self.node.get_topic_names_and_types())
        return all(info.node_name != UNNAMED for t in topics for info in self.node.get_publishers_info_by_topic(t))

    def subscribe(self, name: str, type_name: str, callback) -> None:
        """Call `callback(data, message_info)` for each message of a topic, also for a latched one sent before.

        Args:
            name: full name of the topic.
            type_name: its type, as in `nav_msgs/msg/Odometry`.
            callback: takes the CDR bytes and the message info of rclpy.
        """
        latched = any(full_name(topic.name) == name and topic.latched for topic in TOPICS.values())
        profile = QoSProfile(
            depth=QUEUE_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self.node.create_subscription(message_type(type_name), name, callback, profile, raw=True)
