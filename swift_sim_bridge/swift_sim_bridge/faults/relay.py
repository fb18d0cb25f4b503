"""A node between the publisher of a topic and its subscribers, which plants a fault; or a foreign publisher of a topic.

The publisher's topic is renamed to `source_name(topic)`. The relay takes the name of the publisher's node, so that the
graph looks complete. Run as `python -m swift_sim_bridge.faults.relay JSON --ros-args ...`.
"""

import functools
import json
import sys
import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import NODES, TOPICS
from swift_ros.messages.serialization import deserialize, message_type, serialize
from swift_ros.messages.stamps import begins_with_stamp, from_time, header_stamp_ns, message_stamp_ns
from swift_ros.nodes.shell import running_node, set_thread_priorities, spin, stop_requests
from swift_ros.race.judge import RACING
from swift_sim_bridge import seeds
from swift_sim_bridge.faults import message_errors
from swift_sim_bridge.faults.catalogue import (
    DELAY,
    DROP,
    DUPLICATE,
    FOREIGN_PUBLISHER,
    LOCKSTEP,
    NOT_A_NUMBER,
    REORDER,
    TIME_JUMP,
    Fault,
)
from swift_sim_bridge.racing.race import RACERS

DEFAULT_RATE_HZ = 1.0  # of a topic of events, to count a delay in messages


def source_name(topic: str) -> str:
    """Return the name under which the publisher of a relayed topic publishes."""
    return f"{topic}_source"


def publisher_of(topic: str) -> str:
    """Return the name of the node of a race that publishes a topic."""
    return next(name for name in RACERS if topic in NODES[name].publishes)


class _FaultyNode(Node):
    """A node with a fault that begins some time after the start signal."""

    background_threads: frozenset[int] = frozenset()

    def __init__(self, name: str, fault: Fault):
        super().__init__(name)
        self.fault, self.lockstep = fault, fault.clock == LOCKSTEP
        self.topic = TOPICS[fault.target]
        self.kind = message_type(self.topic.type)
        self.rng = seeds.generator(fault.seed, "relay")
        self._start_ns: int | None = None

    def diagnose(self, level: str, text: str) -> None:
        """Write a line to the log: this node has no place in the graph's diagnostics."""
        self.get_logger().info(f"{level}: {text}")

    def create_output(self):
        """Return a publisher of the topic."""
        return self.create_publisher(self.kind, self.topic.name, self.profile(self.topic.name))

    def profile(self, topic: str):
        """Return the quality of service of a topic."""
        return qos_profile(TOPICS[topic], self.lockstep)

    def follow_status(self, name: str) -> None:
        """Learn the time of the start from a topic of type RaceStatus."""
        kind = message_type(TOPICS["race/status"].type)
        self.create_subscription(kind, name, self._on_status, self.profile("race/status"))

    def _on_status(self, message) -> None:
        if message.state == RACING and self._start_ns is None:
            self._start_ns = from_time(message.header.stamp)

    def is_active(self, now_ns: int) -> bool:
        """Return whether the fault is there at a time."""
        if self._start_ns is None:
            return False
        since_s = 1e-9 * (now_ns - self._start_ns) - self.fault.at_s
        return 0.0 <= since_s < self.fault.duration_s


class Relay(_FaultyNode):
    """Passes the messages of a topic on, with a fault while it is active."""

    def __init__(self, fault: Fault):
        super().__init__(publisher_of(fault.target), fault)
        source = source_name(self.topic.name)
        status = source if self.topic.name == "race/status" else "race/status"
        self.follow_status(status)
        self._output = self.create_output()
        self._held: list[bytes] = []
        self._sign = int(self.rng.choice((-1, 1)))
        self._stamped = begins_with_stamp(self.topic.type)
        # the simulator waits until its images have as many subscribers as the table says
        subscribers = sum(name == "recorder" or self.topic.name in NODES[name].subscribes for name in RACERS)
        for callback in (self._on_data, *[lambda data: None] * (subscribers - 1)):
            self.create_subscription(self.kind, source, callback, self.profile(self.topic.name), raw=True)

    def _on_data(self, data: bytes) -> None:
        now_ns = header_stamp_ns(data) if self.lockstep and self._stamped else time.time_ns()
        if self.is_active(now_ns):
            passed = self._spoiled(data)
        else:
            passed, self._held = [*self._held, data], []
        for one in passed:
            self._output.publish(one)

    def _spoiled(self, data: bytes) -> list[bytes]:
        """Return what is published at the arrival of a message while the fault is active."""
        kind, size = self.fault.kind, self.fault.size
        if kind == DROP:
            return [] if self.rng.random() < size else [data]
        if kind == DUPLICATE:
            return [data] * round(size)
        if kind in (DELAY, REORDER):
            return self._released(data)
        if kind == NOT_A_NUMBER and self.rng.random() >= size:
            return [data]
        message = deserialize(data, self.topic.type)
        if kind == TIME_JUMP:
            shift_ns = self._sign * round(1e9 * size)
            message_errors.set_stamp(message, message_stamp_ns(message) + shift_ns)
        else:
            message_errors.spoil(message, self.rng, None if kind == NOT_A_NUMBER else size)
        return [serialize(message)]

    def _released(self, data: bytes) -> list[bytes]:
        """Hold a message; return the held ones that are due."""
        self._held.append(data)
        if self.fault.kind == DELAY:
            count = max(1, round(self.fault.size * (self.topic.rate_hz or DEFAULT_RATE_HZ)))
            return [self._held.pop(0)] if len(self._held) > count else []
        if len(self._held) < round(self.fault.size):
            return []
        released, self._held = [self._held[k] for k in self.rng.permutation(len(self._held))], []
        return released


class ForeignPublisher(_FaultyNode):
    """Publishes messages of its own making on a topic."""

    def __init__(self, fault: Fault):
        super().__init__("foreign", fault)
        self._output = None  # until the fault begins: with it, the race would not be armed
        self.follow_status("race/status")
        self.create_timer(1.0 / fault.size, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        now_ns = self.get_clock().now().nanoseconds
        if self.is_active(now_ns):
            message = self.kind()
            message_errors.make_up(message, self.rng, now_ns)
            self._output = self._output or self.create_output()
            self._output.publish(message)


def main() -> None:
    """Run the node that the fault in the first argument needs."""
    fault = Fault(**json.loads(sys.argv.pop(1)))
    node_type = ForeignPublisher if fault.kind == FOREIGN_PUBLISHER else Relay
    with running_node(functools.partial(node_type, fault)) as node:
        requests = stop_requests()
        if isinstance(node, Relay):
            set_thread_priorities(node)
        spin(node, requests)


if __name__ == "__main__":
    main()
