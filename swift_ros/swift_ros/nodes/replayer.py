"""Node replayer: the simulator's part in a replay. Keeps the clock, plays a recording's messages, waits for answers.

It runs within `swiftros replay`, which starts the nodes that hear it.
"""

import time
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rosgraph_msgs.msg import Clock

from swift_ros import messages
from swift_ros.graph.topic_table import NODES, TOPICS, VEHICLE_NAMESPACE, full_name
from swift_ros.nodes.shell import LEVELS, quality
from swift_ros.recording.bags import BagWriter
from swift_ros.recording.replay import DETECTIONS, IMAGE, ODOMETRY, POSES, RAW, STATE, Plan, Play
from swift_ros.recording.writer import offered_qos

START_PATIENCE_S = 90.0  # networks are loaded
PATIENCE_S = 10.0  # for an answer
COMPLAINT_PATIENCE_S = 0.2  # for an answer after a node complained: it may have refused what was played
CHECK_EVERY_S = 0.25
CUT_OFF = "ROS was shut down in this process"


class Stuck(Exception):
    """The nodes no longer answer; the sentence says which message was the last."""


class Replayer:
    """Plays a recording to the nodes of a plan and writes what is played and answered into a new bag.

    domain: ROS domain; faults: returns a sentence for each node that died since the last call. played, heard: messages
    by topic; refused: odometry that brought a complaint instead of a state.
    """

    def __init__(self, plan: Plan, writer: BagWriter, domain: int, faults: Callable[[], list[str]]):
        self._plan, self._writer, self._faults = plan, writer, faults
        self.context = rclpy.Context()
        self.context.init(domain_id=domain)
        self._node = rclpy.create_node("replayer", context=self.context, namespace=VEHICLE_NAMESPACE)
        self._executor = EventsExecutor(context=self.context)
        self._executor.add_node(self._node)
        self._voices = {name: self._speak(name) for name in (*plan.played, "/clock")}
        self.heard = dict.fromkeys(plan.made, 0)
        for name in (*plan.made, "/diagnostics"):
            self._hear(name)
        self._clock_ns, self._asked_ns, self._state_ns = -1, None, -1
        self._complained, self._checked_s = False, 0.0
        self.played = dict.fromkeys(plan.played, 0)
        self.refused = 0

    def copies(self, types: dict[str, str]) -> None:
        """Declare topics that are copied from the recording, by name, with their types."""
        for name, kind in types.items():
            offered = offered_qos(quality(TOPICS[name], True)) if name in TOPICS else ""
            self._writer.add_topic(full_name(name), kind, offered)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self.context.try_shutdown()

    def _speak(self, name: str):
        topic = TOPICS[name]
        profile = quality(topic, True)
        self._writer.add_topic(full_name(name), topic.type, offered_qos(profile))
        return self._node.create_publisher(messages.message_type(topic.type), name, profile)

    def _hear(self, name: str) -> None:
        topic = TOPICS[name]
        self._writer.add_topic(full_name(name), topic.type, offered_qos(quality(topic, True)))
        kind = messages.message_type(topic.type)

        def heard(data: bytes) -> None:
            self._write(name, bytes(data))
            if name == "/diagnostics":
                statuses = messages.deserialize(data, topic.type).status
                self._complained |= any(status.level != LEVELS["ok"] for status in statuses)
            else:
                self.heard[name] += 1
            if name == STATE:
                self._state_ns = messages.header_stamp_ns(data)

        self._node.create_subscription(kind, name, heard, quality(topic, True), raw=True)

    def _write(self, name: str, data: bytes) -> None:
        stamped = name != "/clock"
        now_ns = max(self._clock_ns, 0)
        self._writer.write(full_name(name), data, now_ns, messages.header_stamp_ns(data) if stamped else now_ns)

    def await_graph(self) -> None:
        """Return when every node is there and has found what it hears. Raises Stuck naming who stays away."""
        deadline_s = time.monotonic() + START_PATIENCE_S
        while missing := self._missing():
            self._check()
            if time.monotonic() > deadline_s:
                raise Stuck(f"{', '.join(missing)} did not start within {START_PATIENCE_S:.0f} s")
            self._listen(0.1)

    def _missing(self) -> list[str]:
        missing = []
        for name in self._plan.nodes:
            speaks = [self._node.get_publishers_info_by_topic(topic) for topic in NODES[name].publishes]
            hears = [self._node.get_subscriptions_info_by_topic(topic) for topic in NODES[name].hears]
            if not all(any(end.node_name == name for end in ends) for ends in (*speaks, *hears)):
                missing.append(name)
        # Images are not kept for who comes late.
        if not missing and IMAGE in self._voices and self._voices[IMAGE].get_subscription_count() < 1:
            missing.append("gate_detector")
        return missing

    def play(self, item: Play) -> None:
        """Play one message, when all that came before has been answered. Raises Stuck."""
        if not item.to_nodes:
            self._writer.write(full_name(item.topic), item.data, item.at_ns)
            return
        if item.at_ns > self._clock_ns:
            self._answered()
            self._clock_ns = item.at_ns
            clock = Clock(clock=messages.to_time(item.at_ns))
            self._voices["/clock"].publish(clock)
            self._write("/clock", messages.serialize(clock))
        self._voices[item.topic].publish(item.data)
        self._write(item.topic, item.data)
        self.played[item.topic] += 1
        if item.topic in (RAW, ODOMETRY):
            self._asked_ns = messages.header_stamp_ns(item.data)

    def _answered(self) -> None:
        """Wait for the state of the odometry played last."""
        if self._asked_ns is None:
            return
        if not self._wait(lambda: self._state_ns >= self._asked_ns):
            if not self._complained:
                raise Stuck(f"no state came for the odometry of {1e-9 * self._asked_ns:.3f} s")
            self.refused += 1
        self._asked_ns, self._complained = None, False

    def finish(self) -> None:
        """Wait for the answers to what was played last. Raises Stuck when an image was never answered."""
        self._answered()
        for asked, answer in ((IMAGE, DETECTIONS), (DETECTIONS, POSES)):
            if answer not in self.heard:
                continue
            number = self.played.get(asked, self.heard.get(asked, 0))
            if not self._wait(lambda answer=answer, number=number: self.heard[answer] >= number):
                raise Stuck(f"{number} messages of {asked} brought only {self.heard[answer]} of {answer}")

    def _wait(self, condition: Callable[[], bool]) -> bool:
        begun_s = time.monotonic()
        while not condition():
            patience_s = COMPLAINT_PATIENCE_S if self._complained else PATIENCE_S
            if time.monotonic() - begun_s > patience_s:
                return False
            self._listen(0.05)
            self._check()
        return True

    def _listen(self, patience_s: float) -> None:
        """Hear what there is, for so long at the most. Raises Stuck when ROS was shut down."""
        try:
            self._executor.spin_once(timeout_sec=patience_s)
        except ExternalShutdownException as error:
            raise Stuck(CUT_OFF) from error

    def _check(self) -> None:
        """Raise Stuck when a node died, or ROS was shut down."""
        if not self.context.ok():
            raise Stuck(CUT_OFF)
        if time.monotonic() - self._checked_s > CHECK_EVERY_S:
            self._checked_s = time.monotonic()
            for fault in self._faults():
                raise Stuck(fault)
