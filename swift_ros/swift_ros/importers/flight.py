"""A flight that somebody else recorded, in this graph's frames and units, and how it becomes a bag."""

import heapq
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from swift_ros import geometry, messages
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.recording import bags
from swift_ros.recording.bags import BagWriter
from swift_ros.recording.checks import Rejection, SensorChannel, check_channel, true_runs
from swift_ros.recording.flight_bags import IMPORTED, REJECTED
from swift_ros.recording.writer import offered_qos
from swift_ros.types import Odometry

# An imported flight has no podium: its odometry begins where it begins. `replay` hands this on to its nodes.
ALIGNED_WITH_MAP = {"parameters": json.dumps({"state_estimator": {"alignment": "map"}})}


@dataclass(frozen=True)
class Stream:
    """What a flight says on one topic of the table: a mask of rows (n,), and the message of a row at a stamp (ns)."""

    topic: str
    rows: np.ndarray
    message: Callable[[int, int], object]


@dataclass(frozen=True)
class ForeignFlight:
    """One imported flight.

    name: of its bag; t: (n,) s, growing; streams: what is good of it; notes: what a reader of the bag must know, by
    name; rejections: what was left out, times counted from the first row; beside: a bag on the same clock, whose other
    topics go along.
    """

    name: str
    t: np.ndarray
    streams: tuple[Stream, ...]
    notes: dict[str, str]
    rejections: tuple[Rejection, ...] = field(default=())
    beside: Path | None = None

    def write(self, folder: Path) -> dict[str, int]:
        """Write the bag and return the number of messages by topic. Raises UsageError when the folder is not new."""
        before = json.loads(self.notes.get(IMPORTED, "[]"))  # of the bag beside
        imported = sorted({*before, *(stream.topic for stream in self.streams)})
        rejected = [rejection.as_json() for rejection in self.rejections]
        writer = BagWriter(folder, self.notes | {IMPORTED: json.dumps(imported), REJECTED: json.dumps(rejected)})
        for stream in self.streams:
            topic = TOPICS[stream.topic]
            writer.add_topic(full_name(topic.name), topic.type, offered_qos(qos_profile(topic, False)))
        for topic, data, stamp_ns in heapq.merge(self._own(), self._others(writer), key=lambda row: row[2]):
            writer.write(topic, data, stamp_ns)
        writer.close()
        return {stream.topic: int(np.sum(stream.rows)) for stream in self.streams}

    def _own(self) -> Iterator[tuple[str, bytes, int]]:
        for i, stamp_ns in enumerate(np.round(self.t * 1e9).astype(np.int64).tolist()):
            for stream in self.streams:
                if stream.rows[i]:
                    yield full_name(stream.topic), messages.serialize(stream.message(i, stamp_ns)), stamp_ns

    def _others(self, writer: BagWriter) -> Iterator[tuple[str, bytes, int]]:
        """Yield what the bag beside says on other topics, and declare them."""
        if self.beside is None:
            return
        own = {full_name(stream.topic) for stream in self.streams}
        others = {topic: kind for topic, kind in bags.topic_types(self.beside).items() if topic not in own}
        for topic, kind in others.items():
            writer.add_topic(topic, kind)
        for raw in bags.read_raw(self.beside, list(others)):
            yield raw.topic, raw.data, raw.log_time_ns


class Checked:
    """The good rows of each channel of a recording, found as the channels are asked for.

    t: (n,) s, growing; rejections: what was found so far, its times counted from the first row.
    """

    def __init__(self, t, rejections: Iterable[Rejection] = ()):
        self._t = np.asarray(t)
        self.rejections = [rejection.since(self._t[0]) for rejection in rejections]

    def good(self, channel: SensorChannel) -> np.ndarray:
        """Return the rows (n,) of a channel that are measurements."""
        good, rejections = check_channel(self._t, channel)
        self.rejections += [rejection.since(self._t[0]) for rejection in rejections]
        return good

    def unit_quaternions(self, name: str, quaternions) -> np.ndarray:
        """Return the rows (n,) of attitudes (n, 4) that are measurements: the length must be one."""
        good = self.good(SensorChannel(name, quaternions, -1.05, 1.05, ""))
        odd = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > 0.05
        for first, last in true_runs(odd & good):
            reason = "the quaternion is not one: its length is not 1"
            self.rejections.append(Rejection(self._t[first], self._t[last], name, reason).since(self._t[0]))
        return good & ~odd


def odometry_stream(topic: str, rows, p_world, q_world_body, v_world, omega_body) -> Stream:
    """Return odometry of a flight: p_world (n, 3) m, q_world_body (n, 4), v_world (n, 3) m/s, omega_body (n, 3) rad/s;
    its world is the map, and the odometry frame lies on it."""
    q_world_body = geometry.normalize(q_world_body)
    v_body = geometry.rotate_inverse(q_world_body, v_world)
    frame = "odom" if topic.startswith("vio/") else "map"

    def message(i: int, stamp_ns: int):
        state = Odometry(stamp_ns, p_world[i], q_world_body[i], v_body[i], omega_body[i])
        return messages.to_odometry(state, frame)

    return Stream(topic, rows, message)


def imu_stream(rows, gyro_body, specific_force_body) -> Stream:
    """Return the IMU of a flight: rad/s (n, 3), m/s^2 (n, 3), base_link."""
    return Stream("imu/data_raw", rows, lambda i, t: messages.to_imu(t, gyro_body[i], specific_force_body[i]))


def rotor_stream(rows, speed, motor) -> Stream:
    """Return the rotors of a flight: rad/s (n, rotors) or (n, 0), motor commands 0..1 (n, rotors) or (n, 0)."""
    return Stream("betaflight/rotors", rows, lambda i, t: messages.to_rotors(t, speed[i], motor[i]))


def battery_stream(rows, voltage, current=None) -> Stream:
    """Return the battery of a flight: V (n,) and, where it is known, A (n,)."""
    nan = float("nan")
    drawn = np.full(len(voltage), nan) if current is None else current
    return Stream("battery", rows, lambda i, t: messages.to_battery(t, float(voltage[i]), float(drawn[i]), nan, 0.0))


def body_rates(t, q_world_body) -> np.ndarray:
    """Return the angular rate (n, 3) rad/s, body, of attitudes (n, 4) at times t (n,) s: central differences over five
    rows, as motion capture needs them."""
    n = len(t)
    before, after = np.maximum(np.arange(n) - 2, 0), np.minimum(np.arange(n) + 2, n - 1)
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(q_world_body[before]), q_world_body[after])
    return geometry.rotation_vector_from_quaternion(turn) / (t[after] - t[before])[:, None]
