"""Becomes the program named on its command line, tied to its parent. A script of its own, run without site packages:
who starts it has threads, between whose fork and exec no Python may run.

    python -I -S launch.py PARENT PROGRAM ARGUMENT...
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29


def main() -> None:
    """Die with process PARENT, sleep no longer than asked for, and become the program."""
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    libc.prctl(_PR_SET_TIMERSLACK, 1)  # the firmware sleeps 50 us a turn, which the usual slack would double
    if os.getppid() != int(sys.argv[1]):  # died in between
        sys.exit(1)
    os.execv(sys.argv[2], sys.argv[2:])


if __name__ == "__main__":
    main()
