"""The failsafe of the link: every fault ends the flight within its time."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from link_story import TICK_NS, UPRIGHT, Story, is_angle, is_armed

from swift_ros import geometry
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.failsafe import DeadReckoning, Descent, DescentLimits, Motion, Stage, motion_of
from swift_ros.betaflight.link import Phase
from swift_ros.betaflight.watchdog import ClockReading, InputWatchdog
from swift_ros.vehicle import GRAVITY

TIPPED = np.array([math.sin(math.radians(40)), 0.0, 0.0, math.cos(math.radians(40))])  # 80 degrees


def fly(**changes) -> Story:
    story = Story(**changes).race()
    story.v_body = np.array([1.0, 0.0, 0.0])  # slow: nothing to brake
    return story.play(0.2).mark()


@pytest.mark.parametrize("source", ["command", "state", "judge"])
def test_a_silent_source_ends_the_flight_in_time(source):
    story = fly()
    story.alive.discard(source)
    story.play(5.0)
    limit = 0.21 if source == "judge" else 0.06
    assert story.first(is_angle) <= limit + 0.011
    assert story.first(lambda c: not is_armed(c)) <= 4.5
    assert story.link.failsafe and story.link.phase is Phase.OVER and not story.link.armed
    assert any(f"failsafe: {source}" in text.replace("race/judged", "judge") for _, text in story.link.events)


@pytest.mark.parametrize("corrupt", ["thrust", "rate", "position", "quaternion"])
def test_a_message_with_nan_is_ignored(corrupt):
    story = fly()
    nan = np.full(3, np.nan)
    if corrupt == "thrust":
        story.thrust = math.nan
    elif corrupt == "rate":
        story.omega = nan
    elif corrupt == "position":
        story.v_body = nan
    else:
        story.q = np.zeros(4)
    before = story.firmware.frames[-1]
    story.play(0.03)
    assert story.firmware.frames[-1] == before  # the sticks stay, and there is still one frame for each command
    assert len(story.history) == 3
    story.play(0.1)
    assert story.first(is_angle) <= 0.08


def test_commands_with_old_stamps_are_ignored():
    story = fly()
    story.delay_ns = 100_000_000
    assert story.play(0.5).link.phase is Phase.RACING
    story.delay_ns = 300_000_000
    assert story.play(0.2).link.failsafe and any("0.30 s old" in text for _, text in story.link.events)


def test_the_timeline_of_a_descent():
    """Command lost at 80 degrees of tilt: closed throttle until 60, then less than hover thrust until it stands."""
    story = fly()
    hovering = story.play(0.02).history[-1][1][3]
    story.q = TIPPED
    story.play(0.02).mark().alive.discard("command")
    story.play(0.3)
    closed = [c[3] for t, c in story.history if t > story.first(is_angle) - 1e-9]
    assert set(closed) == {1050} and all(c[:3] == [1500] * 3 for t, c in story.history if is_angle(c))
    story.q = UPRIGHT
    story.mark().play(1.7)
    throttles = [c[3] for _, c in story.history if is_armed(c)]
    assert min(throttles) > 1150 and max(throttles) < hovering
    assert story.first(lambda c: not is_armed(c)) == pytest.approx(1.2, abs=0.06)
    assert story.history[-1][1][3] == 1000


def test_the_vehicle_sinks_until_it_stands_however_long_that_takes():
    story = fly()
    story.mark().alive.discard("command")
    story.play(0.5)
    story.v_body = np.array([0.0, 0.0, -1.0])
    sinking = story.play(4.0).history[-1][1][3]
    assert story.link.armed
    story.v_body = np.array([0.0, 0.0, -1.6])
    assert story.play(0.1).history[-1][1][3] > sinking
    story.v_body = np.zeros(3)
    story.mark().play(0.4)
    assert story.first(lambda c: not is_armed(c)) == pytest.approx(0.2, abs=0.06)


def test_a_vehicle_that_does_not_sink_is_let_down_in_the_end():
    descent = Descent(DescentLimits(1.0, 4.0), motion_of(UPRIGHT, np.zeros(3)), 0.0, planned=True)
    up = motion_of(UPRIGHT, np.array([0.0, 0.0, -0.5]))
    thrusts = [descent.sticks(up, 0.01 * k).thrust for k in range(1500)]
    assert descent.stage is Stage.OVER
    assert thrusts.index(None) == pytest.approx(1400, abs=5)  # 10 s by the state, then 4 s with less and less thrust
    assert thrusts[1390] < 0.1 * GRAVITY < thrusts[1200]


@pytest.mark.parametrize(
    ("height", "up_m_s", "after_s", "lasts_s"),
    [
        (0.0, -0.9, 2.0, 0.2),
        (0.1, 0.0, 1.1, 0.3),  # it stands
        (2.0, -0.9, 2.0, 2.2),
        (2.0, -0.9, 0.5, 4.0),  # not settled yet
        (2.0, 0.0, 1.1, 4.0),  # it does not sink
        (20.0, -0.9, 2.0, 4.0),
        (None, -0.9, 2.0, 4.0),
    ],
)
def test_a_vehicle_that_loses_its_state_as_it_sinks_stops_when_it_must_be_on_the_ground(
    height, up_m_s, after_s, lasts_s
):
    descent = Descent(DescentLimits(1.0, 4.0), motion_of(UPRIGHT, np.zeros(3)), 0.0, planned=True)
    sinking = replace(motion_of(UPRIGHT, np.array([0.0, 0.0, up_m_s])), height=height)
    for k in range(round(100 * after_s)):
        assert descent.sticks(sinking, 0.01 * k).armed
    blind = Motion(tilt=0.1)
    stopped_s = next(0.01 * k for k in range(1000) if not descent.sticks(blind, after_s + 0.01 * k).armed)
    assert stopped_s == pytest.approx(lasts_s, abs=0.02)


@pytest.mark.parametrize("source", ["command", "judge"])
def test_at_racing_speed_with_a_good_state_the_vehicle_brakes_before_it_descends(source):
    story = fly()
    story.v_body = np.array([14.0, 5.0, 0.0])  # forward and to the left
    story.play(0.05).mark().alive.discard(source)
    story.play(1.0)
    roll, pitch, _, throttle = story.history[-1][1][:4]
    assert is_angle(story.history[-1][1]) and is_armed(story.history[-1][1]) and story.link.failsafe
    assert roll > 1500 and pitch < 1500 and throttle > 1200  # leans right and back, holds the height
    story.v_body = np.zeros(3)
    story.mark().play(2.0)
    assert story.first(lambda c: not is_armed(c)) == pytest.approx(1.2, abs=0.06)


def test_at_racing_speed_without_the_state_the_vehicle_brakes_by_the_attitude_of_the_flight_controller():
    story = fly()
    story.v_body = np.array([14.0, 0.0, 0.0])
    story.play(0.05).mark().alive.discard("state")
    story.play(0.1)
    assert is_armed(story.history[-1][1]) and story.history[-1][1][1] < 1450  # leans back
    story.firmware.attitude = wire.Attitude(0.0, -math.radians(40), 0.0)  # it follows
    story.play(7.0)
    level = story.first(lambda c: is_angle(c) and abs(c[1] - 1500) < 5)
    stopped = story.first(lambda c: not is_armed(c))
    assert 1.0 < level < 2.5 and stopped == pytest.approx(level + 4.0, abs=0.1)


def test_dead_reckoning_follows_a_vehicle_that_brakes_while_it_turns():
    """The plant has another drag than the reckoning; the velocity is off by less than that of braking's end."""
    v_world, yaw, dt = np.array([12.0, 5.0, 1.0]), 0.3, 0.01
    turn = np.array([[math.cos(yaw), math.sin(yaw), 0.0], [-math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    reckoning = DeadReckoning(turn @ v_world, -yaw, 0.0)
    for i in range(1, 251):
        yaw += 0.5 * dt
        roll, pitch, thrust = 0.3 * math.sin(0.02 * i), -0.6, 12.0
        up = geometry.rotate(geometry.quaternion_from_yaw(np.asarray(yaw)), np.array([0.0, 0.0, 1.0]))
        body = np.array([math.sin(pitch) * math.cos(roll), -math.sin(roll), math.cos(pitch) * math.cos(roll)])
        force = geometry.rotate(geometry.quaternion_from_yaw(np.asarray(yaw)), thrust * body)
        v_world = v_world + dt * (force - GRAVITY * up - 0.4 * v_world)
        found = reckoning.advance(wire.Attitude(roll, pitch, -yaw), thrust, i * dt)
    true = geometry.rotate_inverse(geometry.quaternion_from_yaw(np.asarray(yaw)), v_world)
    assert np.linalg.norm(true - found) < 1.5
    assert reckoning.advance(wire.Attitude(0.0, 0.0, -yaw), 9.8, 10.0) is None  # too old


def test_without_any_attitude_the_motors_stop_at_once():
    story = fly()
    story.firmware.mute = True
    story.play(0.6).mark().alive.discard("state")
    story.play(0.2)
    assert story.first(lambda c: not is_armed(c)) <= 0.07


def test_without_the_state_the_attitude_of_the_flight_controller_is_used():
    story = fly()
    story.firmware.attitude = wire.Attitude(math.radians(75), 0.0, 0.0)
    story.play(0.2).mark().alive.discard("state")
    story.play(0.4)
    assert {c[3] for t, c in story.history if is_angle(c)} == {1050}
    story.firmware.attitude = wire.Attitude(0.1, 0.0, 0.0)
    story.mark().play(0.1)
    assert story.history[-1][1][3] > 1200


def test_a_vehicle_that_does_not_level_out_is_stopped():
    story = fly()
    story.q = TIPPED
    story.play(0.02).mark().alive.discard("command")
    story.play(1.5)
    assert story.first(lambda c: not is_armed(c)) == pytest.approx(1.05, abs=0.1)


def test_a_clock_that_stops_or_jumps_is_a_fault_and_not_a_pause():
    story = fly()
    story.alive -= {"clock", "command"}
    story.play(5.0)
    assert story.first(is_angle) <= 0.07 and story.link.phase is Phase.OVER
    for jump_s in (-0.5, 0.5, 3600.0):
        story = fly()
        story.ros_ns += round(jump_s * 1e9)
        story.play(0.1)
        assert story.first(is_angle) <= 0.02
        assert any("the clock jumped" in text for _, text in story.link.events)


def test_in_lockstep_a_slow_machine_is_no_fault_but_a_stopped_simulator_is():
    story = Story(lockstep=True).race()
    story.steady_s += 7.0
    assert story.play(0.2).link.phase is Phase.RACING
    story.mark().alive -= {"clock", "command", "state", "judge"}
    story.play(14.0)
    assert story.first(is_angle) == pytest.approx(8.0, abs=0.1) and story.link.phase is Phase.OVER


def test_in_lockstep_a_source_that_is_silent_in_simulated_time_ends_the_flight():
    story = Story(lockstep=True).race()
    story.mark().alive -= {"command", "state"}
    story.play(5.0)
    assert story.first(is_angle) <= 0.1 and story.first(lambda c: not is_armed(c)) <= 4.5


@pytest.mark.parametrize("race_state", ["missed", "stopped"])
def test_an_end_of_a_race_whose_vehicle_flies_well_is_a_controlled_descent(race_state):
    story = fly()
    story.v_body = np.array([14.0, 0.0, 0.0])
    story.play(0.05).announce(race_state).mark().play(0.3)
    assert story.link.phase is Phase.ENDING and story.history[-1][1][1] < 1500 and story.link.armed
    story.v_body = np.zeros(3)
    story.play(1.7)
    assert story.link.phase is Phase.OVER and not story.link.failsafe and not story.link.armed


def test_a_crash_or_a_second_stop_stops_the_motors_at_once():
    story = fly().announce("crashed").play(0.15)
    assert story.link.phase is Phase.OVER and not story.link.failsafe and not story.link.armed
    story = fly().announce("stopped").play(0.15)
    assert story.link.armed
    assert not story.announce("idle").play(0.15).link.armed


def test_a_lost_node_is_a_fault_and_the_race_can_be_armed_again():
    story = fly().announce("lost").play(0.05)
    assert story.link.phase is Phase.ENDING and story.link.failsafe
    story.play(2.0).announce("armed").play(0.5)
    assert story.link.phase is Phase.PODIUM and not story.link.failsafe


def test_a_state_lost_while_braking_is_named_and_the_braking_goes_on():
    story = fly()
    story.v_body = np.array([14.0, 0.0, 0.0])
    story.play(0.05).announce("finished").play(0.3)
    assert story.link.phase is Phase.ENDING
    story.alive.discard("state")
    story.mark().play(0.5)
    assert story.link.failsafe and story.link.phase is Phase.ENDING and story.history[-1][1][1] < 1450
    assert sum("state/odometry is silent" in text for _, text in story.link.events) == 1
    assert story.play(9.0).link.phase is Phase.OVER


def test_on_the_podium_a_fault_only_disarms():
    story = Story().play(0.5).announce("armed").play(0.5)
    story.alive.discard("state")
    assert story.play(0.1).link.phase is Phase.OVER
    assert any("on the podium state/odometry is silent" in text for _, text in story.link.events)


def test_in_manual_flight_only_the_command_is_needed_and_its_silence_stops_the_motors():
    story = Story(state_required=False)
    story.alive = {"command", "clock"}
    story.race().mark().alive.discard("command")
    assert story.play(0.2).link.phase is Phase.OVER


@pytest.mark.parametrize(("age_s", "flies"), [(0.05, True), (10.0, False), (None, True)])
def test_in_manual_flight_a_command_with_an_old_stamp_is_ignored_and_one_without_a_stamp_is_used(age_s, flies):
    story = Story(state_required=False)
    story.alive = {"command", "clock"}
    story.race()
    for _ in range(50):
        story.delay_ns = story.ros_ns + TICK_NS if age_s is None else round(1e9 * age_s)
        story.play(0.01)
    assert (story.link.phase is Phase.RACING) == flies
    assert any("10.00 s old" in text for _, text in story.link.events) != flies


def test_on_the_ground_frames_are_sent_without_commands_so_that_the_firmware_keeps_its_signal():
    story = Story()
    story.alive.discard("command")
    story.play(1.0)
    gaps = np.diff([t for t, _ in story.history])
    assert 20 < len(story.history) < 60 and gaps.max() < 0.1


def test_after_a_pause_of_the_watchdog_queued_messages_are_read_first():
    watchdog = InputWatchdog({"state": 0.05})
    watchdog.update(ClockReading(0, 0.0))
    assert watchdog.update(ClockReading(70_000_000, 0.07))
    assert not watchdog.update(ClockReading(80_000_000, 0.08))
    assert watchdog.fault(ClockReading(80_000_000, 0.08), ("state",)) == "state was never received"


def test_a_descent_ends_in_bounded_time_for_any_motion():
    limits = DescentLimits(math.radians(60), 1.5)
    for tilt, speed in itertools.product((0.0, 1.5, 3.1, None), (0.0, 2.0, 20.0, None)):
        motion = Motion(tilt, None if speed is None else np.array([speed, 0.0, 0.0]))
        descent = Descent(limits, motion, 0.0)
        stages = [descent.sticks(motion, 0.01 * i) for i in range(800)]
        assert not stages[-1].armed and descent.stage is Stage.OVER
        assert all(s.thrust is None or 0 <= s.thrust <= 2 * GRAVITY for s in stages)
        assert stages[0].armed == (tilt is not None and speed is not None)
