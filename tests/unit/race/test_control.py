"""The course of a race: who may arm and start, what ends it, and that lockstep decides by stamps only."""

from dataclasses import replace

import numpy as np
import pytest

from swift_ros.race.control import LinkStatus, RaceControl, RaceSettings, Refused
from swift_ros.race.judge import Judge, ScheduledState
from swift_ros.track import Gate, Track
from swift_ros.types import Odometry

TRACK = Track("one", (Gate((5.0, 0.0, 2.0), 0.0),), 1.5, 2.1, 0.1, (0.0, 0.0, 2.0), 0.0, 1, (-20, -20, 0), (20, 20, 9))
TICK_NS = 10_000_000


def control(ahead=True, *, auto_arm_s=0.0, auto_start_s=0.0, time_limit_s=60.0):
    settings = RaceSettings(auto_arm_s, auto_start_s, 0.2, 5.0, time_limit_s, stall_s=5.0, nodes=())
    return RaceControl(Judge(TRACK, 0.18, 0.1), settings, ahead=ahead)


def pose(tick, x=0.0):
    still = np.zeros(3)
    return Odometry(tick * TICK_NS, np.array([x, 0.0, 2.0]), np.array([0, 0, 0, 1.0]), still, still)


def test_arming_is_refused_with_the_reason():
    race = control()
    with pytest.raises(Refused, match="betaflight/link is silent"):
        race.arm(0)
    race.update_link(LinkStatus(0, arming_blocks=("BOOT_GRACE_TIME", "THROTTLE")))
    with pytest.raises(Refused, match="BOOT_GRACE_TIME, THROTTLE"):
        race.arm(0)
    race.update_link(LinkStatus(0, armed=True, failsafe=True, reason="the policy is silent"))
    with pytest.raises(Refused, match="failsafe is ending a flight .the policy is silent."):
        race.arm(0)
    with pytest.raises(Refused, match="silent"):
        race.update_link(LinkStatus(0))
        race.arm(10**9)


def test_start_is_refused_until_the_flight_controller_is_armed():
    race = control(ahead=False)
    race.update_link(LinkStatus(0))
    with pytest.raises(Refused, match="idle, not armed"):
        race.start(0)
    assert race.arm(0)[0].state == "armed"
    with pytest.raises(Refused, match="has not armed yet"):
        race.start(0)
    race.update_link(LinkStatus(TICK_NS, armed=True))
    (event,) = race.start(TICK_NS)
    assert (event.state, event.stamp_ns) == ("racing", TICK_NS)
    with pytest.raises(Refused, match="racing already"):
        race.arm(TICK_NS)


@pytest.mark.parametrize("link_comes_first", [False, True])
def test_in_lockstep_arming_and_start_hold_from_the_same_stamps_however_messages_are_interleaved(link_comes_first):
    race, scheduled, events = control(auto_arm_s=1.0, auto_start_s=1.0), ScheduledState(), []
    for tick in range(400):
        link = LinkStatus(tick * TICK_NS, scheduled.at(tick * TICK_NS) in ("armed", "racing"))
        calls = [lambda tick=tick: race.update_pose(pose(tick)), lambda link=link: race.update_link(link)]
        for call in reversed(calls) if link_comes_first else calls:
            for event in call():
                scheduled.schedule(event.stamp_ns, event.state)
                events.append((event.state, event.stamp_ns))
                assert event.stamp_ns == (tick * TICK_NS) + 200_000_000
    assert events == [("armed", 1_200_000_000), ("racing", 2_700_000_000)]


def test_a_tick_is_judged_when_both_its_pose_and_its_link_status_have_arrived():
    race = control()
    race.update_pose(pose(3))
    assert race.judged_ns is None
    race.update_link(LinkStatus(2 * TICK_NS))
    assert race.judged_ns == 2 * TICK_NS
    live = control(ahead=False)
    live.update_pose(pose(3))
    assert live.judged_ns == 3 * TICK_NS


def test_a_flight_controller_that_never_arms_stops_the_race_with_its_reason():
    race = control(auto_arm_s=1.0, auto_start_s=1.0)
    blocked = [race.update_link(LinkStatus(t * TICK_NS, arming_blocks=("ANGLE",))) for t in range(700)]
    (event,) = [event for events in blocked for event in events]
    assert event.state == "stopped" and "ANGLE" in event.text
    silent = control(auto_arm_s=1.0)
    events = [event for t in range(700) for event in silent.update_link(LinkStatus(t * TICK_NS))]
    assert [event.state for event in events] == ["armed", "stopped"]
    assert "did not arm" in events[1].text


def test_the_reason_that_was_known_is_named_also_when_the_last_message_has_none():
    race = control(ahead=False)
    race.update_link(LinkStatus(0))
    race.arm(0)
    links = [LinkStatus(t * TICK_NS, arming_blocks=("ANGLE_MODE",) if t < 100 else ()) for t in range(700)]
    (event,) = [event for link in links for event in race.update_link(link)]
    assert event.text == "the flight controller did not arm: ANGLE_MODE"
    reported = control(ahead=False)
    reported.update_link(LinkStatus(0))
    reported.arm(0)
    (event,) = [e for t in range(700) for e in reported.update_link(LinkStatus(t * TICK_NS, reason="the cable is out"))]
    assert event.text == "the flight controller did not arm: the cable is out"
    lost = racing().update_link(LinkStatus(TICK_NS, reason="the pilot took the sticks"))
    assert lost[0].text == "the flight controller disarmed: the pilot took the sticks"


def test_after_a_failsafe_that_has_disarmed_the_race_can_be_armed_again():
    race = racing()
    race.update_link(LinkStatus(TICK_NS, armed=True, failsafe=True))
    race.abort(TICK_NS, "the policy is silent")
    race.update_link(LinkStatus(2 * TICK_NS, failsafe=True))
    assert race.arm(2 * TICK_NS)[0].state == "armed"


def racing(**settings):
    race = control(ahead=False, **settings)
    race.update_link(LinkStatus(0))
    race.arm(0)
    race.update_link(LinkStatus(0, armed=True))
    race.start(0)
    return race


def test_stop_disarming_time_limit_and_crash_end_a_race():
    stopped = racing()
    assert stopped.stop(1)[0].state == "stopped"
    assert stopped.stop(2)[0].state == "idle"  # the second request stops the motors
    assert racing().abort(1, "policy fell silent")[0].text == "policy fell silent"
    assert racing().update_link(LinkStatus(TICK_NS, armed=False))[0].text == "the flight controller disarmed"
    late = racing(time_limit_s=1.0)
    assert [event.text for t in range(200) for event in late.update_pose(pose(t))] == ["no finish within 1 s"]
    crash = racing()
    events = [event for t, x in enumerate(np.arange(0, 30, 0.2)) for event in crash.update_pose(pose(t, x))]
    assert [(event.state, event.lap) for event in events] == [("racing", 0), ("crashed", 0)]
    assert crash.state == "crashed"
    crash.update_link(LinkStatus(TICK_NS, armed=False))
    with pytest.raises(Refused, match="nothing to stop"):
        crash.stop(1)
    assert crash.abort(1, "late") == []


def finished(**link) -> RaceControl:
    """A race after its finish, whose pilot flies on where `link` does not say otherwise."""
    race = racing()
    race.state = "finished"
    race.update_link(LinkStatus(TICK_NS, **({"armed": True} | link)))
    return race


def test_while_the_pilot_flies_on_the_first_stop_brakes_and_the_second_one_stops_the_motors():
    flies_on = finished()
    assert [event.state for event in flies_on.stop(1) + flies_on.stop(2)] == ["stopped", "idle"]
    assert [event.state for event in finished(angle=True).stop(1)] == ["idle"]  # it brakes already
    with pytest.raises(Refused, match="nothing to stop"):
        finished(armed=False).stop(1)


def test_while_the_pilot_flies_on_a_touch_a_lost_node_and_the_flight_volume_end_the_flight():
    beside_opening = replace(pose(2), p_world=np.array([5.0, 0.8, 2.0]))
    (touch,) = finished().update_pose(beside_opening)
    assert (touch.state, touch.text) == ("crashed", "touched gate 1 after the finish")
    (away,) = finished().update_pose(pose(2, 25.0))
    assert (away.state, away.text) == ("crashed", "left the flight volume after the finish")
    assert finished().abort(1, "policy fell silent")[0].state == "lost"
    for landing in ({"angle": True}, {"armed": False}, {"failsafe": True}):
        race = finished(**landing)
        assert race.update_pose(pose(2, 25.0)) == [] and race.abort(1, "late") == []


def test_a_race_is_armed_by_itself_once():
    race = control(auto_arm_s=1.0)
    events = [event for t in range(300) for event in race.update_link(LinkStatus(t * TICK_NS, armed=t > 120))]
    assert [event.state for event in events] == ["armed"]
    race.stop(300 * TICK_NS)
    race.stop(301 * TICK_NS)
    assert race.state == "idle"
    assert [event for t in range(302, 900) for event in race.update_link(LinkStatus(t * TICK_NS))] == []


def test_after_an_end_a_new_race_may_be_armed_and_started():
    race = racing()
    race.stop(5)
    race.update_link(LinkStatus(10))
    race.arm(10)
    race.update_link(LinkStatus(10, armed=True))
    assert race.start(10)[0].next_gate == 0
    events = [event for t in range(1, 60) for event in race.update_pose(pose(t, 0.1 * t))]
    assert [event.state for event in events] == ["racing"]
