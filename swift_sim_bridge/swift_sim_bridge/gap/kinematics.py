"""What pose and gyro tell of a flight's motion by themselves, through the filters. Pure.

It is worked out once for all variants of a vehicle whose instruments see the motion alike.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swift_ros import geometry
from swift_sim_bridge.gap.check import Recording
from swift_sim_bridge.gap.correction import Corrected
from swift_sim_bridge.gap.filters import Filter, apply
from swift_sim_bridge.sensors.clock import Moving


@dataclass(frozen=True)
class Kinematics:
    """recording; what its sensors did wrong taken out of it; the filter of its m residuals."""

    recording: Recording
    corrected: Corrected
    filter: Filter

    @property
    def gyro_body(self) -> np.ndarray:
        """The rates (n, 3) rad/s."""
        return self.corrected.gyro_body

    @property
    def moving(self) -> Moving:
        """Pose and velocity (n, ...)."""
        return self.corrected.moving

    @cached_property
    def q_world_body(self) -> np.ndarray:
        """Attitudes (m, 4) at the residuals."""
        return self.moving.q_world_body[self.filter.rows]

    @cached_property
    def v_world(self) -> np.ndarray:
        """The position's slope (m, 3) m/s."""
        return apply(self.filter.slope, self.moving.p_world)

    @cached_property
    def acceleration(self) -> np.ndarray:
        """The acceleration (m, 3) m/s^2 in the world that the pose tells, twice smoothed."""
        if self.recording.by_velocity:
            return apply(self.filter.slope_twice, self.moving.v_world)
        return apply(self.filter.bend, self.moving.p_world)

    @cached_property
    def turn_acceleration(self) -> np.ndarray:
        """The gyro's slope (m, 3) rad/s^2."""
        return apply(self.filter.slope, self.gyro_body)

    @cached_property
    def turning(self) -> np.ndarray:
        """The pose's less the gyro's rate (m, 3) rad/s: the turn between two poses, less the gyro's own turns one after
        the other, whose order matters."""
        dt, q, gyro = self.recording.dt, self.moving.q_world_body, self.gyro_body
        conjugate = geometry.quaternion_conjugate
        turns = geometry.quaternion_from_rotation_vector(0.5 * dt * (gyro[1:] + gyro[:-1]))
        told = geometry.quaternion_multiply(turns[:-1], turns[1:])
        between = geometry.quaternion_multiply(conjugate(q[:-2]), q[2:])
        apart = geometry.rotation_vector_from_quaternion(geometry.quaternion_multiply(conjugate(told), between))
        return apply(self.filter.smooth, np.pad(apart / (2.0 * dt), ((1, 1), (0, 0)), mode="edge"))
