"""The first guess of a time-optimal flight: a point mass with bounded thrust and jerk, which becomes a rigid body.

The thrust of the point mass may turn as fast as the vehicle can. Its solution is found from straight lines between the
gates and shows on which sides of the gates the flight leads. Attitudes follow from the direction of thrust, with as
little rotation about it as possible.
"""

import casadi as ca
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.limit.collocation import Flight, solve
from swift_sim_bridge.limit.course import Course
from swift_sim_bridge.limit.models import OMEGA, POSE, Model, P, Q, V

INTERVALS = 20  # of a segment of the point mass
CRUISE_M_S = 10.0  # speed on the straight lines
SHORTEST_GUESS_S = 0.3  # s, of a segment between gates that stand in one place
LEAST_THRUST_SHARE = 0.14  # of the largest thrust: the direction of none is not known
FULL_SHARE = 0.95  # of the rotors' range in the guess: away from the bounds, from where IPOPT converges faster
THRUST = slice(6, 9)  # of a point mass


def point_mass(vehicle: Vehicle, turning: float) -> Model:
    """Return a point mass whose thrust is bounded as the vehicle's; state p, v and thrust (m/s^2), control its change.

    Args:
        vehicle: the vehicle file.
        turning: largest change of the thrust, as a share of that of full thrust at the vehicle's largest roll rate.
    """
    largest = vehicle.max_thrust / vehicle.mass
    jerk = turning * vehicle.rates.max[0] * largest
    state, control = ca.SX.sym("state", 9), ca.SX.sym("control", 3)
    thrust = state[THRUST]
    rates = ca.vertcat(state[V], thrust - ca.DM([0.0, 0.0, GRAVITY]), control)
    squared = ca.sumsqr(thrust) / largest**2
    free = np.full(9, np.inf)
    return Model(
        rates=ca.Function("rates", [state, control], [rates]),
        room=ca.Function("room", [state, control], [ca.vertcat(1.0 - squared, squared - LEAST_THRUST_SHARE**2)]),
        scale=np.r_[np.full(6, 10.0), np.full(3, largest)],
        low=-free,
        high=free,
        control_scale=np.full(3, jerk),
        control_low=np.full(3, -jerk),
        control_high=np.full(3, jerk),
        rest=np.full(9, np.nan),
        loaded=np.full(9, np.nan),
        returning=np.arange(9),
        attitude=False,
    )


def straight_lines(course: Course) -> Flight:
    """Return the flight of a point mass from gate to gate at constant speed, in hover."""
    places = course.waypoints
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    durations = np.maximum(lengths / CRUISE_M_S, SHORTEST_GUESS_S)
    points_each = 2 * INTERVALS
    shares = np.arange(points_each)[:, None] / points_each
    ways = [places[i] + shares * (places[i + 1] - places[i]) for i in range(len(durations))]
    p_world = np.vstack([*ways, places[-1:]])
    v_world = np.vstack(
        [np.repeat(np.diff(places, axis=0) / durations[:, None], points_each, axis=0), np.zeros((1, 3))]
    )
    v_world[-1] = v_world[-2]
    hover = np.tile([0.0, 0.0, GRAVITY], (len(p_world), 1))
    intervals = np.full(len(durations), INTERVALS)
    return Flight(intervals, durations, np.hstack([p_world, v_world, hover]), np.zeros((len(p_world), 3)))


def first_guess(vehicle: Vehicle, course: Course, step_s: float, turning: float, report) -> Flight:
    """Return a guess of the rigid body's flight: states up to the body rates, and equal rotor speeds as controls.

    Args:
        vehicle: the vehicle file.
        course: to be flown.
        step_s: longest interval of its grid.
        turning: of the point mass.
        report: see `collocation.solve`.

    Raises:
        NoLine: not even the point mass finds a way.
    """
    path = solve(point_mass(vehicle, turning), course, straight_lines(course), report)
    intervals = np.maximum(np.ceil(path.durations_s / step_s).astype(int), 8)
    shell = Flight(intervals, path.durations_s, path.states, path.controls)
    times = shell.times_s
    p, v, thrust = (
        np.stack([np.interp(times, path.times_s, column) for column in path.states[:, part].T], axis=1)
        for part in (P, V, THRUST)
    )
    size = np.linalg.norm(thrust, axis=1)
    yaw_first = np.array(0.0) if course.begin is None else geometry.yaw_of(course.begin[Q])
    q = _attitudes(thrust / size[:, None], yaw_first)
    if course.begin is None:
        q = _closed(q, times / times[-1])
    omega = _body_rates(q, times, np.array(vehicle.rates.max))
    speed = np.sqrt(size * vehicle.mass / (len(vehicle.rotors) * vehicle.thrust_coefficient))
    low, high = vehicle.rotor_speed_range
    controls = np.repeat(np.clip(speed, low, FULL_SHARE * high)[:, None], len(vehicle.rotors), axis=1)
    states = np.hstack([p, v, q, omega])
    if course.begin is not None:
        states[0] = course.begin
    return Flight(intervals, path.durations_s, states, controls)


def with_drive(flight: Flight, model: Model, slower: float) -> Flight:
    """Return a flight of the rigid body with the rotors and the pack of another model.

    Args:
        flight: whose controls are rotor speeds.
        model: with further entries of the state.
        slower: factor of all times, for a model of less thrust.
    """
    rotors = FULL_SHARE * flight.controls
    further = len(model.scale) - POSE
    rest = np.tile(model.rest[POSE:], (len(flight.states), 1))
    rest[:, : rotors.shape[1]] = rotors[:, :further]
    states = np.hstack([flight.states[:, :POSE], rest])
    states[:, V] /= slower
    states[:, OMEGA] /= slower
    return Flight(flight.intervals, slower * flight.durations_s, states, rotors)


def _attitudes(up: np.ndarray, yaw_first: np.ndarray) -> np.ndarray:
    """Return attitudes (n, 4) with the body's z axis along `up` (n, 3), each turned from the last the shortest way."""
    upright = geometry.quaternion_from_yaw(yaw_first)
    q = [geometry.quaternion_multiply(_shortest(np.array([0.0, 0.0, 1.0]), up[0]), upright)]
    for before, after in zip(up[:-1], up[1:], strict=True):
        q.append(geometry.quaternion_multiply(_shortest(before, after), q[-1]))
    return np.array(q)


def _shortest(a, b) -> np.ndarray:
    """Return the quaternion (4) of the smallest rotation from unit vector a to b."""
    q = np.r_[geometry.cross(a, b), 1.0 + a @ b]
    if np.linalg.norm(q) < 1e-6:  # opposite: about any axis across
        q = np.r_[geometry.cross(a, np.eye(3)[np.argmin(np.abs(a))]), 0.0]
    return q / np.linalg.norm(q)


def _closed(q: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return attitudes (n, 4) that end as they began, by a rotation about the body's z axis that grows with `share`."""
    left = geometry.quaternion_multiply(geometry.quaternion_conjugate(q[-1]), q[0])
    angle = (2.0 * np.arctan2(left[2], left[3]) + np.pi) % (2.0 * np.pi) - np.pi
    return geometry.quaternion_multiply(q, geometry.quaternion_from_yaw(angle * share))


def _body_rates(q: np.ndarray, times_s: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Return the body rates (n, 3) rad/s between attitudes (n, 4), within 90 % of the largest."""
    turns = geometry.quaternion_multiply(geometry.quaternion_conjugate(q[:-1]), q[1:])
    omega = geometry.rotation_vector_from_quaternion(turns) / np.diff(times_s)[:, None]
    return np.clip(np.vstack([omega, omega[-1:]]), -0.9 * largest, 0.9 * largest)
