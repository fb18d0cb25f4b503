"""Waiting in tests: long enough for a machine that also builds or trains."""

import time

PATIENCE_S = 240.0  # longest wait for a condition


def wait_for(condition, what="it did not happen"):
    """Return when `condition()` holds; fail with the text `what` after PATIENCE_S."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.02)
