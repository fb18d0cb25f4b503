"""Node replayer: replaces the simulator in a replay. Publishes the clock and recorded messages, waits for answers.

It runs inside `swiftros replay`, which also starts the nodes that subscribe to it.
"""

import time
from collections.abc import Callable

from rclpy.executors import ExternalShutdownException
from rosgraph_msgs.msg import Clock

from swift_ros.graph.qos import qos_profile
from swift_ros.graph.runner import NodeFault
from swift_ros.graph.topic_table import NODES, TOPICS, full_name
from swift_ros.messages.serialization import deserialize, serialize
from swift_ros.messages.stamps import header_stamp_ns, to_time
from swift_ros.nodes.guest import Guest
from swift_ros.nodes.node_warnings import NodeWarnings
from swift_ros.nodes.shell import LEVELS
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.recording.replay import DETECTIONS, IMAGE, ODOMETRY, POSES, RAW, STATE, Plan, Play
from swift_ros.recording.writer import offered_qos
from swift_ros.working_time import WorkingTime

# Timeouts are in working time.
START_TIMEOUT_S = 90.0  # s; longest start of all nodes, in which they load their networks
ANSWER_TIMEOUT_S = 10.0  # s; longest wait for the answer to a message
# s; longest wait for an answer after a node has published a warning: it may have refused the message
REFUSED_ANSWER_TIMEOUT_S = 0.2
DISCOVERY_POLL_S = 0.1  # s; period of the check whether all nodes have been discovered
ANSWER_POLL_S = 0.05  # s; longest wait for a message before the condition is checked again
FAULT_CHECK_EVERY_S = 0.25  # s; period of the check whether a node has died
SHUT_DOWN = "ROS was shut down in this process"


class Stuck(Exception):
    """The nodes no longer answer; the sentence names the last message."""


class ReplayPublisher:
    """Plays a recording to the nodes of a plan and writes played and answered messages into a new bag.

    Args:
        plan: nodes and topics of the replay.
        writer: of the new bag.
        domain: ROS domain.
        faults: returns the nodes that have died since the last call.

    Attributes:
        played: number of messages played, by topic.
        received: number of messages received from the nodes, by topic.
        refused: number of odometry messages that were answered by a warning instead of a state.
        warnings: of the nodes, each once.
    """

    def __init__(self, plan: Plan, writer: BagWriter, domain: int, faults: Callable[[], list[NodeFault]]):
        self._plan, self._writer, self._faults = plan, writer, faults
        self._guest = Guest("replayer", domain, True)
        self._publishers = {name: self._publisher(name) for name in (*plan.played, "/clock")}
        self.received = dict.fromkeys(plan.recomputed, 0)
        for name in (*plan.recomputed, "/diagnostics"):
            self._subscribe(name)
        self._clock_ns, self._awaited_ns, self._state_ns = -1, None, -1
        self._warned, self._checked_s, self._working_time = False, 0.0, WorkingTime()
        self.played = dict.fromkeys(plan.played, 0)
        self.refused = 0
        self.warnings: list[str] = []
        self._node_warnings = NodeWarnings()

    def declare_copied(self, types: dict[str, str]) -> None:
        """Declare the topics that are copied from the recording: their types by name."""
        for name, type_name in types.items():
            offered = offered_qos(qos_profile(TOPICS[name], True)) if name in TOPICS else ""
            self._writer.add_topic(full_name(name), type_name, offered)

    def close(self) -> None:
        """Leave the graph."""
        self._guest.close()

    def _publisher(self, name: str):
        self._declare(name)
        return self._guest.publisher(name)

    def _subscribe(self, name: str) -> None:
        self._declare(name)

        def on_data(data: bytes) -> None:
            self._write(name, bytes(data))
            if name == "/diagnostics":
                message = deserialize(data, TOPICS[name].type)
                self._warned |= any(status.level != LEVELS["ok"] for status in message.status)
                self.warnings += self._node_warnings.new(message)
            else:
                self.received[name] += 1
            if name == STATE:
                self._state_ns = header_stamp_ns(data)

        self._guest.subscribe(name, on_data, raw=True)

    def _declare(self, name: str) -> None:
        topic = TOPICS[name]
        self._writer.add_topic(full_name(name), topic.type, offered_qos(qos_profile(topic, True)))

    def _write(self, name: str, data: bytes) -> None:
        stamped = name != "/clock"
        now_ns = max(self._clock_ns, 0)
        self._writer.write(full_name(name), data, now_ns, header_stamp_ns(data) if stamped else now_ns)

    def await_graph(self) -> None:
        """Wait until all nodes run and have discovered their topics. Raises Stuck with the names of missing nodes."""
        deadline_s = self._working_time.now_s() + START_TIMEOUT_S
        while missing := self._missing_nodes():
            self._check()
            if self._working_time.now_s() > deadline_s:
                raise Stuck(f"{', '.join(missing)} did not start within {START_TIMEOUT_S:.0f} s")
            self._spin_once(DISCOVERY_POLL_S)

    def _missing_nodes(self) -> list[str]:
        missing = []
        for name in self._plan.nodes:
            row, node = NODES[name], self._guest.node
            publishers = [node.get_publishers_info_by_topic(topic) for topic in row.publishes]
            subscriptions = [node.get_subscriptions_info_by_topic(topic) for topic in row.subscribes]
            ends = (*publishers, *subscriptions)
            if not all(any(info.node_name == name for info in infos) for infos in ends):
                missing.append(name)
        # Images are not transient local: a late subscriber would miss them.
        if not missing and IMAGE in self._publishers and self._publishers[IMAGE].get_subscription_count() < 1:
            missing.append("gate_detector")
        return missing

    def play(self, item: Play) -> None:
        """Play one message as soon as all earlier ones are answered. Raises Stuck."""
        if not item.to_nodes:
            self._writer.write(full_name(item.topic), item.data, item.at_ns)
            return
        if item.at_ns > self._clock_ns:
            self._await_state()
            self._clock_ns = item.at_ns
            clock = Clock(clock=to_time(item.at_ns))
            self._publishers["/clock"].publish(clock)
            self._write("/clock", serialize(clock))
        self._publishers[item.topic].publish(item.data)
        self._write(item.topic, item.data)
        self.played[item.topic] += 1
        if item.topic in (RAW, ODOMETRY):
            self._awaited_ns = header_stamp_ns(item.data)

    def _await_state(self) -> None:
        """Wait for the state that answers the odometry played last. Raises Stuck."""
        awaited_ns = self._awaited_ns
        if awaited_ns is None:
            return
        if not self._wait(lambda: self._state_ns >= awaited_ns):
            if not self._warned:
                raise Stuck(f"no state came for the odometry of {1e-9 * awaited_ns:.3f} s")
            self.refused += 1
        self._awaited_ns, self._warned = None, False

    def finish(self) -> None:
        """Wait for the answers to the last messages. Raises Stuck when an image was not answered."""
        self._await_state()
        for question, answer in ((IMAGE, DETECTIONS), (DETECTIONS, POSES)):
            if answer not in self.received:
                continue
            number = self.played.get(question, self.received.get(question, 0))
            if not self._wait(lambda answer=answer, number=number: self.received[answer] >= number):
                raise Stuck(f"{number} messages of {question}, but only {self.received[answer]} of {answer}")

    def _wait(self, condition: Callable[[], bool]) -> bool:
        """Receive messages until a condition is true; return False when it is not true in time."""
        begun_s = self._working_time.now_s()
        while not condition():
            timeout_s = REFUSED_ANSWER_TIMEOUT_S if self._warned else ANSWER_TIMEOUT_S
            if self._working_time.now_s() - begun_s > timeout_s:
                return False
            self._spin_once(ANSWER_POLL_S)
            self._check()
        return True

    def _spin_once(self, timeout_s: float) -> None:
        """Run the callbacks of received messages, waiting at most `timeout_s`. Raises Stuck when ROS was shut down."""
        try:
            self._guest.spin_once(timeout_s)
        except ExternalShutdownException as error:
            raise Stuck(SHUT_DOWN) from error

    def _check(self) -> None:
        """Raise Stuck when a node has died or ROS was shut down."""
        if not self._guest.context.ok():
            raise Stuck(SHUT_DOWN)
        if time.monotonic() - self._checked_s > FAULT_CHECK_EVERY_S:
            self._checked_s = time.monotonic()
            for fault in self._faults():
                raise Stuck(fault.sentence)
