"""What is flown: the gates in their order, from the podium or as a flying lap, and the room that the openings leave."""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.limit.models import Model, P, V

MIN_FORWARD_M_S = 0.5  # m/s along the direction of passage at a gate, so that its plane is crossed

STILL = 1e-2  # m/s, keeps the square root of a speed of zero differentiable


@dataclass(frozen=True)
class Course:
    """A course of segments, each of which ends with the passage of a gate.

    The hull is taken as the sphere that encloses it, so that no attitude makes it touch a frame.

    Attributes:
        name: for a reader.
        track: with the gates.
        passages: (m) index of the gate at the end of each segment.
        begin: (k) first entries of the first state: position, velocity, attitude and body rates; None for a flying lap,
            which begins where it ends.
        reach_m: radius of the hull's sphere, m.
    """

    name: str
    track: Track
    passages: tuple[int, ...]
    begin: np.ndarray | None
    reach_m: float

    @cached_property
    def waypoints(self) -> np.ndarray:
        """Centres of the gates (m + 1, 3) m, before them the podium or, of a flying lap, the last gate."""
        centres = self.track.positions[list(self.passages)]
        first = centres[-1] if self.begin is None else self.begin[P]
        return np.vstack([first, centres])


def flying_lap(track: Track, vehicle: Vehicle) -> Course:
    """Return the course from the passage of gate 1 to its next one."""
    gates = len(track.gates)
    return Course("flying lap", track, tuple((i + 1) % gates for i in range(gates)), None, reach(vehicle))


def race(track: Track, vehicle: Vehicle) -> Course:
    """Return the course of a whole race, from rest on the podium to the last passage of gate 1."""
    p_world, q_world_body = track.start_pose
    begin = np.concatenate([p_world, np.zeros(3), q_world_body, np.zeros(3)])
    passages = tuple(i % len(track.gates) for i in range(track.passages))
    return Course("race", track, passages, begin, reach(vehicle))


def reach(vehicle: Vehicle) -> float:
    """Return the radius (m) of the sphere that encloses the hull, a disc."""
    return float(np.hypot(vehicle.hull_radius, 0.5 * vehicle.hull_height))


def passage(course: Course, model: Model, gate: int) -> tuple[ca.Function, np.ndarray, np.ndarray]:
    """Return the constraints at the end of a segment: a function of the state, and its bounds low and high.

    They are the plane of the gate, forward motion, and the room of the hull's sphere while it crosses the depth of the
    frame on a straight line: |y| + reach sqrt(1 + s^2) + |s| depth / 2 <= inner_side / 2 at a slope s = v_y / v_x,
    multiplied by v_x, and alike along z.
    """
    track, rotation = course.track, ca.DM(course.track.rotations[gate])
    half_side, half_depth = 0.5 * track.inner_sides[gate], track.half_depth
    state = ca.SX.sym("state", len(model.scale))
    p = rotation.T @ (state[P] - ca.DM(track.positions[gate]))
    v = rotation.T @ state[V]
    room = []
    for i in (1, 2):
        extent = course.reach_m * ca.sqrt(v[0] ** 2 + v[i] ** 2 + STILL**2)
        room += [
            (half_side - side * p[i]) * v[0] - extent - slant * half_depth * v[i]
            for side in (-1.0, 1.0)
            for slant in (-1.0, 1.0)
        ]
    low = np.r_[0.0, MIN_FORWARD_M_S, np.zeros(len(room))]
    high = np.r_[0.0, np.full(1 + len(room), np.inf)]
    return ca.Function("passage", [state], [ca.vertcat(p[0], v[0], *room)]), low, high


def volume(course: Course) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest position (3) m of the centre; the hull does not touch the ground."""
    low, high = np.array(course.track.bounds_min, float), np.array(course.track.bounds_max, float)
    low[2] += course.reach_m
    return low, high
