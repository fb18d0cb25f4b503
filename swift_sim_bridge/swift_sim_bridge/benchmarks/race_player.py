"""Replays odometry and service calls of a recorded race, synchronised with a camera node that shows its images."""

import contextlib
import os
import struct
import time
from dataclasses import dataclass

from std_srvs.srv import Trigger

from swift_ros.errors import UsageError
from swift_ros.messages.camera import from_image
from swift_ros.messages.stamps import NANOSECONDS, from_time, header_stamp_ns
from swift_ros.nodes.guest import Guest

IMAGES, ODOMETRY, SERVICES = "camera/image_raw", "vio/raw", ("race/arm", "race/start")
FIFO_PRIORITY = 30  # of SCHED_FIFO, above those of the onboard nodes (at most 20)
CAMERA_PATIENCE_S = 30.0  # longest wait for an image of the recording
STANDING_PERIOD_S = 0.01  # period of the odometry at rest before the first image
LATE_S = 0.002  # a later input counts as late


@dataclass(frozen=True)
class TimedInput:
    """One input of the graph: odometry or a service call.

    Attributes:
        due_ns: recorded time.
        odometry: serialized message (CDR), empty for a service call.
        service: race service to call, "" for odometry.
    """

    due_ns: int
    odometry: bytes = b""
    service: str = ""


def restamped(data: bytes, shift_ns: int) -> bytes:
    """Return a serialized message, which begins with a header, with its stamp moved by `shift_ns`."""
    seconds, nanoseconds = divmod(header_stamp_ns(data) + shift_ns, NANOSECONDS)
    layout = "<iI" if data[1] & 1 else ">iI"
    return data[:4] + struct.pack(layout, seconds, nanoseconds) + data[12:]


class RacePlayer:
    """The node that replays the inputs."""

    def __init__(self, domain: int):
        self._guest = Guest("player", domain, lockstep=False)
        self._odometry = self._guest.publisher(ODOMETRY)
        self._services = {name: self._guest.node.create_client(Trigger, name) for name in SERVICES}
        self._image = None
        self._guest.subscribe(IMAGES, self._on_image)

    def _on_image(self, message) -> None:
        self._image = message

    def synchronize(self, taken_ns: dict[int, int], standing: TimedInput) -> int:
        """Wait for an image of the recording; return the shift of its stamp from the recorded one, ns.

        Args:
            taken_ns: recorded stamps of the images, by the hash of their pixels.
            standing: odometry that is published until then.

        Raises:
            UsageError: no image comes within CAMERA_PATIENCE_S.
        """
        end_s = time.monotonic() + CAMERA_PATIENCE_S
        while time.monotonic() < end_s:
            self._odometry.publish(restamped(standing.odometry, time.time_ns() - standing.due_ns))
            self._guest.spin_once(STANDING_PERIOD_S)
            recorded_ns = self._image and taken_ns.get(hash(from_image(self._image).tobytes()))
            if recorded_ns:
                return from_time(self._image.header.stamp) - recorded_ns
        raise UsageError(
            f"the camera published no image of the recording within {CAMERA_PATIENCE_S:.0f} s; see its log"
        )

    def play(self, rows: list[TimedInput], shift_ns: int) -> int:
        """Publish or call every input when it is due; return how many were late.

        With the permission for it this process gets real-time priority over the nodes: a real tracking camera does not
        use the computer's cores.

        Args:
            rows: the inputs, in the order of time.
            shift_ns: from recorded time to system time.

        Raises:
            UsageError: a service refuses.
        """
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
        late, answers = 0, {}
        for entry in rows:
            wait_s = 1e-9 * (entry.due_ns + shift_ns - time.time_ns())
            if wait_s > 0:
                time.sleep(wait_s)
            late += wait_s < -LATE_S
            if entry.service:
                answers[entry.service] = self._services[entry.service].call_async(Trigger.Request())
            else:
                self._odometry.publish(restamped(entry.odometry, shift_ns))
        time.sleep(0.2)  # for the last answers
        for service, answer in answers.items():
            self._guest.executor.spin_until_future_complete(answer, timeout_sec=5.0)
            if not answer.done() or not answer.result().success:
                why = answer.result().message if answer.done() else "no answer"
                raise UsageError(f"{service} was refused while the race was played: {why}")
        return late

    def close(self) -> None:
        """Leave the graph."""
        self._guest.close()
