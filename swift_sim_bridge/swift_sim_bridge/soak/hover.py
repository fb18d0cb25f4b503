"""A pilot that holds the simulated vehicle at a height, by topics, from ground truth: for soaks of the simulator."""

import numpy as np

from swift_ros import geometry
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import GRAVITY

HEIGHT_M = 1.5
HEIGHT_GAIN, CLIMB_GAIN = 2.0, 3.0  # 1/s^2 and 1/s: damped, with a time constant of 1 s
PLACE_GAIN, SPEED_GAIN = 0.1, 0.2  # rad/m and rad per m/s of tilt: the vehicle stays within a metre
TILT_GAIN = 5.0  # 1/s, body rate per tilt
MAX_TILT = 0.3  # rad


def hover_command(state: Odometry, place: np.ndarray) -> BodyRateThrust:
    """Return the command that holds a place.

    Args:
        state: true state, map to base_link.
        place: (2,) m, x and y in the map.
    """
    v_world = geometry.rotate(state.q_world_body, state.v_body)
    up_body = geometry.rotate_inverse(state.q_world_body, np.array([0.0, 0.0, 1.0]))
    away = PLACE_GAIN * (place - state.p_world[:2]) - SPEED_GAIN * v_world[:2]
    wanted_world = np.array([*np.clip(away, -MAX_TILT, MAX_TILT), 1.0])
    wanted_body = geometry.rotate_inverse(state.q_world_body, wanted_world / np.linalg.norm(wanted_world))
    omega_body = TILT_GAIN * np.cross(np.array([0.0, 0.0, 1.0]), wanted_body)
    climb = HEIGHT_GAIN * (HEIGHT_M - state.p_world[2]) - CLIMB_GAIN * v_world[2]
    thrust = (GRAVITY + climb) / max(up_body[2], 0.5)
    return BodyRateThrust(state.stamp_ns, float(np.clip(thrust, 1.0, 2.0 * GRAVITY)), omega_body)
