"""Node of a soak: watches the age of the commands, and flies the simulator by topics where a soak asks for it."""

import time

import rclpy
from rclpy.executors import SingleThreadedExecutor

from swift_ros import messages
from swift_ros.graph.discovery import confine
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS, VEHICLE_NAMESPACE
from swift_ros.working_time import PRESSURE
from swift_sim_bridge.soak.hover import hover_command
from swift_sim_bridge.soak.late_commands import LATE_S, LateCommand, Stalls

TRUTH, COMMAND, LINK = "ground_truth/odometry", "command/body_rate_thrust", "betaflight/link"
SPIN_S = 0.02  # s; also the period of the readings of the stalls


class Watcher:
    """Receives betaflight/link of a graph in real time.

    Attributes:
        late: commands that were late since they were last taken from this list.
        commands: number of commands that were answered by a frame.
    """

    def __init__(self, domain: int, flies: bool):
        """Join the graph.

        Args:
            domain: ROS domain.
            flies: publish the commands of a hovering pilot.
        """
        confine()
        self._context = rclpy.Context()
        self._context.init(domain_id=domain)
        self._node = rclpy.create_node("soak", context=self._context, namespace=VEHICLE_NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._stalls, self._place = Stalls(), None
        self.late: list[LateCommand] = []
        self.commands, self._answered_ns = 0, 0
        self._subscribe(LINK, self._on_link)
        if flies:
            topic = TOPICS[COMMAND]
            kind = messages.message_type(topic.type)
            self._command = self._node.create_publisher(kind, topic.name, qos_profile(topic, False))
            self._subscribe(TRUTH, self._on_truth)

    def _subscribe(self, name: str, callback) -> None:
        topic = TOPICS[name]
        self._node.create_subscription(messages.message_type(topic.type), name, callback, qos_profile(topic, False))

    def spin(self) -> None:
        """Process the messages that arrive within SPIN_S."""
        waited = PRESSURE.read_text().partition("\n")[0].rpartition("total=")[2] if PRESSURE.is_file() else "0"
        self._stalls.add(time.time(), 1e-6 * int(waited))
        self._executor.spin_once(timeout_sec=SPIN_S)

    def _on_link(self, message) -> None:
        answered_ns, written_ns = messages.stamp_ns(message.command_stamp), messages.message_stamp_ns(message)
        if not message.armed or answered_ns <= self._answered_ns:
            return
        self._answered_ns, self.commands = answered_ns, self.commands + 1
        late_s = 1e-9 * (written_ns - answered_ns)
        if late_s > LATE_S:
            stalled_s = self._stalls.between(1e-9 * answered_ns, 1e-9 * written_ns)
            self.late.append(LateCommand(answered_ns, late_s, stalled_s))

    def _on_truth(self, message) -> None:
        state = messages.from_odometry(message)
        if self._place is None:
            self._place = state.p_world[:2]
        self._command.publish(messages.to_command(hover_command(state, self._place)))

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
