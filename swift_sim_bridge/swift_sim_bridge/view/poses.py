"""The poses of the last second, and the pieces of a path. No ROS."""

from collections import deque

import numpy as np

from swift_ros import geometry
from swift_ros.types import Odometry

KEPT_NS = 1_000_000_000  # an image is processed in a fraction of it
PIECE_NS = 100_000_000  # a path is drawn in pieces: ten of them each second are quick to draw
GAP_NS = 300_000_000  # between two poses, over which no path is drawn


class Poses:
    """The poses of the last second."""

    def __init__(self):
        self._poses: deque[Odometry] = deque()

    def add(self, pose: Odometry) -> None:
        """Add a pose; one that is not later than the last begins anew."""
        if self._poses and pose.stamp_ns <= self._poses[-1].stamp_ns:
            self._poses.clear()
        self._poses.append(pose)
        while pose.stamp_ns - self._poses[0].stamp_ns > KEPT_NS:
            self._poses.popleft()

    def at(self, stamp_ns: int) -> Odometry | None:
        """Return the pose at a stamp, between its neighbours; None before the first and after the last."""
        later = None
        for pose in reversed(self._poses):
            if pose.stamp_ns == stamp_ns:
                return pose
            if pose.stamp_ns < stamp_ns:
                return None if later is None else _between(pose, later, stamp_ns)
            later = pose
        return None


def _between(first: Odometry, second: Odometry, stamp_ns: int) -> Odometry:
    share = (stamp_ns - first.stamp_ns) / (second.stamp_ns - first.stamp_ns)
    sign = 1.0 if np.dot(first.q_world_body, second.q_world_body) >= 0 else -1.0
    return Odometry(
        stamp_ns,
        (1 - share) * first.p_world + share * second.p_world,
        geometry.normalize((1 - share) * first.q_world_body + share * sign * second.q_world_body),
        (1 - share) * first.v_body + share * second.v_body,
        (1 - share) * first.omega_body + share * second.omega_body,
    )


class PathPieces:
    """Cuts a flown path into pieces; each begins where the last one ended."""

    def __init__(self):
        self._stamps: list[int] = []
        self._points: list[np.ndarray] = []

    def add(self, pose: Odometry) -> np.ndarray | None:
        """Add a pose; return the points (n, 3) m of the piece that it completes, else None."""
        if self._stamps and not 0 < pose.stamp_ns - self._stamps[-1] < GAP_NS:
            self._stamps, self._points = [], []
        self._stamps.append(pose.stamp_ns)
        self._points.append(pose.p_world)
        if pose.stamp_ns - self._stamps[0] < PIECE_NS:
            return None
        piece = np.array(self._points)
        self._stamps, self._points = self._stamps[-1:], self._points[-1:]
        return piece
