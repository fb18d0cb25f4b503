"""The judge: each flight has planted passages, touches or misses, which the judge finds."""

import math
from pathlib import Path

import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.race import judge as race
from swift_ros.race.judge import Judge, ScheduledState
from swift_ros.track import Gate, Track
from swift_ros.types import Odometry

CONFIG = Path(__file__).parents[3] / "config"
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def two_gates() -> Track:
    """Two gates in a row along +x, the second one metre higher; two laps by flying round and round."""
    return Track(
        name="two",
        gates=(Gate((0.0, 0.0, 2.0), 0.0), Gate((10.0, 0.0, 3.0), 0.0)),
        inner_side=1.5,
        outer_side=2.1,
        depth=0.1,
        start=(-5.0, 0.0, 2.0),
        start_yaw_deg=0.0,
        laps=2,
        bounds_min=(-50.0, -50.0, 0.0),
        bounds_max=(50.0, 50.0, 20.0),
    )


def poses(waypoints, speed=10.0, rate_hz=100.0, q=LEVEL, start_ns=0):
    """Yield poses along straight lines through `waypoints` at constant speed."""
    time = 0.0
    ends = np.asarray(waypoints, dtype=float)
    for a, b in zip(ends[:-1], ends[1:], strict=True):
        length = np.linalg.norm(b - a)
        count = max(1, round(length / speed * rate_hz))
        v_world = (b - a) / length * speed
        for i in range(count):
            stamp = start_ns + round(1e9 * time)
            yield Odometry(stamp, a + (b - a) * i / count, q, geometry.rotate_inverse(q, v_world), np.zeros(3))
            time += length / count / speed


def judge(waypoints, track=None, **how):
    """Return the events of a flight through `waypoints`, which starts with the start signal."""
    contact = how.pop("contact", True)
    race_judge = Judge(track or two_gates(), hull_radius=0.18, hull_height=0.1, contact=contact)
    race_judge.start(0)
    return [event for pose in poses(waypoints, **how) for event in race_judge.update(pose)]


def test_a_clean_race_has_every_passage_with_time_split_and_margin():
    straight = [(-5, 0.2, 2.1), (5, 0.2, 2.1), (5, 0.2, 3.0), (12, 0.2, 3.0), (12, 10, 5), (-5, 10, 5)]
    events = judge([*straight, *straight, *straight[:2]])
    texts = ["gate 1", "gate 2", "gate 1, lap 1 done", "gate 2", "gate 1, lap 2 done"]
    assert [event.text for event in events] == texts
    assert [event.state for event in events] == ["racing"] * 4 + ["finished"]
    assert events[0].stamp_ns == pytest.approx(0.5e9, abs=1e5)  # 5 m at 10 m/s, found between two poses
    assert [event.lap for event in events] == [0, 0, 1, 1, 2]
    assert events[0].margin_m == pytest.approx(0.75 - 0.2 - 0.18, abs=2e-3)
    length = sum(math.dist(a, b) for a, b in zip(straight, [*straight[1:], straight[0]], strict=True))
    assert events[1].split_s + events[2].split_s == pytest.approx(length / 10, rel=1e-3)


@pytest.mark.parametrize("gap_s", [0.01, 0.1, 0.2, 0.4])
def test_a_vehicle_that_turns_round_between_two_poses_has_touched_what_lies_in_between(gap_s):
    """It decelerates with 40 m/s^2 towards the frame and comes back; poses in between were lost."""
    nearest = np.array([-0.15, 0.9, 2.0])  # 0.1 m in front of the frame of gate 1, whose hull has a radius of 0.18 m
    start, speed = nearest - [0.5 * 40 * (0.5 * gap_s) ** 2, 0.0, 0.0], 40 * 0.5 * gap_s
    race_judge = Judge(two_gates(), hull_radius=0.18, hull_height=0.1, contact=True)
    race_judge.start(0)
    there = Odometry(0, start, LEVEL, np.array([speed, 0.0, 0.0]), np.zeros(3))
    back = Odometry(round(1e9 * gap_s), start, LEVEL, np.array([-speed, 0.0, 0.0]), np.zeros(3))
    assert race_judge.update(there) == []
    assert [event.text for event in race_judge.update(back)] == ["touched gate 1"]


@pytest.mark.parametrize(("above_m", "text"), [(0.02, "gate 1, lap 1 done"), (-0.02, "touched the podium")])
def test_in_flight_the_podium_is_an_obstacle_and_at_the_start_it_is_not(above_m, text):
    """The podium's top is at 1.95 m: the start leaves it, and the lap leads over it or into it."""
    low = 2.0 + above_m
    lap = [(-5, 0, 2.0), (5, 0, 2.0), (5, 0, 3.0), (12, 0, 3.0), (12, 5, 5), (-9, 5, 5), (-9, 0, low), (2, 0, low)]
    assert judge(lap)[2].text == text


def test_a_tilted_hull_is_taller_and_its_margin_smaller():
    roll = geometry.quaternion_from_rotation_vector(np.array([math.radians(90), 0, 0]))
    (flat,) = judge([(-2, 0, 2.3), (2, 0, 2.3)])
    (upright,) = judge([(-2, 0, 2.3), (2, 0, 2.3)], q=roll)
    assert flat.margin_m == pytest.approx(0.75 - 0.3 - 0.05, abs=2e-3)
    assert upright.margin_m == pytest.approx(0.75 - 0.3 - 0.18, abs=3e-3)


@pytest.mark.parametrize(
    ("height", "text"),
    [(2.71, "touched gate 1"), (2.9, "touched gate 1"), (1.28, "touched gate 1"), (3.09, "touched gate 1")],
)
def test_touching_the_frame_is_a_crash(height, text):
    events = judge([(-2, 0, height), (2, 0, height)])
    assert [(event.state, event.text) for event in events] == [("crashed", text)]
    assert 0.18 < 1e-9 * events[0].stamp_ns * 10 < 2.3


def test_touching_a_later_gate_from_behind_is_a_crash():
    assert judge([(12, 0.8, 3), (8, 0.8, 3)])[0].text == "touched gate 2"


def test_a_gate_flown_backwards_or_out_of_order_is_no_passage():
    assert judge([(12, 0, 3), (8, 0, 3), (8, 0, 2.0), (2, 0, 2.0), (-2, 0, 2.0)]) == []


def test_a_hull_that_touches_the_frame_after_the_crossing_has_not_passed():
    dip = [(-2, 0, 2), (0.02, 0, 2.0), (0.03, 0, 3.0)]
    (event,) = judge(dip)
    assert (event.state, event.next_gate) == ("crashed", 0)


def test_touching_the_ground_or_leaving_the_volume_ends_the_race():
    assert judge([(-5, 0, 2), (-5, 0, -1)])[0].text == "touched the ground"
    assert judge([(-5, 0, 2), (-60, 0, 2)])[0].text == "left the flight volume"


def test_a_missed_gate_may_be_passed_within_the_grace_time():
    beside = [(-5, 3, 2), (5, 3, 2), (5, 6, 2), (-5, 6, 2), (-5, 0, 2), (5, 0, 2)]
    returned = judge(beside)
    assert [event.text for event in returned] == ["gate 1"]
    missed = judge([*beside[:2], (45, 3, 2)], speed=8.0)
    assert [(event.state, event.next_gate) for event in missed] == [("missed", 0)]
    assert missed[0].stamp_ns == pytest.approx(1e9 * (5 / 8 + race.MISS_GRACE_S), abs=2e7)


def test_a_crossing_far_beside_the_gate_is_no_miss():
    assert judge([(-5, 9, 2), (40, 9, 2)], speed=5.0) == []


def test_without_ground_truth_touches_are_not_judged():
    events = judge([(-2, 0, 2.7), (2, 0, 2.7), (2, 0, 0.5), (4, 0, 0.02)], contact=False)
    assert [event.text for event in events] == ["gate 1"]
    assert math.isnan(events[0].margin_m)


def test_a_jump_or_a_gap_of_the_odometry_passes_no_gate_and_nan_is_ignored():
    race_judge = Judge(two_gates(), 0.18, 0.1)
    race_judge.start(0)
    ends = ((0, -2.0), (10**7, 2.0))
    before, after = (Odometry(t, np.array([x, 0, 2]), LEVEL, np.zeros(3), np.zeros(3)) for t, x in ends)
    late = Odometry(10**9 + 10**7, after.p_world - [4, 0, 0], LEVEL, np.zeros(3), np.zeros(3))
    broken = Odometry(2 * 10**7, np.full(3, np.nan), LEVEL, np.zeros(3), np.zeros(3))
    assert [race_judge.update(pose) for pose in (before, after, broken, late)] == [[], [], [], []]


def test_nothing_is_judged_before_the_start_signal_or_after_the_end():
    race_judge = Judge(two_gates(), 0.18, 0.1)
    flight = list(poses([(-2, 0, 2), (2, 0, 2), (2, 0, -3)]))
    assert [event for pose in flight for event in race_judge.update(pose)] == []
    race_judge.start(flight[25].stamp_ns)  # after gate 1
    assert [event.state for pose in flight for event in race_judge.update(pose)] == ["crashed"]


def test_the_whole_split_s_race_is_22_passages():
    track = configuration.load(Track, CONFIG / "track.yaml")
    stops = [track.start_pose[0]]
    for gate in [*range(7)] * 3 + [0]:
        forward = track.rotations[gate][:, 0]
        stops += [track.positions[gate] - forward, track.positions[gate] + forward]
        if gate == 3:
            stops += [stops[-1] + [-2.0, 0, 0], stops[-1] + [-2.0, 0, -2.7]]
    events = judge(stops, track=track)
    assert len(events) == track.passages == 22
    assert events[-1].state == "finished" and events[-1].lap == 3
    assert all(event.margin_m > 0.3 for event in events)


def test_the_pose_rate_changes_stamp_and_margin_by_less_than_1_ms_and_4_mm():
    turn = [(-2, 0.1, 2.2), (2, 0.3, 2.0)]
    (slow,) = judge(turn, rate_hz=50, speed=20)
    (fast,) = judge(turn, rate_hz=500, speed=20)
    assert slow.stamp_ns == pytest.approx(fast.stamp_ns, abs=1e6)
    assert slow.margin_m == pytest.approx(fast.margin_m, abs=4e-3)


def test_a_scheduled_state_holds_from_its_stamp_and_a_new_one_cancels_later_ones():
    scheduled = ScheduledState()
    scheduled.schedule(200, "racing")
    assert [scheduled.at(t) for t in (0, 199, 200)] == ["idle", "idle", "racing"]
    scheduled.schedule(400, "finished")
    scheduled.schedule(300, "stopped")
    assert [scheduled.at(t) for t in (250, 300, 500)] == ["racing", "stopped", "stopped"]
