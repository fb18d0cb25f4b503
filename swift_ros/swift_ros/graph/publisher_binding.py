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
MAX_OTHERS = 8  # other publishers that are followed, the newest
WINDOW = 50  # messages of which the period of a publisher is the mean
# After a message that could be either publisher's: so many own periods later, a period that differs by more than this
# ratio shows that the wrong one was followed.
TRIALS = ((5, 1.6), (20, 1.2), (60, 1.1))
EVENT_ERROR = 0.2  # share of another publisher's period within which its next message comes; events have no period
SILENCE_S = 1.0  # s after which another publisher may take over; by then the failsafe has ended a flight


class Origin(enum.Enum):
    """Whether a message is of the publisher that the subscription began with."""

    OWN = "own"
    UNSURE = "unsure"  # the number fits, but another publisher's next message may have it too
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


class _Stream:
    """The messages of one publisher.

    Attributes:
        last: the newest.
    """

    def __init__(self, first: Arrival):
        self.last = first
        self._window = deque([first], maxlen=WINDOW)

    def add(self, arrival: Arrival) -> None:
        """Add the next message."""
        self.last = arrival
        self._window.append(arrival)

    def gap(self, arrival: Arrival) -> int:
        """Return how many numbers a message is after the newest one."""
        return arrival.sequence - self.last.sequence

    @property
    def period_s(self) -> float:
        """Mean time of sending from one number to the next, s; 0 before the second message."""
        return _period_s(self._window[0], self.last)

    def error(self, arrival: Arrival) -> float:
        """Return by which share of the period the next message misses the time at which it is due."""
        period_s = self.period_s
        return abs((arrival.sent_s - self.last.sent_s) / period_s - 1) if period_s > 0 else 1.0


@dataclass
class _Tie:
    """Two publishers of which one message could be.

    Attributes:
        period_s: of the own publisher until then, s.
        streams: followed, and the other one.
        before: their last messages before the tie.
        trials: that are left.
    """

    period_s: float
    streams: list[_Stream]
    before: list[Arrival]
    trials: list[tuple[int, float]]

    def is_wrong(self, sent_s: float) -> bool:
        """Return whether the stream that is not followed has the own period, and the followed one has not."""
        periods, limit = self.trials[0]
        if sent_s - self.before[0].sent_s < periods * self.period_s:
            return False
        self.trials.pop(0)
        found = [_period_s(first, stream.last) for first, stream in zip(self.before, self.streams, strict=True)]
        return _ratio(found[0], self.period_s) > limit > _ratio(found[1], self.period_s)


class PublisherBinding:
    """Follows the sequence numbers and times of one topic.

    Numbers of a faster publisher overtake the own ones. While both publishers have the same number next, the times of
    sending decide; if they decided wrongly, the period of the messages taken shows it.

    Args:
        is_event: the topic has no rate: its messages may be few, so that their numbers say less.
    """

    def __init__(self, is_event: bool):
        self._is_event = is_event
        self._own: _Stream | None = None
        self._others: deque[_Stream] = deque(maxlen=MAX_OTHERS)
        self._tie: _Tie | None = None

    def origin(self, arrival: Arrival) -> Origin:
        """Return the origin of a message."""
        own = self._own
        if own is None:
            return Origin.OWN
        gap = own.gap(arrival)
        if gap <= 0:
            return Origin.BEHIND
        # A queue that overflows loses messages between two that are received at once: the times of sending count too.
        elapsed_s = max(arrival.sent_s - own.last.sent_s, arrival.received_s - own.last.received_s)
        if gap > 1 and (self._is_event or gap - 1 > math.ceil(MAX_RATE_HZ * elapsed_s)):
            return Origin.AHEAD
        other = self._other(arrival)
        if other is None:
            return Origin.UNSURE if self._is_event else Origin.OWN
        if gap > 1 or other.error(arrival) < (EVENT_ERROR if self._is_event else own.error(arrival)):
            return Origin.AHEAD
        return Origin.UNSURE

    def _other(self, arrival: Arrival) -> _Stream | None:
        """Return the other publisher whose next message this may be."""
        return next((stream for stream in self._others if stream.gap(arrival) == 1), None)

    def accept(self, arrival: Arrival) -> None:
        """Note that a message was taken as the own publisher's."""
        own, other = self._own, self._other(arrival)
        if own is None or own.gap(arrival) <= 0:  # the first publisher, or one that took its place and counts anew
            self._own, self._tie = _Stream(arrival), None
            return
        self._begin_tie(own, other)
        own.add(arrival)
        self._end_tie(arrival)

    def refuse(self, arrival: Arrival) -> None:
        """Note that a message was refused as another publisher's."""
        own, other = self._own, self._other(arrival)
        if other is None:
            self._others.append(_Stream(arrival))
            return
        if own and own.gap(arrival) == 1:
            self._begin_tie(own, other)
        other.add(arrival)
        self._end_tie(arrival)

    def _begin_tie(self, own: _Stream, other: _Stream | None) -> None:
        if other and not self._tie and not self._is_event:
            self._tie = _Tie(own.period_s, [own, other], [own.last, other.last], list(TRIALS))

    def _end_tie(self, arrival: Arrival) -> None:
        """Follow the other publisher if the times show that it is the own one."""
        tie = self._tie
        if not tie:
            return
        if tie.is_wrong(arrival.sent_s):
            own, other = tie.streams
            if other in self._others:
                self._others.remove(other)
                self._others.append(own)
                self._own = other
                tie.streams.reverse()
                tie.before.reverse()
        if not tie.trials:
            self._tie = None

    def may_change(self, time_s: float) -> bool:
        """Return whether the own publisher has been silent for so long that another one may take its place.

        Args:
            time_s: s of the steady clock.
        """
        return self._own is not None and time_s - self._own.last.received_s > SILENCE_S


def _period_s(first: Arrival, last: Arrival) -> float:
    return (last.sent_s - first.sent_s) / max(last.sequence - first.sequence, 1)


def _ratio(a: float, b: float) -> float:
    """Return the ratio of two times, above 1."""
    return max(a, b) / max(min(a, b), 1e-9)
