"""Node runner: hears a race's course for who started its processes, and says when one of them dies."""

import math
import os
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from swift_ros import messages
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.runner import DISCOVERY
from swift_ros.graph.topic_table import TOPICS, VEHICLE_NAMESPACE
from swift_ros.nodes.race_monitor import RUNNER
from swift_ros.race.judge import ENDS, IDLE, LOST, RACING, RaceEvent

SPIN_S = 0.02
SERVICE_PATIENCE_S = 5.0


class Listener:
    """This process's own node in the graph: hears the race's course, and says when a node dies."""

    def __init__(self, domain: int, discovery: str, lockstep: bool, tell):
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = DISCOVERY[discovery]
        self.context = rclpy.Context()
        self.context.init(domain_id=domain)
        self._node = rclpy.create_node(RUNNER, context=self.context, namespace=VEHICLE_NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self._node)
        for name, callback in (("race/status", self._status), ("betaflight/link", self._link)):
            topic = TOPICS[name]
            kind = messages.message_type(topic.type)
            self._node.create_subscription(kind, name, callback, qos_profile(topic, lockstep))
        diagnostics = qos_profile(TOPICS["/diagnostics"], lockstep)
        self._voice = self._node.create_publisher(DiagnosticArray, "/diagnostics", diagnostics)
        self._tell = tell
        self.faults: list[str] = []
        self.begun_ns: int | None = None
        self.end: RaceEvent | None = None
        self.passages = 0
        self.armed = False
        self.link_ns = 0
        self.safe_ns: int | None = None  # stamp of the first word of the link, since the start, that a failsafe acts
        self.disarmed_ns: int | None = None
        self.heard_s = time.monotonic()

    def spin(self) -> None:
        """Hear what there is for a moment."""
        self._executor.spin_once(timeout_sec=SPIN_S)

    def say(self, fault: str) -> None:
        """Print, keep and tell the race monitor that a node is lost."""
        self._tell(f"  {fault}")
        self.faults.append(fault)
        status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name=RUNNER, message=fault)
        self._voice.publish(DiagnosticArray(status=[status]))

    def ends(self, topic: str) -> tuple[list[str], list[str]]:
        """Return the names of the nodes that speak on a topic of the table, and of those that hear it, now."""
        speakers = self._node.get_publishers_info_by_topic(topic)
        hearers = self._node.get_subscriptions_info_by_topic(topic)
        return tuple(sorted(end.node_name for end in ends) for ends in (speakers, hearers))

    def ask(self, service: str) -> str:
        """Call one of the race services; return why it was refused, "" when it was granted."""
        client = self._node.create_client(Trigger, service)
        answer = client.call_async(Trigger.Request())
        deadline_s = time.monotonic() + SERVICE_PATIENCE_S
        while not answer.done() and time.monotonic() < deadline_s:
            self.spin()
        self._node.destroy_client(client)
        if not answer.done():
            return f"{service} did not answer; see the log of race_monitor"
        return "" if answer.result().success else answer.result().message

    def lose(self, why: str) -> None:
        """End the race in the place of a race monitor that cannot."""
        self.end = RaceEvent(self.link_ns, LOST, text=why)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self.context.try_shutdown()

    def _link(self, message) -> None:
        self.armed, self.link_ns = message.armed, messages.stamp_ns(message.header.stamp)
        self.heard_s = time.monotonic()
        if self.begun_ns is not None and self.safe_ns is None and (message.failsafe or not message.armed):
            self.safe_ns = self.link_ns
        if self.begun_ns is not None and self.disarmed_ns is None and not message.armed:
            self.disarmed_ns = self.link_ns

    def _status(self, message) -> None:
        event = messages.from_race_status(message)
        self.heard_s = time.monotonic()
        if event.state == RACING and not event.is_passage:
            self.begun_ns = event.stamp_ns
        self.passages += event.is_passage
        if event.state != IDLE:
            self._tell(self._line(event))
        if event.state in ENDS:
            self.end = event

    def _line(self, event: RaceEvent) -> str:
        clock = f"{1e-9 * (event.stamp_ns - self.begun_ns):7.3f} s" if self.begun_ns is not None else " " * 9
        line = f"  {clock}  {event.text or event.state}"
        if event.is_passage:
            line += f", split {event.split_s:.3f} s"
        if not math.isnan(event.margin_m):
            line += f", margin {event.margin_m:.2f} m"
        return line if event.is_passage or event.state not in ENDS else f"{line} ({event.state})"
