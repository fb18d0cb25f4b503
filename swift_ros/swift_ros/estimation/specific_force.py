"""The integral of the specific force between two samples of the odometry."""

from bisect import bisect_left, bisect_right

import numpy as np

from swift_ros import geometry
from swift_ros.timeline import interpolate
from swift_ros.types import ImuSample, Odometry

KEPT = 1000  # samples of the IMU, 1 s at 1 kHz: as far back as gates may be late
STALE_S = 0.05  # an older sample says nothing about the present force


class SpecificForce:
    """The newest samples of the accelerometer, in body axes."""

    def __init__(self):
        self._stamps: list[int] = []
        self._forces: list[np.ndarray] = []

    def add(self, sample: ImuSample) -> None:
        """Add a sample; one without numbers, or that does not follow the last one, is ignored."""
        follows = not self._stamps or sample.stamp_ns > self._stamps[-1]
        if not follows or not np.isfinite(sample.specific_force_body).all():
            return
        self._stamps.append(sample.stamp_ns)
        self._forces.append(np.asarray(sample.specific_force_body))
        if len(self._stamps) > 2 * KEPT:
            del self._stamps[:KEPT], self._forces[:KEPT]

    def integral(self, before: Odometry, after: Odometry, until_ns: int) -> np.ndarray | None:
        """Return the integral (3,) m/s in the axes of the odometry; None where the samples have a gap.

        Args:
            before: attitude at the start.
            after: attitude at the end, a hundredth of a second later.
            until_ns: samples from this stamp on are not used, whether they have come or not.
        """
        first = max(bisect_right(self._stamps, before.stamp_ns) - 1, 0)
        end = min(bisect_left(self._stamps, until_ns), bisect_left(self._stamps, after.stamp_ns) + 1)
        if end <= first or 1e-9 * (after.stamp_ns - self._stamps[end - 1]) > STALE_S:
            return None
        inside = [stamp for stamp in self._stamps[first:end] if before.stamp_ns < stamp < after.stamp_ns]
        poses = [before, *(interpolate(before, after, stamp) for stamp in inside), after]
        turned = [geometry.rotate(pose.q_world_body, self._at(pose.stamp_ns, first, end)) for pose in poses]
        total = np.zeros(3)
        for k in range(1, len(poses)):  # trapezoids
            total += 0.5e-9 * (poses[k].stamp_ns - poses[k - 1].stamp_ns) * (turned[k - 1] + turned[k])
        return total

    def _at(self, stamp_ns: int, first: int, end: int) -> np.ndarray:
        """Return the force (3,) at a stamp by the samples [first, end): linear between them, constant beyond."""
        after = bisect_left(self._stamps, stamp_ns, first, end)
        if after in (first, end):
            return self._forces[min(after, end - 1)]
        earlier, later = self._stamps[after - 1 : after + 1]
        share = (stamp_ns - earlier) / (later - earlier)
        return self._forces[after - 1] + share * (self._forces[after] - self._forces[after - 1])
