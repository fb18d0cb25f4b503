"""Age of the commands when their MSP frames are written, and how much of it the machine's stalls explain."""

import bisect
import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from swift_ros.working_time import PRESSURE

STATISTICS = Path("/proc/stat")
STOLEN = 8  # column of its first line: time in which another guest of the host had the CPUs
LATE_S = 0.05  # s from the state to the frame that answers it; the firmware's failsafe is ten times slower
KEEP_S = 30.0  # s of readings of the stalls that are kept


@dataclass(frozen=True)
class LateCommand:
    """A command whose frame was written late.

    Attributes:
        stamp_ns: of the state that it answers.
        late_s: age of that state when the frame was written, s.
        stalled_s: stalls of the machine meanwhile, s.
    """

    stamp_ns: int
    late_s: float
    stalled_s: float

    @property
    def is_explained(self) -> bool:
        """Whether the machine's stalls explain the delay above LATE_S."""
        return self.stalled_s >= self.late_s - LATE_S


def stalled_s(pressure: Path = PRESSURE, statistics: Path = STATISTICS) -> float:
    """Return the time in which this machine stalled so far, s.

    It is the time in which tasks waited for a CPU (pressure stall information), and that in which the host gave the
    CPUs of this virtual machine to another one. Tasks of the idle scheduling class wait whenever there is other work:
    nothing of that class may run beside a soak. What a kernel does not report is 0.
    """
    waited = pressure.read_text().partition("\n")[0].rpartition("total=")[2] if pressure.is_file() else "0"
    times = statistics.read_text().partition("\n")[0].split() if statistics.is_file() else []
    stolen = int(times[STOLEN]) / os.sysconf("SC_CLK_TCK") if len(times) > STOLEN else 0.0
    return 1e-6 * int(waited) + stolen


class Stalls:
    """Readings of the time in which this machine stalled.

    Args:
        read: returns this time so far, s.
        now: returns the time, s of the system clock.
    """

    def __init__(self, read: Callable[[], float] = stalled_s, now: Callable[[], float] = time.time):
        self._read, self._now = read, now
        self._times_s: deque[float] = deque()
        self._waited_s: deque[float] = deque()

    def take(self) -> None:
        """Take a reading now."""
        self._times_s.append(self._now())
        self._waited_s.append(self._read())
        while self._times_s[0] < self._times_s[-1] - KEEP_S:
            self._times_s.popleft()
            self._waited_s.popleft()

    def between(self, begin_s: float, end_s: float) -> float:
        """Return the stalls from the last reading before `begin_s` to the first one after `end_s`, s.

        Where no reading is after `end_s` yet, one is taken now.
        """
        if not self._times_s or self._times_s[-1] < end_s:
            self.take()
        first = max(bisect.bisect_right(self._times_s, begin_s) - 1, 0)
        last = min(bisect.bisect_left(self._times_s, end_s), len(self._times_s) - 1)
        return self._waited_s[last] - self._waited_s[first]
