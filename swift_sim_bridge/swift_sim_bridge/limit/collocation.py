"""The time-optimal flight of a course by direct collocation: a sparse nonlinear program, solved by CasADi and IPOPT.

Each segment, from gate to gate, has its own duration and a fixed number of intervals. The order of the gates is given,
so that no progress variables are needed (Foehn et al. 2021, "Time-optimal planning for quadrotor waypoint flight",
allocate time to gates by complementarity constraints instead). An interval is a cubic that fulfils the equations of
motion at both ends and in its middle (Hermite-Simpson, of order 4), where the controls are chosen.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from swift_sim_bridge.limit.course import Course, passage, volume
from swift_sim_bridge.limit.models import Model, P, Q
from swift_sim_bridge.limit.obstacles import Detour, planes

MAX_ITERATIONS = 400  # of IPOPT; the shipped tracks take 30 to 100
TOLERANCE = 1e-6
# Where a term has a kink, such as the vortex ring, IPOPT may go to and fro across it at a constant time. It ends there:
# the equations then hold to a millimetre, and the time of a race no longer changes by 0.02 ms. `tol` has room for the
# jump of the gradient at the kink, which depends on the machine: 1e-4 was missed on one of two.
ACCEPTABLE = {"tol": 1e-3, "constr_viol_tol": 1e-4, "obj_change_tol": 1e-6, "iter": 5}
FIRST_BARRIER = 1e-2  # of IPOPT's barrier, a tenth of its default: the guesses are good
SHORTEST_S, LONGEST_S = 0.02, 60.0  # of a segment
SMOOTHNESS_S = 1e-4  # s; price of a change of one control over its whole range, which removes ringing
SOLVED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
INTERRUPTED = "NonIpopt_Exception_Thrown"  # what CasADi makes of Ctrl-C


class NoLine(Exception):
    """The program was not solved; the text is IPOPT's reason."""


@dataclass(frozen=True)
class Flight:
    """A flight of a course on a grid, as a guess or as the solution.

    Attributes:
        intervals: (m) number of intervals of each segment.
        durations_s: (m) of the segments.
        states: (2 n + 1, k) at the ends and in the middle of the intervals, n the number of all.
        controls: (2 n + 1, c).
    """

    intervals: np.ndarray
    durations_s: np.ndarray
    states: np.ndarray
    controls: np.ndarray

    @property
    def times_s(self) -> np.ndarray:
        """Times (2 n + 1) of states and controls from the start, s."""
        steps = np.repeat(self.durations_s / (2 * self.intervals), 2 * self.intervals)
        return np.r_[0.0, np.cumsum(steps)]

    @property
    def segments(self) -> np.ndarray:
        """Index (2 n + 1) of each point's segment; the point of a passage ends one."""
        return np.r_[0, np.repeat(np.arange(len(self.intervals)), 2 * self.intervals)]

    @property
    def passages_s(self) -> np.ndarray:
        """Times (m) of the passages, s from the start."""
        return np.cumsum(self.durations_s)


class _Constraints:
    """Expressions with their lower and upper bounds."""

    def __init__(self):
        self.expressions, self.low, self.high = [], [], []

    def add(self, expression, low=0.0, high=0.0) -> None:
        size = expression.numel()
        self.expressions.append(ca.vec(expression))
        self.low.append(np.broadcast_to(low, size))
        self.high.append(np.broadcast_to(high, size))


def solve(
    model: Model,
    course: Course,
    guess: Flight,
    report: Callable[[int, float], None],
    detours: Iterable[Detour] = (),
) -> Flight:
    """Return the time-optimal flight.

    Args:
        model: of the vehicle.
        course: to be flown.
        guess: from which the search begins; its grid is kept.
        report: called with iteration and time (s) of the flight at each iteration.
        detours: round the frames beside the way.

    Raises:
        NoLine: no flight was found from this guess.
    """
    size, controls, points = len(model.scale), len(model.control_scale), len(guess.states)
    x, u = ca.MX.sym("states", size, points), ca.MX.sym("controls", controls, points)
    durations = ca.MX.sym("durations", len(guess.intervals))
    variables = ca.veccat(x, u, durations)
    constraints = _Constraints()
    steps = ca.horzcat(*(ca.repmat(durations[i] / n, 1, n) for i, n in enumerate(map(int, guess.intervals))))
    _join(constraints, x, _scaled(model, model.rates).map(points)(x, u) / ca.repmat(model.scale, 1, points), steps)
    if model.room.size1_out(0):
        constraints.add(_scaled(model, model.room).map(points)(x, u), 0.0, np.inf)
    scale = ca.DM(model.scale)
    for end, gate in zip(2 * np.cumsum(guess.intervals), course.passages, strict=True):
        function, low, high = passage(course, model, gate)
        constraints.add(function(scale * x[:, int(end)]) / 10.0, low / 10.0, high / 10.0)
    for detour in detours:
        _go_round(constraints, course, detour, ca.DM(model.scale[P]) * x[P, list(detour.touch.points)])
    if course.begin is None:
        _close(constraints, model, x)
    program = {
        "x": variables,
        "f": ca.sum1(durations) + SMOOTHNESS_S * ca.sumsqr(u[:, 1:] - u[:, :-1]),
        "g": ca.vertcat(*constraints.expressions),
    }
    first, low, high = _start_and_bounds(model, course, guess)
    progress = _Progress(report, program, len(guess.intervals))
    solver = ca.nlpsol("limit", "ipopt", program, _options(progress))
    result = solver(
        x0=first, lbx=low, ubx=high, lbg=np.concatenate(constraints.low), ubg=np.concatenate(constraints.high)
    )
    status = solver.stats()["return_status"]
    if progress.interruption is not None:
        raise progress.interruption
    if status == INTERRUPTED:
        raise KeyboardInterrupt
    if status not in SOLVED:
        raise NoLine(f"{status.replace('_', ' ').lower()} after {solver.stats()['iter_count']} iterations")
    return _flight(model, guess, np.array(result["x"]).ravel())


def _scaled(model: Model, function: ca.Function) -> ca.Function:
    """Return a function of state and control as one of their scaled values."""
    x, u = ca.SX.sym("x", len(model.scale)), ca.SX.sym("u", len(model.control_scale))
    return ca.Function("scaled", [x, u], [function(ca.DM(model.scale) * x, ca.DM(model.control_scale) * u)])


def _join(constraints: _Constraints, x, rates, steps) -> None:
    """Add that each interval is a cubic with the right slope at its ends and in its middle.

    Args:
        constraints: to which is added.
        x: (k, 2 n + 1) scaled states.
        rates: (k, 2 n + 1) their time derivatives.
        steps: (1, n) s, lengths of the intervals.
    """
    first, middle, last = x[:, :-2:2], x[:, 1::2], x[:, 2::2]
    rate_first, rate_middle, rate_last = rates[:, :-2:2], rates[:, 1::2], rates[:, 2::2]
    steps = ca.repmat(steps, x.shape[0], 1)
    constraints.add(middle - 0.5 * (first + last) - steps / 8.0 * (rate_first - rate_last))
    constraints.add(last - first - steps / 6.0 * (rate_first + 4.0 * rate_middle + rate_last))


def _go_round(constraints: _Constraints, course: Course, detour: Detour, p_world) -> None:
    """Add that positions (3, k) m are on the detour's side of its frame."""
    track, gate = course.track, detour.touch.gate
    normals, offsets = planes(course, gate, detour.side)
    p_gate = ca.DM(track.rotations[gate].T) @ (p_world - ca.DM(track.positions[gate]))
    constraints.add((ca.DM(normals) @ p_gate - ca.DM(offsets)) / 10.0, 0.0, np.inf)


def _close(constraints: _Constraints, model: Model, x) -> None:
    """Add that a lap ends as it began."""
    first, last = x[:, 0], x[:, -1]
    for i in model.returning:
        constraints.add(first[int(i)] - last[int(i)])
    if not model.attitude:
        return
    q0, q1 = first[Q], last[Q]
    # the same attitude up to the sign of the quaternion: a lap may contain a flip
    constraints.add(q0[3] * q1[:3] - q1[3] * q0[:3] - ca.cross(q0[:3], q1[:3]))
    constraints.add(ca.sumsqr(q0), 1.0, 1.0)


def _start_and_bounds(model: Model, course: Course, guess: Flight):
    """Return the scaled first guess and the bounds of all variables."""
    points, segments = len(guess.states), len(guess.intervals)
    low, high = (np.tile(bound, (points, 1)) for bound in (model.low, model.high))
    low[:, P], high[:, P] = volume(course)
    begin = model.first_state(course.begin)
    given = np.isfinite(begin)
    low[0, given] = high[0, given] = begin[given]
    u_low, u_high = (np.tile(one / model.control_scale, (points, 1)) for one in (model.control_low, model.control_high))
    first = [guess.states / model.scale, guess.controls / model.control_scale, guess.durations_s]
    lows = [low / model.scale, u_low, np.full(segments, SHORTEST_S)]
    highs = [high / model.scale, u_high, np.full(segments, LONGEST_S)]
    return (np.concatenate([part.ravel() for part in parts]) for parts in (first, lows, highs))


def _flight(model: Model, guess: Flight, variables) -> Flight:
    """Return the flight of a solution."""
    points, size, segments = len(guess.states), len(model.scale), len(guess.intervals)
    states = variables[: points * size].reshape(points, size) * model.scale
    controls = variables[points * size : -segments].reshape(points, -1) * model.control_scale
    return Flight(guess.intervals, variables[-segments:], states, controls)


def _options(progress: ca.Callback) -> dict:
    ipopt = {"max_iter": MAX_ITERATIONS, "tol": TOLERANCE, "mu_init": FIRST_BARRIER, "print_level": 0, "sb": "yes"}
    ipopt |= {f"acceptable_{name}": value for name, value in ACCEPTABLE.items()}
    quiet = {"print_time": False, "show_eval_warnings": False}
    return {"iteration_callback": progress} | quiet | {f"ipopt.{name}": value for name, value in ipopt.items()}


class _Progress(ca.Callback):
    """Reports each iteration of a program whose last variables are the durations of the segments."""

    def __init__(self, report: Callable[[int, float], None], program: dict, segments: int):
        ca.Callback.__init__(self)
        self._report, self._segments, self._iteration = report, segments, 0
        self.interruption: BaseException | None = None  # raised by `report`, or by Ctrl-C
        self._sizes = {"x": program["x"].numel(), "f": 1, "g": program["g"].numel()}
        self.construct("progress", {})

    def get_n_in(self):
        return ca.nlpsol_n_out()

    def get_n_out(self):
        return 1

    def get_name_in(self, i):
        return ca.nlpsol_out(i)

    def get_name_out(self, i):
        return "ret"

    def get_sparsity_in(self, i):
        name = ca.nlpsol_out(i)
        sizes = self._sizes | {"lam_x": self._sizes["x"], "lam_g": self._sizes["g"]}
        return ca.Sparsity.dense(sizes[name], 1) if name in sizes else ca.Sparsity(0, 0)

    def eval(self, arguments):
        self._iteration += 1
        try:
            x = np.array(arguments[0]).ravel()
            self._report(self._iteration, float(np.sum(x[-self._segments :])))
        except BaseException as error:  # CasADi would report it as a failure of the solver
            self.interruption = error
        return [int(self.interruption is not None)]
