"""Quantities of the motion that pose and gyro give without a model of the vehicle, filtered."""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals.filters import Filter, apply
from swift_sim_bridge.gap.residuals.sensor_correction import CorrectedMotion


@dataclass(frozen=True)
class Kinematics(CorrectedMotion):
    """The corrected motion, and what follows from it at the m times of the residuals.

    Attributes:
        q_world_body: (m, 4).
        v_world: (m, 3) m/s, slope of the position.
        acceleration: (m, 3) m/s^2 in the world, from the pose; filtered by `Filter.smooth_twice`.
        turn_acceleration: (m, 3) rad/s^2, slope of the gyro.
        rate_difference: (m, 3) rad/s, rate of the attitude minus gyro.
        gyro_rotation: (n - 2, 4) rotation over two steps from the gyro.
    """

    q_world_body: np.ndarray
    v_world: np.ndarray
    acceleration: np.ndarray
    turn_acceleration: np.ndarray
    rate_difference: np.ndarray
    gyro_rotation: np.ndarray


def compute_kinematics(
    recording: Recording, corrected: CorrectedMotion, low: Filter, same_gyro: Kinematics | None = None
) -> Kinematics:
    """Return the kinematics of a recording.

    Args:
        recording: the recording.
        corrected: its pose, velocity and gyro without the sensors' errors.
        low: the filter.
        same_gyro: kinematics with the same corrected gyro, from which the gyro's part is taken.
    """
    moving, gyro = corrected.moving, corrected.gyro_body
    gyro_rotation = same_gyro.gyro_rotation if same_gyro else _rotation_over_two_steps(gyro, recording.dt)
    if recording.velocity_measured:
        acceleration = apply(low.slope_twice, moving.v_world)
    else:
        acceleration = apply(low.curvature, moving.p_world)
    return Kinematics(
        moving=moving,
        gyro_body=gyro,
        q_world_body=moving.q_world_body[low.rows],
        v_world=apply(low.slope, moving.p_world),
        acceleration=acceleration,
        turn_acceleration=same_gyro.turn_acceleration if same_gyro else apply(low.slope, gyro),
        rate_difference=apply(low.smooth, _rate_difference(moving.q_world_body, gyro_rotation, recording.dt)),
        gyro_rotation=gyro_rotation,
    )


def _rotation_over_two_steps(gyro, dt: float) -> np.ndarray:
    """Return the rotation (n - 2, 4) over two steps from a gyro (n, 3) rad/s, as a product of two."""
    turns = geometry.quaternion_from_rotation_vector(0.5 * dt * (gyro[1:] + gyro[:-1]))
    return geometry.quaternion_multiply(turns[:-1], turns[1:])


def _rate_difference(q_world_body, gyro_rotation, dt: float) -> np.ndarray:
    """Return the rate (n, 3) rad/s between attitudes (n, 4) minus the gyro's."""
    conjugate = geometry.quaternion_conjugate
    between = geometry.quaternion_multiply(conjugate(q_world_body[:-2]), q_world_body[2:])
    apart = geometry.rotation_vector_from_quaternion(geometry.quaternion_multiply(conjugate(gyro_rotation), between))
    return np.pad(apart / (2.0 * dt), ((1, 1), (0, 0)), mode="edge")
