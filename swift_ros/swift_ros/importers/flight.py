"""A foreign flight in the frames and units of this graph, and its conversion to a bag."""

import heapq
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from swift_ros import geometry
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.control import to_battery, to_rotors
from swift_ros.messages.motion import to_imu, to_odometry
from swift_ros.messages.serialization import serialize
from swift_ros.recording import bags
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.recording.checks import Rejection, SensorChannel, check_channel, true_runs
from swift_ros.recording.flight_bags import IMPORTED, REJECTED
from swift_ros.recording.writer import offered_qos
from swift_ros.types import Odometry

UNIT_LENGTH_TOLERANCE = 0.05  # a quaternion whose length differs more from 1 is rejected
# Parameters that `replay` passes to its nodes: an imported flight does not start on the podium, its odometry frame is
# the map.
ALIGNED_WITH_MAP = {"parameters": json.dumps({"state_estimator": {"alignment": "map"}})}


@dataclass(frozen=True)
class Stream:
    """One topic of a flight.

    Attributes:
        topic: name in the table.
        rows: mask (n,) of the rows with a message.
        message: returns the message of a row (index) with a stamp (ns).
    """

    topic: str
    rows: np.ndarray
    message: Callable[[int, int], object]


@dataclass(frozen=True)
class ForeignFlight:
    """One imported flight.

    Attributes:
        name: of its bag.
        t: increasing times (n,), s.
        streams: its topics, with valid rows only.
        notes: information for a reader of the bag, by name.
        rejections: removed samples, with times relative to the first row.
        aligned_bag: bag on the same clock, whose other topics are copied; None without.
    """

    name: str
    t: np.ndarray
    streams: tuple[Stream, ...]
    notes: dict[str, str]
    rejections: tuple[Rejection, ...] = field(default=())
    aligned_bag: Path | None = None

    def write(self, folder: Path) -> dict[str, int]:
        """Write the bag and return the number of messages by topic. Raises UsageError when the folder holds a bag."""
        earlier = json.loads(self.notes.get(IMPORTED, "[]"))  # of the aligned bag
        imported = sorted({*earlier, *(stream.topic for stream in self.streams)})
        rejected = [rejection.as_json() for rejection in self.rejections]
        writer = BagWriter(folder, self.notes | {IMPORTED: json.dumps(imported), REJECTED: json.dumps(rejected)})
        for stream in self.streams:
            topic = TOPICS[stream.topic]
            writer.add_topic(full_name(topic.name), topic.type, offered_qos(qos_profile(topic, False)))
        for topic, data, stamp_ns in heapq.merge(
            self._own_messages(), self._copied_messages(writer), key=lambda row: row[2]
        ):
            writer.write(topic, data, stamp_ns)
        writer.close()
        return {stream.topic: int(np.sum(stream.rows)) for stream in self.streams}

    def _own_messages(self) -> Iterator[tuple[str, bytes, int]]:
        for i, stamp_ns in enumerate(np.round(self.t * 1e9).astype(np.int64).tolist()):
            for stream in self.streams:
                if stream.rows[i]:
                    yield full_name(stream.topic), serialize(stream.message(i, stamp_ns)), stamp_ns

    def _copied_messages(self, writer: BagWriter) -> Iterator[tuple[str, bytes, int]]:
        """Declare the other topics of the aligned bag and yield their messages."""
        if self.aligned_bag is None:
            return
        own = {full_name(stream.topic) for stream in self.streams}
        others = {topic: kind for topic, kind in bags.topic_types(self.aligned_bag).items() if topic not in own}
        for topic, kind in others.items():
            writer.add_topic(topic, kind)
        for raw in bags.read_raw(self.aligned_bag, list(others)):
            yield raw.topic, raw.data, raw.log_time_ns


class ChannelChecker:
    """Checks the channels of one recording and collects the rejections.

    Args:
        t: increasing times (n,), s.
        rejections: rejections of the times.

    Attributes:
        rejections: all rejections so far, with times relative to the first row.
    """

    def __init__(self, t, rejections: Iterable[Rejection] = ()):
        self._t = np.asarray(t)
        self.rejections = [rejection.since(self._t[0]) for rejection in rejections]

    def good(self, channel: SensorChannel) -> np.ndarray:
        """Return a mask (n,) of the valid rows of a channel."""
        good, rejections = check_channel(self._t, channel)
        self.rejections += [rejection.since(self._t[0]) for rejection in rejections]
        return good

    def unit_quaternions(self, name: str, quaternions) -> np.ndarray:
        """Return a mask (n,) of the valid rows of attitudes (n, 4), whose length must be 1."""
        good = self.good(SensorChannel(name, quaternions, -1.05, 1.05, ""))
        bad_length = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > UNIT_LENGTH_TOLERANCE
        for first, last in true_runs(bad_length & good):
            reason = "the quaternion's length is not 1"
            self.rejections.append(Rejection(self._t[first], self._t[last], name, reason).since(self._t[0]))
        return good & ~bad_length


def odometry_stream(topic: str, rows, p_world, q_world_body, v_world, omega_body) -> Stream:
    """Return a topic of odometry; the world frame of the flight is used as map and as odom.

    Args:
        topic: name in the table.
        rows: mask (n,) of the valid rows.
        p_world: positions (n, 3), m.
        q_world_body: attitudes (n, 4).
        v_world: velocities (n, 3), m/s.
        omega_body: body rates (n, 3), rad/s.
    """
    q_world_body = geometry.normalize(q_world_body)
    v_body = geometry.rotate_inverse(q_world_body, v_world)
    frame = "odom" if topic.startswith("vio/") else "map"

    def message(i: int, stamp_ns: int):
        state = Odometry(stamp_ns, p_world[i], q_world_body[i], v_body[i], omega_body[i])
        return to_odometry(state, frame)

    return Stream(topic, rows, message)


def imu_stream(rows, gyro_body, specific_force_body) -> Stream:
    """Return the topic of the IMU: rates (n, 3) rad/s and specific force (n, 3) m/s^2 in base_link."""
    return Stream("imu/data_raw", rows, lambda i, t: to_imu(t, gyro_body[i], specific_force_body[i]))


def rotor_stream(rows, speed, motor) -> Stream:
    """Return the topic of the rotors: speeds (rad/s) and motor commands (0..1), each (n, rotors) or (n, 0)."""
    return Stream("betaflight/rotors", rows, lambda i, t: to_rotors(t, speed[i], motor[i]))


def battery_stream(rows, voltage, current=None) -> Stream:
    """Return the topic of the battery: voltage (n,) V and current (n,) A, None when unknown."""
    nan = float("nan")
    drawn = np.full(len(voltage), nan) if current is None else current
    return Stream("battery", rows, lambda i, t: to_battery(t, float(voltage[i]), float(drawn[i]), nan, 0.0))


def body_rates(t, q_world_body) -> np.ndarray:
    """Return the body rates (n, 3) rad/s of attitudes (n, 4) at times t (n,) s.

    Central differences over five rows; a shorter stencil amplifies the noise of motion capture too much.
    """
    n = len(t)
    before, after = np.maximum(np.arange(n) - 2, 0), np.minimum(np.arange(n) + 2, n - 1)
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(q_world_body[before]), q_world_body[after])
    return geometry.rotation_vector_from_quaternion(turn) / (t[after] - t[before])[:, None]
