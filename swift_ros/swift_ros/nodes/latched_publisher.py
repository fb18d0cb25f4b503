"""Publisher of a latched topic in real time: late subscribers receive the last message alone, present ones all."""

import time

from rclpy.duration import Duration

SOON_S = 0.1  # s; a message that follows the last one by less may replace it before all subscribers have it
RECEIVED = Duration(nanoseconds=20_000_000)  # longest wait for them; one that is stopped must not delay the node more


class LatchedPublisher:
    """Wraps a publisher of depth 1. A message waits for a moment until all subscribers have received the last one."""

    def __init__(self, publisher):
        self._publisher, self._published_s = publisher, -SOON_S

    def publish(self, message) -> None:
        """Publish a message."""
        if time.monotonic() - self._published_s < SOON_S:
            self._publisher.wait_for_all_acked(RECEIVED)
        self._publisher.publish(message)
        self._published_s = time.monotonic()
