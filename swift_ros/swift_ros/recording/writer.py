"""What becomes of each recorded message: its two times, its place in the bag, and the end when the disk is full."""

from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import yaml

from swift_ros import messages
from swift_ros.race.result import model_hashes
from swift_ros.recording.bags import BagWriter

_UNLIMITED = {"sec": 9223372036, "nsec": 854775807}  # as rosbag2 writes a duration without end


@dataclass(frozen=True)
class Heard:
    """One message as it came: full name of its topic, CDR bytes, and when it was received (system clock, ns)."""

    topic: str
    data: bytes
    received_ns: int


def identity(config: Path) -> dict[str, str]:
    """Return what a recording says about who flew: texts of the configuration and SHA-256 of the models, by name."""
    texts = {f"config/{path.name}": path.read_text() for path in sorted(config.glob("*.yaml"))}
    models = {f"sha256 models/{name}": digest for name, digest in model_hashes(config).items()}
    return {"swift_ros": version("swift_ros")} | models | texts


def offered_qos(profile) -> str:
    """Return rosbag2's text for one offered rclpy QoSProfile."""
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
    seconds, rest = divmod(duration.nanoseconds, messages.NANOSECONDS)
    return {"sec": seconds, "nsec": rest} if 0 < seconds < _UNLIMITED["sec"] else _UNLIMITED


class Recording:
    """A bag that is being written.

    folder: of the new bag; config: configuration folder whose texts and hashes travel along; simulated: log times are
    those of the recorded /clock, not of reception. clock_ns: newest of these; counts: messages by topic; fault: why
    writing ended before its time, None while all is well. Raises UsageError when the folder cannot be written.
    """

    def __init__(self, folder: Path, config: Path, simulated: bool):
        self._writer = BagWriter(folder, identity(config))
        self._simulated = simulated
        self.clock_ns = 0
        self._stamped: dict[str, bool] = {}
        self.counts: dict[str, int] = {}
        self.fault: str | None = None

    def declare(self, topic: str, type_name: str, qos: str) -> None:
        """Announce a topic (full name) before its first message. Raises UsageError when its type is not installed."""
        self._writer.add_topic(topic, type_name, qos)
        self._stamped[topic] = messages.begins_with_stamp(type_name)
        self.counts[topic] = 0

    def take(self, batch: list[Heard]) -> None:
        """Write messages in the order of their reception. When that fails, `fault` says why and what is there stays."""
        for heard in sorted(batch, key=lambda heard: heard.received_ns):
            if self.fault:
                return
            if self._simulated and heard.topic == "/clock":
                self.clock_ns = messages.header_stamp_ns(heard.data)
            log_ns = self.clock_ns if self._simulated else heard.received_ns
            stamp_ns = messages.header_stamp_ns(heard.data) if self._stamped[heard.topic] else log_ns
            if stamp_ns < 0 or (stamp_ns == 0 and not self._simulated):  # nobody stamped it
                stamp_ns = log_ns
            try:
                self._writer.write(heard.topic, heard.data, log_ns, stamp_ns)
            except OSError as error:
                self.fault = f"recording to {self._writer.folder} ended: {error.strerror}; what was written stays"
                return
            self.counts[heard.topic] += 1

    def close(self) -> None:
        """Complete the bag."""
        try:
            self._writer.close()
        except OSError as error:
            self.fault = self.fault or f"{self._writer.folder} could not be completed: {error.strerror}"
