"""Subscriptions that keep to the publisher that they began with: messages of others are refused and named."""

import inspect
import time
from collections.abc import Callable
from dataclasses import dataclass

from rclpy.node import Node

from swift_ros.graph.publisher_binding import Arrival, Origin, PublisherBinding
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import Topic
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import message_stamp_ns

STAMP_TOLERANCE_NS = 1_000_000_000  # ns between stamp and clock; arming and start are announced up to 0.5 s ahead
REPORT_S = 1.0  # s; shortest period of the report about refused messages


@dataclass(frozen=True)
class Subscriber:
    """Makes the subscriptions of one node.

    Attributes:
        node: the node.
        lockstep: the graph runs in lockstep.
        now_ns: returns the time of the node's clock, ns.
        report: called with a sentence about refused messages.
    """

    node: Node
    lockstep: bool
    now_ns: Callable[[], int]
    report: Callable[[str], None]

    def subscribe(self, topic: Topic, callback: Callable, raw: bool = False):
        """Subscribe to one publisher of a topic, the first one found, and return the subscription.

        Args:
            topic: row of the table; one that is shared has no single publisher.
            callback: called with each message.
            raw: hand over CDR bytes instead of messages.
        """
        if not topic.shared:
            callback = BoundCallback(callback, PublisherCheck(self, topic))
        kind, profile = message_type(topic.type), qos_profile(topic, self.lockstep)
        return self.node.create_subscription(kind, topic.name, callback, profile, raw=raw)


class PublisherCheck:
    """Accepts the messages of one publisher of a topic, the first one found; reports the others."""

    def __init__(self, subscriber: Subscriber, topic: Topic):
        self._subscriber, self._topic = subscriber, topic
        self._binding = PublisherBinding(is_event=topic.rate_hz is None)
        self._reported_s = -REPORT_S

    def accepts(self, message, info: dict) -> bool:
        """Return whether a message, given with its info or as CDR bytes, is of the own publisher."""
        sequence, time_s = info["publication_sequence_number"], time.monotonic()
        arrival = Arrival(sequence, 1e-9 * info["source_timestamp"], time_s)
        if sequence is None or self._is_own(message, arrival):  # None: the middleware has no numbers
            self._binding.accept(arrival)
            return True
        self._binding.refuse(arrival)
        self._report_refused(time_s)
        return False

    def _is_own(self, message, arrival: Arrival) -> bool:
        origin = self._binding.origin(arrival)
        if origin is Origin.OWN:
            return True
        alone = self._subscriber.node.count_publishers(self._topic.name) <= 1
        if origin is Origin.BEHIND:
            return alone and self._binding.may_change(arrival.received_s)
        if origin is Origin.AHEAD:
            return alone
        return alone or abs(message_stamp_ns(message) - self._subscriber.now_ns()) < STAMP_TOLERANCE_NS

    def _report_refused(self, time_s: float) -> None:
        if time_s - self._reported_s >= REPORT_S:
            self._reported_s = time_s
            topic = self._topic.name
            names = publisher_names(self._subscriber.node, topic)
            self._subscriber.report(f"a message on {topic} is not of its publisher and was refused; on it are {names}")


class BoundCallback:
    """The callback of a subscription: calls another one with each message that a check accepts."""

    # rclpy hands over the message's number to callbacks with two parameters
    __signature__ = inspect.Signature(
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in ("message", "info")]
    )

    def __init__(self, callback: Callable, check: PublisherCheck):
        self._callback, self._check = callback, check

    def __call__(self, *taken):
        message, info = taken[0] if len(taken) == 1 else taken  # one pair: EventsExecutor of rclpy 7.1
        if self._check.accepts(message, info):
            self._callback(message)


def publisher_names(node, topic: str) -> str:
    """Return the names of the nodes that publish a topic now, as a phrase."""
    return ", ".join(sorted(info.node_name for info in node.get_publishers_info_by_topic(topic)))
