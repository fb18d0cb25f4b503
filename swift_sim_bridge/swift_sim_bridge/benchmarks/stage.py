"""Plays what a recorded race's tracker and director said, in step with a camera that shows its images."""

import contextlib
import os
import struct
import time
from dataclasses import dataclass

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from swift_ros import messages
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, VEHICLE_NAMESPACE
from swift_ros.graph.qos import qos_profile

IMAGES, ODOMETRY, SERVICES = "camera/image_raw", "vio/raw", ("race/arm", "race/start")
AS_HARDWARE = 30  # SCHED_FIFO priority
CAMERA_PATIENCE_S = 30.0
STANDING_S = 0.01
LATE_S = 0.002


@dataclass(frozen=True)
class Cue:
    """What is due at `due_ns` of the recording's time: odometry (CDR bytes), or a race service that is called."""

    due_ns: int
    odometry: bytes = b""
    service: str = ""


def restamped(data: bytes, shift_ns: int) -> bytes:
    """Return a serialized message that begins with a stamp, with that stamp moved."""
    seconds, nanoseconds = divmod(messages.header_stamp_ns(data) + shift_ns, messages.NANOSECONDS)
    layout = "<iI" if data[1] & 1 else ">iI"
    return data[:4] + struct.pack(layout, seconds, nanoseconds) + data[12:]


class Stage:
    """The node that plays."""

    def __init__(self, domain: int):
        self._context = rclpy.Context()
        self._context.init(domain_id=domain)
        self._node = rclpy.create_node("player", context=self._context, namespace=VEHICLE_NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._odometry = self._speaker(ODOMETRY)
        self._services = {name: self._node.create_client(Trigger, name) for name in SERVICES}
        self._image = None
        topic = TOPICS[IMAGES]
        self._node.create_subscription(messages.message_type(topic.type), IMAGES, self._on_image, qos_profile(topic, False))

    def _speaker(self, name: str):
        topic = TOPICS[name]
        return self._node.create_publisher(messages.message_type(topic.type), name, qos_profile(topic, False))

    def _on_image(self, message) -> None:
        self._image = message

    def synchronize(self, taken_ns: dict[int, int], standing: Cue) -> int:
        """Play odometry that stands until an image of the recording comes; return by how much its stamp is later than
        in the recording, ns. Raises UsageError when none comes."""
        end_s = time.monotonic() + CAMERA_PATIENCE_S
        while time.monotonic() < end_s:
            self._odometry.publish(restamped(standing.odometry, time.time_ns() - standing.due_ns))
            self._executor.spin_once(timeout_sec=STANDING_S)
            recorded_ns = self._image and taken_ns.get(hash(messages.from_image(self._image).tobytes()))
            if recorded_ns:
                return messages.stamp_ns(self._image.header.stamp) - recorded_ns
        raise UsageError(f"the camera showed nothing of the recording within {CAMERA_PATIENCE_S:.0f} s; see its log")

    def play(self, rows: list[Cue], shift_ns: int) -> int:
        """Do every cue when it is due; return how many went out late. Where it may, it goes before every node, as a
        tracker would: it does not share the computer's cores. Raises UsageError when a service refuses."""
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(AS_HARDWARE))
        late, answers = 0, {}
        for cue in rows:
            wait_s = 1e-9 * (cue.due_ns + shift_ns - time.time_ns())
            if wait_s > 0:
                time.sleep(wait_s)
            late += wait_s < -LATE_S
            if cue.service:
                answers[cue.service] = self._services[cue.service].call_async(Trigger.Request())
            else:
                self._odometry.publish(restamped(cue.odometry, shift_ns))
        time.sleep(0.2)  # the last answers
        for service, answer in answers.items():
            self._executor.spin_until_future_complete(answer, timeout_sec=5.0)
            if not answer.done() or not answer.result().success:
                why = answer.result().message if answer.done() else "no answer"
                raise UsageError(f"{service} was refused while the race was played: {why}")
        return late

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
