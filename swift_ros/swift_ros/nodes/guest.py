"""A node that a command adds to a graph, in a ROS context of its own. It is not a row of the table."""

import time

import rclpy
from rclpy.experimental import EventsExecutor

from swift_ros.graph.discovery import confine
from swift_ros.graph.qos import DEEP, qos_profile
from swift_ros.graph.topic_table import TOPICS, VEHICLE_NAMESPACE
from swift_ros.messages.serialization import message_type


class Guest:
    """A node in the graph of a ROS domain.

    Args:
        name: of the node.
        domain: ROS domain.
        lockstep: whether the graph runs on simulated time.

    Attributes:
        node: the node.
        executor: its executor.
        context: its ROS context.
    """

    def __init__(self, name: str, domain: int, lockstep: bool):
        confine()
        self._lockstep = lockstep
        self.context = rclpy.Context()
        self.context.init(domain_id=domain)
        self.node = rclpy.create_node(name, context=self.context, namespace=VEHICLE_NAMESPACE)
        self.executor = EventsExecutor(context=self.context)
        self.executor.add_node(self.node)

    def publisher(self, name: str):
        """Return a publisher of a topic of the table."""
        topic = TOPICS[name]
        return self.node.create_publisher(message_type(topic.type), topic.name, qos_profile(topic, self._lockstep))

    def subscribe(self, name: str, callback, raw: bool = False, counts: bool = False) -> None:
        """Call `callback` with each message of a topic of the table.

        Args:
            name: of the topic.
            callback: called with a message.
            raw: hand over CDR bytes instead of messages.
            counts: queue all messages while this process is late, in real time too. It has no priority, and what it
                counts must not depend on its delays; what acts on messages needs the newest.
        """
        topic = TOPICS[name]
        profile = qos_profile(topic, self._lockstep)
        if counts:
            profile.depth = DEEP
        self.node.create_subscription(message_type(topic.type), topic.name, callback, profile, raw=raw)

    def spin_once(self, timeout_s: float) -> None:
        """Process one message, or none that arrives within `timeout_s`."""
        self.executor.spin_once(timeout_sec=timeout_s)

    def spin(self, period_s: float) -> None:
        """Process the messages of a period, s."""
        deadline_s = time.monotonic() + period_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            self.spin_once(left_s)

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
