"""Which publisher a message comes from, by its publication sequence number. No ROS.

A subscription keeps to the publisher that it began with. The middleware of ROS 2 Jazzy numbers the messages of each
publisher and hands the number over with the message; rclpy does not hand over the publisher's own identifier. This
refuses programs that publish by mistake or by chance. It is no protection against one that means harm: the packages of
Fast DDS for pip are built without DDS security.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass

MAX_RATE_HZ = 1000  # no publisher is faster: between two messages at most this many per second were lost
MAX_OTHERS = 8  # newest numbers of other publishers that are remembered
SILENCE_S = 1.0  # s after which another publisher may take over; by then the failsafe has ended a flight


class Origin(enum.Enum):
    """Whether a message is of the publisher that the subscription began with."""

    OWN = "own"
    UNSURE = "unsure"  # the number fits this publisher and another one
    AHEAD = "ahead"  # of another publisher, if there is one; else messages were lost
    BEHIND = "behind"  # of another publisher


@dataclass(frozen=True)
class Arrival:
    """A message's number and times.

    Attributes:
        sequence: publication sequence number.
        sent_s: s of the publisher's system clock.
        received_s: s of the steady clock.
    """

    sequence: int
    sent_s: float
    received_s: float


class PublisherBinding:
    """Follows the sequence numbers of one topic.

    Args:
        is_event: the topic has no rate: its messages may be few, so that their numbers say less.
    """

    def __init__(self, is_event: bool):
        self._is_event = is_event
        self._last: Arrival | None = None
        self._others: deque[int] = deque(maxlen=MAX_OTHERS)

    def origin(self, arrival: Arrival) -> Origin:
        """Return the origin of a message."""
        last, sequence = self._last, arrival.sequence
        if last is None:
            return Origin.OWN
        gap = sequence - last.sequence
        if gap <= 0:
            return Origin.BEHIND
        # A queue that overflows loses messages between two that are received at once: the times of sending count too.
        elapsed_s = max(arrival.sent_s - last.sent_s, arrival.received_s - last.received_s)
        if gap > 1 and (self._is_event or gap - 1 > math.ceil(MAX_RATE_HZ * elapsed_s)):
            return Origin.AHEAD
        if sequence - 1 in self._others or gap > 1 and sequence in self._others:
            return Origin.UNSURE if gap == 1 else Origin.AHEAD
        return Origin.UNSURE if self._is_event else Origin.OWN

    def accept(self, arrival: Arrival) -> None:
        """Note that a message was taken as the own publisher's."""
        self._last = arrival

    def refuse(self, arrival: Arrival) -> None:
        """Note that a message was refused as another publisher's."""
        self._others.append(arrival.sequence)

    def may_change(self, time_s: float) -> bool:
        """Return whether the own publisher has been silent for so long that another one may take its place.

        Args:
            time_s: s of the steady clock.
        """
        return self._last is not None and time_s - self._last.received_s > SILENCE_S
