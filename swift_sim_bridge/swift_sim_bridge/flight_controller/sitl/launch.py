"""Script that ties itself to its parent process and then executes a program.

    python -I -S launch.py PARENT PROGRAM ARGUMENT...

It is a script, run without site packages, because the parent has threads: no Python code may run between fork and exec.
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29  # options of prctl(2)


def main() -> None:
    """Set the process to end with PARENT and to sleep without slack, then execute the program."""
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    libc.prctl(_PR_SET_TIMERSLACK, 1)  # the firmware sleeps for 50 us; the default slack is as long
    if os.getppid() != int(sys.argv[1]):  # the parent has already ended
        sys.exit(1)
    os.execv(sys.argv[2], sys.argv[2:])


if __name__ == "__main__":
    main()
