"""What pose and gyro tell of a flight's motion by themselves, through the filters. Pure.

It is worked out once for all variants of a vehicle whose instruments see the motion alike.
"""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals.filters import Filter, apply
from swift_sim_bridge.gap.residuals.sensor_correction import CorrectedMotion


@dataclass(frozen=True)
class Kinematics(CorrectedMotion):
    """Beside pose, velocity and gyro, at the m residuals: q_world_body (m, 4); v_world (m, 3) m/s, the position's
    slope; acceleration (m, 3) m/s^2 in the world that the pose tells, twice smoothed; turn_acceleration (m, 3)
    rad/s^2, the gyro's slope; turning (m, 3) rad/s, the pose's less the gyro's rate.
    gyro_turns (n - 2, 4): the gyro's turn over two steps."""

    q_world_body: np.ndarray
    v_world: np.ndarray
    acceleration: np.ndarray
    turn_acceleration: np.ndarray
    turning: np.ndarray
    gyro_turns: np.ndarray


def of(recording: Recording, corrected: CorrectedMotion, low: Filter, known: Kinematics | None = None) -> Kinematics:
    """Return what a recording, without what its sensors did wrong, tells through a filter. known: of the same gyro,
    whose share need not be worked out again."""
    moving, gyro = corrected.moving, corrected.gyro_body
    gyro_turns = known.gyro_turns if known else _turns(gyro, recording.dt)
    if recording.velocity_measured:
        acceleration = apply(low.slope_twice, moving.v_world)
    else:
        acceleration = apply(low.bend, moving.p_world)
    return Kinematics(
        moving,
        gyro,
        moving.q_world_body[low.rows],
        apply(low.slope, moving.p_world),
        acceleration,
        known.turn_acceleration if known else apply(low.slope, gyro),
        apply(low.smooth, _turning(moving.q_world_body, gyro_turns, recording.dt)),
        gyro_turns,
    )


def _turns(gyro, dt: float) -> np.ndarray:
    """Return the turn (n - 2, 4) of two steps by a gyro (n, 3) rad/s: one after the other, as order matters."""
    turns = geometry.quaternion_from_rotation_vector(0.5 * dt * (gyro[1:] + gyro[:-1]))
    return geometry.quaternion_multiply(turns[:-1], turns[1:])


def _turning(q_world_body, gyro_turns, dt: float) -> np.ndarray:
    """Return the pose's less the gyro's rate (n, 3) rad/s: the turn between two poses, less the gyro's."""
    conjugate = geometry.quaternion_conjugate
    between = geometry.quaternion_multiply(conjugate(q_world_body[:-2]), q_world_body[2:])
    apart = geometry.rotation_vector_from_quaternion(geometry.quaternion_multiply(conjugate(gyro_turns), between))
    return np.pad(apart / (2.0 * dt), ((1, 1), (0, 0)), mode="edge")
