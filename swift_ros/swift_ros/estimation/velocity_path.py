"""The path of visual-inertial odometry as the integral of its velocity.

Each image, and each correction of its map, moves the position of such odometry by a jump that no motion explains. Its
velocity has no jumps. Over the tenths of a second between two gates the integral of the velocity is therefore the more
accurate path. Over many seconds it would drift where the velocity has an offset, so it returns slowly to the position.
"""

from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.types import Odometry

LONGEST_STEP_S = 0.05  # longer gaps are crossed by the position; the trapezoid is wrong by 1 cm at a jerk of 1000 m/s^3


class VelocityPath:
    """The path.

    Args:
        return_s: time constant of the return to the position, s.
    """

    def __init__(self, return_s: float):
        self._return_s = return_s
        self._last: tuple[Odometry, np.ndarray, np.ndarray] | None = None  # with velocity and path

    def add(self, odometry: Odometry) -> Odometry:
        """Return the odometry with its position on the path. Stamps must increase."""
        velocity = geometry.rotate(odometry.q_world_body, odometry.v_body)
        position = odometry.p_world if self._last is None else self._next(odometry, velocity, *self._last)
        self._last = odometry, velocity, position
        return replace(odometry, p_world=position)

    def _next(self, odometry: Odometry, velocity, before: Odometry, velocity_before, position):
        dt = 1e-9 * (odometry.stamp_ns - before.stamp_ns)
        if dt > LONGEST_STEP_S:
            return position + odometry.p_world - before.p_world
        position = position + 0.5 * dt * (velocity_before + velocity)
        return position - np.expm1(-dt / self._return_s) * (odometry.p_world - position)
