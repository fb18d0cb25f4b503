"""Node topics: listens to the graph, of which it is no part. It runs within the commands that look at the graph."""

import os
import time

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from swift_ros import messages
from swift_ros.graph.topic_table import TOPICS, VEHICLE_NAMESPACE, full_name

DISCOVERY_S = 1.5  # to find a graph that is running


class Ear:
    """Hears a ROS domain. Use as a context: entering it gives discovery its time."""

    def __init__(self, domain: int):
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        rclpy.init(domain_id=domain)
        self.node = rclpy.create_node("topics", namespace=VEHICLE_NAMESPACE)

    def __enter__(self):
        self.spin(DISCOVERY_S)
        return self

    def __exit__(self, *exception):
        self.node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, seconds: float, until=lambda: False) -> None:
        """Listen for `seconds` or until a condition holds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def live(self) -> dict[str, str]:
        """Return the types of the topics that somebody speaks, by full name."""
        there = self.node.get_topic_names_and_types()
        return {name: types[0] for name, types in there if self.node.count_publishers(name)}

    def hear(self, name: str, kind: str, callback) -> None:
        """Call back with (bytes, message info) of a topic; what is kept for late joiners is heard as well."""
        latched = any(full_name(topic.name) == name and topic.latched for topic in TOPICS.values())
        quality = QoSProfile(
            depth=1000,
            reliability=ReliabilityPolicy.RELIABLE if latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self.node.create_subscription(messages.message_type(kind), name, callback, quality, raw=True)
