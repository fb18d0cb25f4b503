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
        stamps = self._stamps[first:end]
        if not stamps or 1e-9 * (after.stamp_ns - stamps[-1]) > STALE_S:
            return None
        inside = [stamp for stamp in stamps if before.stamp_ns < stamp < after.stamp_ns]
        times = np.array([before.stamp_ns, *inside, after.stamp_ns])
        forces = np.array(self._forces[first:end])
        poses = [before, *(interpolate(before, after, stamp) for stamp in inside), after]
        at_times = np.stack([np.interp(times, stamps, axis) for axis in forces.T], axis=-1)
        turned = geometry.rotate(np.array([pose.q_world_body for pose in poses]), at_times)
        return np.trapezoid(turned, 1e-9 * (times - times[0]), axis=0)
