"""The solver of the limit against flights whose shortest time is known."""

import dataclasses

import casadi as ca
import numpy as np
import pytest

from swift_ros.track import Gate, Track
from swift_sim_bridge.limit.collocation import Flight, NoLine, solve
from swift_sim_bridge.limit.course import Course
from swift_sim_bridge.limit.models import Model, P, V
from swift_sim_bridge.limit.obstacles import touches
from swift_sim_bridge.limit.solve import clear_of_frames

FORCE_M_S2, REACH_M = 8.0, 0.2


def track(*gates: Gate) -> Track:
    """Return a track in a large hall, without a podium of interest."""
    return Track("hall", gates, 1.5, 2.1, 0.1, (0.0, 0.0, 2.0), 0.0, 1, (-50.0, -50.0, 0.0), (50.0, 50.0, 20.0))


def pushed_mass() -> Model:
    """Return a mass without gravity and drag, pushed along x, y and z by at most FORCE_M_S2 each."""
    state, control = ca.SX.sym("state", 6), ca.SX.sym("control", 3)
    return Model(
        rates=ca.Function("rates", [state, control], [ca.vertcat(state[V], control)]),
        room=ca.Function("room", [state, control], [ca.SX(0, 1)]),
        scale=np.full(6, 10.0),
        low=np.full(6, -np.inf),
        high=np.full(6, np.inf),
        control_scale=np.full(3, FORCE_M_S2),
        control_low=np.full(3, -FORCE_M_S2),
        control_high=np.full(3, FORCE_M_S2),
        rest=np.full(6, np.nan),
        loaded=np.full(6, np.nan),
        returning=np.arange(6),
        attitude=False,
    )


def from_rest(course: Course, intervals: int = 20) -> Flight:
    """Return a slow flight along straight lines as a guess."""
    segments = len(course.passages)
    shares = np.linspace(0.0, segments, 2 * segments * intervals + 1)
    p_world = np.stack([np.interp(shares, np.arange(segments + 1), axis) for axis in course.waypoints.T], axis=1)
    v_world = np.gradient(p_world, axis=0) * intervals
    return Flight(
        np.full(segments, intervals), np.ones(segments), np.hstack([p_world, v_world]), np.zeros((len(shares), 3))
    )


def sprint(distance_m: float) -> Course:
    """Return a course from rest to a gate straight ahead."""
    one = track(Gate((distance_m, 0.0, 2.0), 0.0))
    begin = np.array([0.0, 0.0, 2.0, *np.zeros(3), 0.0, 0.0, 0.0, 1.0, *np.zeros(3)])
    return Course("sprint", one, (0,), begin, REACH_M)


def test_a_sprint_takes_the_time_of_full_force():
    """From rest over 16 m at 8 m/s^2: sqrt(2 d / a) = 2 s, at full force throughout."""
    course = sprint(16.0)
    flown = solve(pushed_mass(), course, from_rest(course), lambda iteration, time_s: None)
    assert flown.durations_s.sum() == pytest.approx(2.0, abs=1e-3)
    assert flown.controls[:-1, 0] == pytest.approx(FORCE_M_S2, rel=1e-3)


def test_there_and_back_is_bang_bang():
    """Through a gate and back to one behind the start: the force changes its sign once on the way to each turn.

    The second gate faces backwards at the start. Without a limit of speed the mass passes gate 1 at v, and needs
    2 v / a + sqrt(...) to come back; the shortest time follows from one speed, found on a grid.
    """
    one = track(Gate((4.0, 0.0, 2.0), 0.0), Gate((0.0, 0.0, 2.0), 180.0))
    course = Course("there and back", one, (0, 1), sprint(4.0).begin, REACH_M)
    flown = solve(pushed_mass(), course, from_rest(course), lambda iteration, time_s: None)

    def time_s(v):  # full force for t1, then braking to v at the gate; back from there under full force
        peak = np.sqrt((v**2 + 2 * FORCE_M_S2 * 4.0) / 2)
        back = (v + np.sqrt(v**2 + 2 * FORCE_M_S2 * 4.0)) / FORCE_M_S2
        return peak / FORCE_M_S2 + (peak - v) / FORCE_M_S2 + back

    slowest = 0.5  # m/s, forward speed of a passage
    expected = min(time_s(v) for v in np.linspace(slowest, 8.0, 20_000))
    assert flown.durations_s.sum() == pytest.approx(expected, rel=5e-3)


def test_the_hull_keeps_away_from_the_frame_while_it_crosses_its_depth():
    """The way leads far to the side: the mass passes at the edge, on a slant that takes room in the frame's depth."""
    one = track(Gate((10.0, 0.0, 2.0), 0.0), Gate((12.0, 12.0, 2.0), 90.0))
    course = Course("corner", one, (0, 1), sprint(10.0).begin, REACH_M)
    flown = solve(pushed_mass(), course, from_rest(course), lambda iteration, time_s: None)
    passage = flown.states[2 * flown.intervals[0]]
    slope = passage[V][1] / passage[V][0]
    room_m = 0.75 - passage[P][1] - REACH_M * np.hypot(1.0, slope) - abs(slope) * 0.05
    assert passage[P][0] == pytest.approx(10.0, abs=1e-6)
    assert slope > 0.2 and room_m == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize("post_m", [(-0.2, 0.1), (-0.1, 0.2)])
def test_a_frame_beside_the_way_is_passed_on_a_free_side(post_m):
    """A post of another gate stands in the straight way: its opening is on the left, the open hall on the right.

    As the force has a bound along each axis alone, going round takes no time.
    """
    course, model = sprint(16.0), pushed_mass()
    beside = Gate((8.0, post_m[1] + 0.75, 2.0), 0.0)
    course = dataclasses.replace(course, track=track(*course.track.gates, beside))
    straight = solve(model, course, from_rest(course), lambda iteration, time_s: None)
    assert [found.gate for found in touches(course, straight.segments, straight.states[:, P])] == [1]
    flown, _ = clear_of_frames(model, course, straight, (), lambda iteration, time_s: None)
    y_at_post = flown.states[np.abs(flown.states[:, 0] - 8.0) < REACH_M, 1]
    right, left = post_m[0] - REACH_M, post_m[1] + REACH_M
    assert len(y_at_post) and (np.max(y_at_post) < right + 3e-3 or np.min(y_at_post) > left - 3e-3)
    assert flown.durations_s.sum() == pytest.approx(2.0, abs=2e-3)


def test_a_gate_without_room_is_no_line():
    course = dataclasses.replace(sprint(16.0), reach_m=0.8)
    with pytest.raises(NoLine, match="after"):
        solve(pushed_mass(), course, from_rest(course), lambda iteration, time_s: None)


def test_an_interruption_ends_the_solver():
    """Ctrl-C arrives as an exception in the report of progress."""

    def interrupt(iteration, time_s):
        if iteration == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(pushed_mass(), sprint(16.0), from_rest(sprint(16.0)), interrupt)
