"""Replays odometry and service calls of a recorded race, synchronised with a camera node that shows its images."""

import contextlib
import os
import struct
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

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
PATIENCE_S = 1.0  # for how long a refused service is called again: on a busy computer the flight controller arms later
AGAIN_S = 0.05  # time between two of these calls


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


class _Call(NamedTuple):
    """The last call of a service.

    Attributes:
        first_s: monotonic time of the first call of this service.
        last_s: monotonic time of this one.
        answer: future of the answer.
    """

    first_s: float
    last_s: float
    answer: Any

    @property
    def pending(self) -> bool:
        """Whether it has no answer, or was refused."""
        return not self.answer.done() or not self.answer.result().success


def restamped(data: bytes, shift_ns: int) -> bytes:
    """Return a serialized message, which begins with a header, with its stamp moved by `shift_ns`."""
    seconds, nanoseconds = divmod(header_stamp_ns(data) + shift_ns, NANOSECONDS)
    layout = "<iI" if data[1] & 1 else ">iI"
    return data[:4] + struct.pack(layout, seconds, nanoseconds) + data[12:]


@contextlib.contextmanager
def _real_time_priority():
    """Give this thread FIFO_PRIORITY, with the permission for it, until the end of the block."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


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

        A service that refuses is called again for PATIENCE_S. With the permission for it this thread gets real-time
        priority over the nodes: a real tracking camera does not use the computer's cores.

        Args:
            rows: the inputs, in the order of time.
            shift_ns: from recorded time to system time.

        Raises:
            UsageError: a service refuses.
        """
        late, calls = 0, {}
        with _real_time_priority():
            for entry in rows:
                wait_s = 1e-9 * (entry.due_ns + shift_ns - time.time_ns())
                if wait_s > 0:
                    time.sleep(wait_s)
                late += wait_s < -LATE_S
                if entry.service:
                    calls[entry.service] = self._call(entry.service)
                else:
                    self._odometry.publish(restamped(entry.odometry, shift_ns))
                if any(call.pending for call in calls.values()):
                    self._guest.spin_once(0.0)
                    calls |= self._called_again(calls)
        time.sleep(0.2)  # for the last answers
        for service, call in calls.items():
            self._guest.executor.spin_until_future_complete(call.answer, timeout_sec=5.0)
            if call.pending:
                why = call.answer.result().message if call.answer.done() else "no answer"
                raise UsageError(f"{service} was refused while the race was played: {why}")
        return late

    def _call(self, service: str, first_s: float | None = None) -> _Call:
        """Call a service, which was called first at `first_s`, or never."""
        now_s = time.monotonic()
        return _Call(first_s or now_s, now_s, self._services[service].call_async(Trigger.Request()))

    def _called_again(self, calls: dict[str, _Call]) -> dict[str, _Call]:
        """Return the new calls of services that have refused."""
        now_s = time.monotonic()
        return {
            service: self._call(service, call.first_s)
            for service, call in calls.items()
            if call.answer.done() and call.pending and call.last_s + AGAIN_S < now_s < call.first_s + PATIENCE_S
        }

    def close(self) -> None:
        """Leave the graph."""
        self._guest.close()
