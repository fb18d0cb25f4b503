"""Writes received messages into a bag: their times, their order, and the end when the disk is full."""

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import yaml

from swift_ros.messages.stamps import NANOSECONDS, begins_with_stamp, header_stamp_ns
from swift_ros.race.result import model_hashes
from swift_ros.recording.bag_writer import BagWriter

_UNLIMITED = {"sec": 9223372036, "nsec": 854775807}  # an infinite duration in the notation of rosbag2


@dataclass(frozen=True)
class ReceivedMessage:
    """One received message.

    Attributes:
        topic: full name.
        data: CDR bytes.
        received_ns: time of reception on the system clock, ns.
    """

    topic: str
    data: bytes
    received_ns: int


def provenance(config: Path) -> dict[str, str]:
    """Return the provenance stored in a recording, by name: version, SHA-256 of models, texts of the configuration."""
    texts = {f"config/{path.name}": path.read_text() for path in sorted(config.glob("*.yaml"))}
    models = {f"sha256 models/{name}": digest for name, digest in model_hashes(config).items()}
    return {"swift_ros": version("swift_ros")} | models | texts


def offered_qos(profile) -> str:
    """Return the YAML text of rosbag2 for one offered rclpy QoSProfile."""
    return yaml.safe_dump(
        [
            {
                "history": profile.history.name.lower(),
                "depth": profile.depth,
                "reliability": profile.reliability.name.lower(),
                "durability": profile.durability.name.lower(),
                "deadline": _duration(profile.deadline),
                "lifespan": _duration(profile.lifespan),
                "liveliness": "automatic",
                "liveliness_lease_duration": _duration(profile.liveliness_lease_duration),
                "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
            }
        ],
        sort_keys=False,
    )


def _duration(duration) -> dict[str, int]:
    seconds, rest = divmod(duration.nanoseconds, NANOSECONDS)
    return {"sec": seconds, "nsec": rest} if 0 < seconds < _UNLIMITED["sec"] else _UNLIMITED


class RecordingWriter:
    """Writes received messages into a new bag.

    Args:
        folder: of the new bag.
        config: configuration folder whose texts and hashes are stored in the bag.
        simulated: log times are those of the recorded /clock instead of the times of reception.
        resume: continue the bag in `folder`, if there is one.

    Attributes:
        clock_ns: newest time of the recorded /clock, ns.
        counts: number of messages by topic.
        fault: why writing ended early, None without a fault.

    Raises:
        UsageError: the folder cannot be written.
    """

    def __init__(self, folder: Path, config: Path, simulated: bool, resume: bool = False):
        self._writer = BagWriter(folder, provenance(config), resume)
        self._simulated = simulated
        self.clock_ns = 0
        self._stamped: dict[str, bool] = {}
        self.counts: dict[str, int] = {}
        self.fault: str | None = None

    def declare(self, topic: str, type_name: str, qos: str) -> None:
        """Declare a topic (full name) before its first message. Raises UsageError when its type is not installed."""
        self._writer.add_topic(topic, type_name, qos)
        self._stamped[topic] = begins_with_stamp(type_name)
        self.counts[topic] = 0

    def write(self, batch: list[ReceivedMessage]) -> None:
        """Write messages in the order of reception. On an error set `fault`; earlier messages stay readable."""
        for message in sorted(batch, key=lambda message: message.received_ns):
            if self.fault:
                return
            if self._simulated and message.topic == "/clock":
                self.clock_ns = header_stamp_ns(message.data)
            log_ns = self.clock_ns if self._simulated else message.received_ns
            stamp_ns = header_stamp_ns(message.data) if self._stamped[message.topic] else log_ns
            if stamp_ns < 0 or (stamp_ns == 0 and not self._simulated):  # the publisher has not stamped it
                stamp_ns = log_ns
            try:
                self._writer.write(message.topic, message.data, log_ns, stamp_ns)
            except OSError as error:
                self.fault = (
                    f"recording to {self._writer.folder} ended: {error.strerror}; earlier messages stay readable"
                )
                return
            self.counts[message.topic] += 1

    def close(self) -> None:
        """Complete the bag."""
        try:
            self._writer.close()
        except OSError as error:
            self.fault = self.fault or f"{self._writer.folder} could not be completed: {error.strerror}"
