"""Node recorder: every topic of the graph's table, and others on request, into a rosbag2 MCAP folder.

It must cost the flight little and lose nothing, so it does not wake for each message: some twenty times a second it
takes all that has come, in the order of reception.
"""

import threading
import time
from dataclasses import dataclass
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time

from swift_ros import messages
from swift_ros.configuration import setting
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS
from swift_ros.nodes.by_hand import ByHand, never, take, without_clock
from swift_ros.nodes.shell import Shell, quality, run
from swift_ros.recording.writer import Heard, Recording, offered_qos

TAKE_EVERY_S, SEARCH_EVERY_S = 0.05, 0.5
DEPTH, ALL_TIME_NS = 1000, 2**63
ALL = "all"


@dataclass(frozen=True)
class Settings:
    folder: str = setting("folder of the new bag; empty: one named by the time, under recordings/")
    topics: str = setting("names with commas between; all: those of the graph's table")


class RecorderNode(Shell):
    """All topics in, a bag out."""

    executor_type = ByHand.EXECUTOR

    def __init__(self):
        super().__init__("recorder", Settings)
        # In real time the threads of DDS receive at once into queues of seconds; what empties them into the bag comes
        # after everything that flies: real-time threads that together fill a core are halted by the kernel.
        self.patient_threads = frozenset({threading.get_native_id()})
        folder = Path(self.settings.folder or time.strftime("recordings/%Y-%m-%d_%H-%M-%S"))
        self._recording = Recording(folder, self.folder, self.lockstep)
        self._ears, self._group, self._held = [], ByHand(), []
        names = [name.strip() for name in self.settings.topics.split(",") if name.strip()]
        if not names:
            raise UsageError("recorder: parameter 'topics' names none; give names or 'all'")
        if self.lockstep:
            without_clock(self)
            names.append("/clock")  # log times come from there
        for topic in TOPICS.values():
            if ALL in names or topic.name in names:
                self._listen(topic.name, topic.type, quality(topic, self.lockstep))
        self._sought = {name for name in names if name != ALL and name not in TOPICS}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TAKE_EVERY_S, self._take, clock=steady)
        if self._sought:
            self.create_timer(SEARCH_EVERY_S, self._search, clock=steady)
        self.diagnose("ok", f"recording to {folder}")

    @property
    def counts(self) -> dict[str, int]:
        """Messages recorded so far, by full topic name."""
        return self._recording.counts

    @property
    def fault(self) -> str | None:
        """Why writing ended before its time, None while all is well."""
        return self._recording.fault

    def _listen(self, name: str, type_name: str, offered: QoSProfile) -> None:
        own = QoSProfile(depth=DEPTH, reliability=offered.reliability, durability=offered.durability)
        ear = self.create_subscription(
            messages.message_type(type_name), name, never, own, raw=True, callback_group=self._group
        )
        self._recording.declare(ear.topic_name, type_name, offered_qos(offered))
        self._ears.append(ear)

    def _search(self) -> None:
        """Subscribe to topics that the table does not have as soon as somebody speaks there."""
        for name in sorted(self._sought):
            speakers = self.get_publishers_info_by_topic(name)
            if speakers:
                self._sought.remove(name)
                try:
                    self._listen(name, speakers[0].topic_type, _offered_by_all(speakers))
                except (UsageError, ImportError, AttributeError):
                    kind = speakers[0].topic_type
                    self.diagnose("error", f"{name} is not recorded: its type {kind} is not installed")

    def _take(self, until_ns: int | None = None) -> None:
        until_ns = until_ns or time.time_ns()
        batch = self._held
        for ear in self._ears:
            taken = take(ear, raw=True)
            batch += [Heard(ear.topic_name, bytes(data), info["received_timestamp"]) for data, info in taken]
            if len(taken) >= DEPTH:
                self.diagnose("warn", f"the recorder was held up: messages of {ear.topic_name} may be lost")
        was_well = self._recording.fault is None
        # What came while the ears were asked in turn waits: an ear asked before may hold something older.
        self._held = [heard for heard in batch if heard.received_ns > until_ns]
        self._recording.take([heard for heard in batch if heard.received_ns <= until_ns])
        if self.lockstep:
            now = Time(nanoseconds=self._recording.clock_ns, clock_type=ClockType.ROS_TIME)
            self.get_clock().set_ros_time_override(now)
        if was_well and self._recording.fault:
            self.diagnose("error", self._recording.fault)

    def close(self) -> None:
        """Take what came last and complete the bag."""
        self._take(until_ns=ALL_TIME_NS)
        self._recording.close()


def _offered_by_all(speakers) -> QoSProfile:
    """Return what every speaker of a topic offers."""
    profiles = [speaker.qos_profile for speaker in speakers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    kept = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def main() -> None:
    """Run the node."""
    run(RecorderNode)
