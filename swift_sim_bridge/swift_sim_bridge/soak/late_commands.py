"""Age of the commands when their MSP frames are written, and how much of it the machine's stalls explain."""

import bisect
from collections import deque
from dataclasses import dataclass

LATE_S = 0.05  # s from the state to the frame that answers it; the firmware's failsafe is ten times slower
KEEP_S = 30.0  # s of readings of the stalls that are kept


@dataclass(frozen=True)
class LateCommand:
    """A command whose frame was written late.

    Attributes:
        stamp_ns: of the state that it answers.
        late_s: age of that state when the frame was written, s.
        stalled_s: time in which tasks waited for a CPU meanwhile, s.
    """

    stamp_ns: int
    late_s: float
    stalled_s: float

    @property
    def is_explained(self) -> bool:
        """Whether the machine's stalls explain the delay above LATE_S."""
        return self.stalled_s >= self.late_s - LATE_S


class Stalls:
    """Readings of the time in which tasks waited for a CPU."""

    def __init__(self):
        self._times_s: deque[float] = deque()
        self._waited_s: deque[float] = deque()

    def add(self, time_s: float, waited_s: float) -> None:
        """Add a reading: s of the system clock, and s waited so far."""
        self._times_s.append(time_s)
        self._waited_s.append(waited_s)
        while self._times_s[0] < time_s - KEEP_S:
            self._times_s.popleft()
            self._waited_s.popleft()

    def between(self, begin_s: float, end_s: float) -> float:
        """Return the time waited from the last reading before `begin_s` to the first one after `end_s`, s."""
        if not self._times_s:
            return 0.0
        first = max(bisect.bisect_right(self._times_s, begin_s) - 1, 0)
        last = min(bisect.bisect_left(self._times_s, end_s), len(self._times_s) - 1)
        return self._waited_s[last] - self._waited_s[first]
