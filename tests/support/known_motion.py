"""A motion in closed form for the tests of sensors: smooth, fast, rotating about all axes."""

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.imu_errors import ImuTruth

REACH, PACE, START = np.array([5.0, 4.0, 1.0]), np.array([2.0, 2.7, 3.1]), np.array([0.0, 1.0, 0.5])
SWING, BEAT, PHASE = np.array([0.9, 0.7, 1.1]), np.array([6.0, 5.0, 4.0]), np.array([0.3, 1.1, 2.0])


def motion(t) -> Moving:
    """Return the body at t (n,) s: up to 15 m/s and 7 rad/s."""
    t = np.asarray(t)[:, None]
    theta, rate = SWING * np.sin(BEAT * t + PHASE), SWING * BEAT * np.cos(BEAT * t + PHASE)
    return Moving(
        p_world=REACH * np.sin(PACE * t + START),
        q_world_body=geometry.quaternion_from_rotation_vector(theta),
        v_world=REACH * PACE * np.cos(PACE * t + START),
        omega_body=_body_rate(theta, rate),
    )


def _body_rate(theta, rate):
    """Return omega_body of the attitude exp(theta), by the right Jacobian of the rotation group."""
    angle = np.linalg.norm(theta, axis=-1, keepdims=True)
    across = geometry.cross(theta, rate)
    twice = geometry.cross(theta, across)
    return rate - (1 - np.cos(angle)) / angle**2 * across + (angle - np.sin(angle)) / angle**3 * twice


def specific_force(t):
    """Return the specific force (n, 3) in the body frame at t (n,) s."""
    a_world = -REACH * PACE**2 * np.sin(PACE * np.asarray(t)[:, None] + START)
    return geometry.rotate_inverse(motion(t).q_world_body, a_world + [0.0, 0.0, GRAVITY])


def imu_truth(seconds: float = 10.0, dt: float = 0.002, rotor_speed: float = 1500.0) -> ImuTruth:
    """Return the true motion of the centre of mass; angular acceleration by a difference over 20 us."""
    t = np.arange(round(seconds / dt)) * dt
    alpha_body = (motion(t + 1e-5).omega_body - motion(t - 1e-5).omega_body) / 2e-5
    rotor_speeds = np.full((len(t), 4), rotor_speed)
    return ImuTruth(dt, motion(t).omega_body, alpha_body, specific_force(t), rotor_speeds)
