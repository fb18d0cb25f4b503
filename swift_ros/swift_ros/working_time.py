"""Working time: steady time in which this machine kept up with its work. No ROS.

Patience in lockstep is measured in it. A node that does not answer has failed, or it waits for a CPU: the steady clock
does not show which, the kernel does. Its pressure stall information counts the time in which tasks waited for a CPU.

A clock of this kind limits waiting and does nothing else: a race must remain a function of its seed.
"""

import os
import time
import weakref
from collections.abc import Callable
from pathlib import Path

PRESSURE = Path("/proc/pressure/cpu")  # the line `some` has `total=`, in us
READ_S = 0.05  # s; shortest time between two readings of the file: the clock is asked 1,000 times a second
MAX_STEP_S = 0.5  # s; in a longer step the caller itself did not run: a paused machine, a stopped process
WAITING_SHARE = 1 / 30  # of a time in which tasks waited: so much still counts, else a busy machine waits forever


class WorkingTime:
    """A clock that nearly stands still while tasks of this machine wait for a CPU. It never goes backwards.

    Ask it at least every MAX_STEP_S while you wait; a longer step counts as MAX_STEP_S. Its resolution is READ_S.
    Without pressure stall information it is the steady clock with this limit.
    """

    def __init__(self, pressure: Path = PRESSURE, clock: Callable[[], float] = time.monotonic):
        """Start at 0.

        Args:
            pressure: file of the kernel's pressure stall information about CPUs.
            clock: the steady clock, s.
        """
        self._clock = clock
        self._descriptor = _open(pressure)
        if self._descriptor is not None:
            weakref.finalize(self, os.close, self._descriptor)
        self._read_s, self._waited_s = clock(), _waited_s(self._descriptor)
        self._worked_s = 0.0

    def now_s(self) -> float:
        """Return the working time since the start, s."""
        steady_s = self._clock()
        passed_s = steady_s - self._read_s
        if passed_s < READ_S:
            return self._worked_s
        waited_s = _waited_s(self._descriptor)
        step_s = min(passed_s, MAX_STEP_S)
        self._worked_s += max(step_s - max(waited_s - self._waited_s, 0.0), WAITING_SHARE * step_s)
        self._read_s, self._waited_s = steady_s, waited_s
        return self._worked_s


def _open(pressure: Path) -> int | None:
    """Return a descriptor of the file; None when the kernel has no pressure stall information or it is switched off."""
    try:
        descriptor = os.open(pressure, os.O_RDONLY)
    except OSError:
        return None
    try:
        _waited_s(descriptor)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _waited_s(descriptor: int | None) -> float:
    """Return the time in which some task waited for a CPU so far, s; 0 without a descriptor."""
    if descriptor is None:
        return 0.0
    some = os.pread(descriptor, 200, 0).partition(b"\n")[0]
    return 1e-6 * int(some.rpartition(b"total=")[2])
