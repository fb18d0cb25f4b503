"""Standard output whose reader may leave early: `swiftros gap FLIGHT | head -1` diagnoses and writes its files.

What is printed after the reader has closed its pipe is dropped, and the command goes on. A command that prints without
an end asks `is_read` whether anybody still reads.
"""

import contextlib
import io
import os
import stat
import sys
from collections.abc import Iterator


class _Pipe(io.FileIO):
    """The end of a pipe that one writes to; when its reader has closed it, its descriptor becomes the null device."""

    def __init__(self, descriptor: int):
        super().__init__(descriptor, "wb", closefd=False)
        self.is_read = True

    def write(self, data) -> int | None:
        try:
            return super().write(data)
        except BrokenPipeError:
            self.is_read = False
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self.fileno())  # child processes and libraries in C write to it, too
            os.close(null)
            return len(data)


def is_read() -> bool:
    """Return whether what is printed still has a reader."""
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return raw.is_read if isinstance(raw, _Pipe) else True


@contextlib.contextmanager
def lasting() -> Iterator[None]:
    """Let prints to standard output and standard error succeed although the reader of a pipe has left.

    Lines are written to a pipe at once, so that its reader sees the progress.
    """
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_lasting(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = before


def _lasting(stream):
    """Return a stream as it is, or where it writes to a pipe, another one to the same descriptor."""
    try:
        descriptor = stream.fileno()
        mode = os.fstat(descriptor).st_mode
    except (AttributeError, OSError, ValueError):  # no file behind it, as in tests
        return stream
    if not stat.S_ISFIFO(mode) and not stat.S_ISSOCK(mode):
        return stream
    stream.flush()
    return io.TextIOWrapper(io.BufferedWriter(_Pipe(descriptor)), stream.encoding, stream.errors, line_buffering=True)
