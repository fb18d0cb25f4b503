"""The space that braking takes: the way until the vehicle hovers, and from there down to the ground. No ROS."""

import math

import numpy as np

from swift_ros import geometry
from swift_ros.betaflight.failsafe import (
    BRAKED_M_S,
    CLIMB_DAMPING,
    DRAG_PER_S,
    LEAN_PER_SPEED,
    MAX_BRAKE_LEAN,
    MIN_TILT_COSINE,
)
from swift_ros.track import Track, to_gate_frame
from swift_ros.types import Odometry
from swift_ros.vehicle import GRAVITY, Vehicle

STEP_S = 0.02  # s
DELAY_S = 0.04  # s until the vehicle begins to turn to the attitude of braking
ANGLE_GAIN = 5.0  # 1/s, rate per error of roll or pitch in angle mode: the firmware's default angle_p_gain of 50
MAX_RATE = 10.0  # rad/s, in angle mode
LONGEST_S = 6.0  # s; after it a vehicle that brakes from 20 m/s stands in the air
SLOW_M_S = 0.2  # m/s, at which the way ends: it goes on for a metre while the vehicle already sinks
EDGE_M = 0.3  # m between hull and the edge of the flight volume
GROUND_M = 0.0  # m, height of the ground in the map
DOWN_STEP_M = 0.2  # m between the points on the way down


class BrakingSpace:
    """Predicts where a vehicle goes that brakes now, and how far from the gates that is.

    A gate counts as a closed square: braking through an opening is not safe. From the attitude of a race, 64 to 96
    degrees of tilt, six simulated vehicles came 0.3 to 0.7 m off the prediction.

    Args:
        track: gates and flight volume.
        vehicle: for the size of its hull.
        angle_limit: rad, largest roll and pitch in angle mode.
    """

    def __init__(self, track: Track, vehicle: Vehicle, angle_limit: float = MAX_BRAKE_LEAN):
        self._track, self._max_lean = track, min(MAX_BRAKE_LEAN, angle_limit)
        self._reach_m = math.hypot(vehicle.hull_radius, 0.5 * vehicle.hull_height)

    def clearance_m(self, state: Odometry) -> float:
        """Return the least distance (m) of hull and gates on the way from a state in the map to the ground.

        It is minus infinity where braking touches the ground or leaves the flight volume, and infinite for a vehicle
        that is slow: it gains nothing by flying on.
        """
        if math.dist(state.v_body, (0.0, 0.0, 0.0)) < BRAKED_M_S:
            return math.inf
        way = braking_way(state, self._max_lean)
        low, high = np.array(self._track.bounds_min) + EDGE_M, np.array(self._track.bounds_max) - EDGE_M
        low[2] = max(self._track.bounds_min[2], GROUND_M)
        if np.any(way < low + self._reach_m) or np.any(way > high - self._reach_m):
            return -math.inf
        heights = np.arange(low[2], way[-1, 2], DOWN_STEP_M)
        down = np.column_stack([np.tile(way[-1, :2], (len(heights), 1)), heights])
        return float(self._gate_distances(np.concatenate([way, down])).min()) - self._reach_m

    @staticmethod
    def height_m(state: Odometry) -> float:
        """Return the height of a state above the ground, m."""
        return float(state.p_world[2]) - GROUND_M

    def _gate_distances(self, points) -> np.ndarray:
        """Return the distances (n, gates) of points (n, 3) from the gates' squares, m."""
        track = self._track
        place = np.abs(to_gate_frame(track.positions, track.rotations, points[:, None]))
        half = np.column_stack([np.full(len(track.gates), track.half_depth), *[0.5 * track.outer_sides] * 2])
        return np.linalg.norm(np.maximum(place - half, 0.0), axis=-1)


def braking_way(state: Odometry, max_lean: float = MAX_BRAKE_LEAN) -> np.ndarray:
    """Return the predicted positions (n, 3) in the map, m, of a vehicle that brakes from now on, until it is slow.

    After DELAY_S the firmware's angle mode turns it to the roll and pitch of `failsafe.brake`, at most `max_lean` rad.
    """
    x, y, z = np.asarray(state.p_world, dtype=float).tolist()
    v_x, v_y, v_z = geometry.rotate(state.q_world_body, np.asarray(state.v_body, dtype=float)).tolist()
    attitude = tuple(np.asarray(state.q_world_body, dtype=float).tolist())
    rates = tuple(np.asarray(state.omega_body, dtype=float).tolist())
    way = [(x, y, z)]
    for step in range(round(LONGEST_S / STEP_S)):  # plain numbers: arrays of three take ten times as long
        if math.hypot(v_x, v_y) < SLOW_M_S:
            break
        if step * STEP_S >= DELAY_S:
            rates = _angle_mode(attitude, v_x, v_y, max_lean)
        attitude = _turned(attitude, rates)
        i, j, k, w = attitude
        upright = 1.0 - 2.0 * (i * i + j * j)
        thrust = max(GRAVITY - CLIMB_DAMPING * v_z, 0.0) / max(upright, MIN_TILT_COSINE)
        v_x += STEP_S * (thrust * 2.0 * (i * k + j * w) - DRAG_PER_S * v_x)
        v_y += STEP_S * (thrust * 2.0 * (j * k - i * w) - DRAG_PER_S * v_y)
        v_z += STEP_S * (thrust * upright - DRAG_PER_S * v_z - GRAVITY)
        x, y, z = x + STEP_S * v_x, y + STEP_S * v_y, z + STEP_S * v_z
        way.append((x, y, z))
    return np.array(way)


def _angle_mode(attitude, v_x: float, v_y: float, max_lean: float) -> tuple[float, float, float]:
    """Return the body rates (rad/s) with which angle mode turns to the lean against a velocity in the map."""
    i, j, k, w = attitude
    roll = math.atan2(2.0 * (j * k + i * w), 1.0 - 2.0 * (i * i + j * j))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (j * w - i * k))))  # nose down is positive
    yaw = math.atan2(2.0 * (i * j + k * w), 1.0 - 2.0 * (j * j + k * k))
    speed = math.hypot(v_x, v_y)
    forward, left = v_x * math.cos(yaw) + v_y * math.sin(yaw), v_y * math.cos(yaw) - v_x * math.sin(yaw)
    lean = min(LEAN_PER_SPEED * speed, max_lean) / speed
    errors = lean * left - roll, -lean * forward - pitch
    roll_rate, pitch_rate = (max(-MAX_RATE, min(MAX_RATE, ANGLE_GAIN * error)) for error in errors)
    return roll_rate, pitch_rate, 0.0


def _turned(attitude, rates) -> tuple[float, ...]:
    """Return an attitude (x y z w) turned by body rates (rad/s) for one step."""
    i, j, k, w = attitude
    p, q, r = (0.5 * STEP_S * rate for rate in rates)
    turned = (
        i + w * p + j * r - k * q,
        j + w * q + k * p - i * r,
        k + w * r + i * q - j * p,
        w - i * p - j * q - k * r,
    )
    length = math.sqrt(sum(part * part for part in turned))
    return tuple(part / length for part in turned)
