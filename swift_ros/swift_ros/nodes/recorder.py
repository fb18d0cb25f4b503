"""Node recorder: records all topics of the graph's table, and others on request, into a rosbag2 MCAP folder.

It must use little CPU time in flight and lose no message. Therefore it does not wake for each message: twenty times per
second it takes all received messages, in the order of reception.
"""

import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time

from swift_ros.configuration import setting
from swift_ros.errors import UsageError
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.serialization import message_type
from swift_ros.nodes.polled_subscriptions import PolledSubscriptions, detach_clock
from swift_ros.nodes.shell import Shell, run
from swift_ros.recording.writer import ReceivedMessage, RecordingWriter, offered_qos

TAKE_EVERY_S = 0.05  # s; period in which received messages are taken
SEARCH_EVERY_S = 0.5  # s; period of the search for topics that are not in the table
DEPTH = 1000  # messages; queue of each subscription, 10 s at 100 Hz
END_OF_TIME_NS = 2**63  # ns; later than any reception
ALL = "all"  # name for all topics of the table


@dataclass(frozen=True)
class Settings:
    """Settings of the node recorder."""

    folder: str = setting("folder of the new bag; empty: recordings/DATE_TIME")
    topics: str = setting("names separated by commas; all: every topic of the graph's table")
    resume: bool = setting("continue a bag that is in the folder; the runner sets it when it starts this node again")

    def __post_init__(self):
        if not self.names:
            raise ValueError("'topics' names none; give names separated by commas, or 'all'")

    @property
    def names(self) -> list[str]:
        """The names in `topics`."""
        return [name.strip() for name in self.topics.split(",") if name.strip()]


class RecorderNode(Shell):
    """Subscribes all requested topics and writes them into a bag."""

    def __init__(self):
        super().__init__("recorder", Settings)
        # In real time the threads of DDS receive at once, into queues that last for seconds. The thread that writes
        # them into the bag has no real-time priority: the kernel throttles real-time threads that use a whole core.
        self.background_threads = frozenset({threading.get_native_id()})
        folder = Path(self.settings.folder or time.strftime("recordings/%Y-%m-%d_%H-%M-%S"))
        self._recording = RecordingWriter(folder, self.folder, self.lockstep, self.settings.resume)
        self._polled = PolledSubscriptions()
        names = self.settings.names
        if self.lockstep:
            detach_clock(self)
            names.append("/clock")  # log times are those of /clock
        for topic in TOPICS.values():
            if ALL in names or topic.name in names:
                self._record(topic.name, topic.type, qos_profile(topic, self.lockstep))
        self._sought = {name for name in names if name != ALL and name not in TOPICS}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TAKE_EVERY_S, self._take, clock=steady)
        if self._sought:
            self.create_timer(SEARCH_EVERY_S, self._search, clock=steady)
        self.diagnose("ok", f"recording to {folder}")

    @property
    def counts(self) -> dict[str, int]:
        """Number of recorded messages by full topic name."""
        return self._recording.counts

    @property
    def fault(self) -> str | None:
        """Why writing ended early, None without a fault."""
        return self._recording.fault

    def _record(self, name: str, type_name: str, offered: QoSProfile) -> None:
        durability = offered.durability
        if self.settings.resume and not (name in TOPICS and TOPICS[name].latched):
            # the bag holds earlier messages; in lockstep a thousand of each topic would come again and delay the others
            durability = DurabilityPolicy.VOLATILE
        profile = QoSProfile(depth=DEPTH, reliability=offered.reliability, durability=durability)
        subscription = self.create_polled_subscription(message_type(type_name), name, profile, raw=True)
        self._recording.declare(subscription.topic_name, type_name, offered_qos(offered))
        self._polled.add(subscription.topic_name, subscription)

    def _search(self) -> None:
        """Subscribe to requested topics outside the table as soon as they have a publisher."""
        for name in sorted(self._sought):
            publishers = self.get_publishers_info_by_topic(name)
            if publishers:
                self._sought.remove(name)
                try:
                    self._record(name, publishers[0].topic_type, _offered_by_all(publishers))
                except (UsageError, LookupError):
                    type_name = publishers[0].topic_type
                    self.diagnose("error", f"{name} is not recorded: its type {type_name} is not installed")

    def _take(self, until_ns: int | None = None) -> None:
        """Write all messages that were received until a time (system clock, ns; default: now)."""
        taken = self._polled.take(until_ns)
        batch = [ReceivedMessage(each.key, bytes(each.message), each.received_ns) for each in taken]
        for name, count in Counter(message.topic for message in batch).items():
            if count >= DEPTH:
                self.diagnose("warn", f"the recorder was delayed: messages of {name} may be lost")
        was_writing = self._recording.fault is None
        self._recording.write(batch)
        if self.lockstep:
            now = Time(nanoseconds=self._recording.clock_ns, clock_type=ClockType.ROS_TIME)
            # a node's clock is a ROSClock, declared as Clock
            self.get_clock().set_ros_time_override(now)  # pyright: ignore[reportAttributeAccessIssue]
        if was_writing and self._recording.fault:
            self.diagnose("error", self._recording.fault)

    def close(self) -> None:
        """Write the last messages and complete the bag."""
        self._take(until_ns=END_OF_TIME_NS)
        self._recording.close()


def _offered_by_all(publishers) -> QoSProfile:
    """Return the QoS that every publisher of a topic offers."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    transient_local = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE,
    )


def main() -> None:
    """Run the node."""
    run(RecorderNode)
