"""How long tests wait: as long as anything may take on a machine that also builds or trains."""

import time

PATIENCE_S = 240.0


def wait_for(condition, what="it did not happen"):
    """Return once a condition holds; fail with `what` when it does not come to that."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.02)
