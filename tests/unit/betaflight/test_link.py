"""The link as stories: configuration read back and checked, armed, raced, and each reason not to arm."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from fake_firmware import ANGLE_AUX, ARM_AUX, BOOT_GRACE_FLAG, THROTTLE_FLAG, FakeFirmware
from link_story import VEHICLE, Story, is_angle, is_armed, settings

from swift_ros.betaflight import link, pack, read_back, sticks
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.link import Phase
from swift_ros.betaflight.msp_messages import Code
from swift_ros.errors import UsageError
from swift_ros.types import BodyRateThrust, Odometry


def test_a_race_from_connection_to_landing():
    story = Story().play(0.5)
    assert story.link.phase is Phase.IDLE and story.blocks == "" and not story.link.armed
    assert all(not is_armed(c) and is_angle(c) and c[3] == 1000 and c[:3] == [1500] * 3 for _, c in story.history)

    story.announce("armed").mark().play(0.3)
    assert story.link.phase is Phase.PODIUM and story.link.armed and "ARM" in story.link.modes
    assert all(c[3] == 1000 and is_angle(c) for _, c in story.history)

    story.thrust, story.omega = 20.0, np.array([3.0, -2.0, 1.0])
    story.announce("racing").mark().play(0.3)
    assert len(story.history) == 30 and story.link.phase is Phase.RACING
    channels = story.history[-1][1]
    assert is_armed(channels) and not is_angle(channels)
    flown = sticks.rates_from_sticks(np.array(channels[:3], dtype=float), story.link._curves)
    np.testing.assert_allclose(flown, story.omega, atol=0.01)
    voltage = pack.voltage_under(np.asarray(20.0), story.link._pack.source_voltage, VEHICLE)
    throttle = sticks.throttle_for_thrust(np.asarray(20.0), voltage, VEHICLE, 0.055)
    assert channels[3] == int(sticks.throttle_stick(throttle, 1050))

    story.announce("finished").mark().play(2.0)
    assert story.link.phase is Phase.OVER and not story.link.armed and not story.link.failsafe
    assert all(is_angle(c) for _, c in story.history)
    assert story.link.frames_sent == len(story.firmware.frames) and story.link.session.frames_bad == 0


def test_a_fast_finish_first_brakes_against_the_velocity():
    story = Story()
    story.v_body = np.array([14.0, 5.0, 0.0])  # forward and to the left
    story.race().announce("finished").mark().play(0.5)
    roll, pitch, yaw, throttle = story.history[-1][1][:4]
    assert is_angle(story.history[-1][1]) and is_armed(story.history[-1][1])
    assert roll > 1500 and pitch < 1500 and yaw == 1500 and throttle > 1200  # leans right and back, holds the height
    story.v_body = np.array([0.5, 0.0, 0.0])
    story.play(1.6)
    assert story.link.phase is Phase.OVER


class Space:
    """Stands for the space that braking takes."""

    clearance = 0.0

    def clearance_m(self, state):
        return self.clearance

    def height_m(self, state):
        return 5.0


def test_after_the_finish_the_pilot_flies_on_until_nothing_is_in_the_way_of_braking():
    space = Space()
    story = Story(space=space).race().announce("finished").mark().play(1.0)
    assert story.link.phase is Phase.RACING and not any(is_angle(c) for _, c in story.history)
    assert [text for _, text in story.link.events] == [f"finished; {link.IN_THE_WAY}, so the pilot flies on"]
    assert "FLIGHT: the last flight has not ended" in story.blocks
    space.clearance = 2.0
    story.mark().play(0.1)
    assert story.link.phase is Phase.ENDING and story.first(is_angle) <= 0.011
    assert "FLIGHT: the last flight has not ended" in story.blocks
    assert story.play(3.0).link.phase is Phase.OVER and not story.link.failsafe and story.blocks == ""
    # the next race begins anew
    story.announce("idle").play(0.5).race()
    assert story.play(0.5).link.phase is Phase.RACING


def test_with_time_a_narrower_way_is_accepted():
    space = Space()
    space.clearance = sum(link.SPACE_M) / 2
    story = Story(space=space).race().announce("finished").mark().play(link.FLY_ON_S)
    assert story.first(is_angle) == pytest.approx(link.FLY_ON_S / 2, abs=0.03)
    assert not any(level == "warn" for level, _ in story.link.events)


def test_a_way_that_is_never_free_does_not_keep_the_vehicle_in_the_air():
    story = Story(space=Space()).race().announce("finished").mark().play(link.FLY_ON_S + 0.1)
    assert story.link.phase is Phase.ENDING
    assert story.first(is_angle) == pytest.approx(link.FLY_ON_S, abs=0.03)
    assert any(level == "warn" and "begins all the same" in text for level, text in story.link.events)


@pytest.mark.parametrize("end", ["missed", "stopped", "lost"])
def test_another_end_than_the_finish_does_not_wait(end):
    story = Story(space=Space()).race().announce(end).mark().play(0.1)
    assert story.link.phase is Phase.ENDING and story.first(is_angle) <= 0.011


def test_a_stop_while_the_pilot_flies_on_makes_the_vehicle_brake():
    story = Story(space=Space()).race().announce("finished").play(0.5).announce("stopped").mark().play(0.1)
    assert story.link.phase is Phase.ENDING and story.first(is_angle) <= 0.011 and is_armed(story.history[-1][1])


@pytest.mark.parametrize("source", ["command", "state", "judge"])
def test_a_fault_while_the_pilot_flies_on_ends_the_flight_as_in_a_race(source):
    story = Story(space=Space()).race().announce("finished").play(0.5).mark()
    story.alive.discard(source)
    story.play(0.5)
    assert story.link.failsafe and story.first(is_angle) <= (0.23 if source == "judge" else 0.08)


def test_a_frame_follows_the_channel_map_and_contains_every_channel():
    firmware = FakeFirmware()
    firmware.channel_map = bytes([1, 2, 0, 3, 4, 5, 6, 7])
    firmware.ranges.append(wire.ModeRange(28, 6, 900, 1300))  # a box that is on when its channel is low, on AUX7
    story = Story(firmware).race()
    assert len(firmware.frames[-1]) == 11 and firmware.frames[-1][10] == 1300
    assert firmware.aux(ARM_AUX) == 1900 and firmware.aux(ANGLE_AUX) == 1000
    assert firmware.frames[-1][3] > 1200  # the throttle is at its mapped position
    assert story.link.armed


def flag(firmware):
    firmware.flags = THROTTLE_FLAG | BOOT_GRACE_FLAG | 1 << 25


def no_angle(firmware):
    firmware.angle_answers = False


def empty_battery(firmware):
    firmware.battery = wire.BatteryState(4, 1.55, 1.4, 5.0, 0, 13.2)


def no_battery(firmware):
    firmware.battery = wire.BatteryState(0, 0.0, 0.0, 0.0, 0, 0.0)


def rescue(firmware):
    firmware.failsafe = replace(firmware.failsafe, procedure=2)


def slow_failsafe(firmware):
    firmware.failsafe = replace(firmware.failsafe, delay_s=2.5, procedure=0)


def radio_receiver(firmware):
    firmware.features = 0


def reversible(firmware):
    firmware.features |= wire.FEATURE_3D


def curved_throttle(firmware):
    firmware.rates = replace(firmware.rates, throttle_expo=30)


def modified_thrust(firmware):
    firmware.pid = replace(firmware.pid, sag_compensation=100, motor_output_limit_percent=80)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (flag, "THROTTLE; BOOT_GRACE_TIME"),
        (no_angle, "ANGLE_MODE"),
        (empty_battery, "BATTERY: 3.30 V a cell"),
        (no_battery, "BATTERY: the flight controller measures no battery"),
        (rescue, "FAILSAFE_SETUP: the firmware's own failsafe does not end"),
        (slow_failsafe, "FAILSAFE_SETUP: the firmware's own failsafe ends only after 3.5 s"),
        (radio_receiver, "RECEIVER"),
        (reversible, "FEATURE_3D"),
        (curved_throttle, "THROTTLE_CURVE"),
        (modified_thrust, "MOTOR_LIMIT: the motors are limited to 80 %; set motor_output_limit 100; THRUST_MAP"),
    ],
)
def test_each_reason_not_to_arm_is_reported(change, named):
    firmware = FakeFirmware()
    change(firmware)
    story = Story(firmware).play(0.3)
    assert named in story.blocks and "ARM_SWITCH" not in story.blocks
    story.announce("armed").play(1.0)
    assert story.link.phase is Phase.ARMING and not any(is_armed(c) for _, c in story.history)


def test_arming_waits_for_temporary_reasons():
    firmware = FakeFirmware()
    firmware.flags = BOOT_GRACE_FLAG
    story = Story(firmware).play(0.3).announce("armed").play(0.5)
    assert story.link.phase is Phase.ARMING
    firmware.flags = 0
    assert story.play(0.5).link.phase is Phase.PODIUM


def test_missing_inputs_and_a_tilted_podium_prevent_arming():
    for missing, named in (("command", "command/body_rate_thrust"), ("state", "state/odometry"), ("judge", "race/jud")):
        story = Story()
        story.alive.discard(missing)
        assert f"INPUT: {named}" in story.play(0.5).blocks
    story = Story()
    story.q = np.array([math.sin(math.radians(10)), 0, 0, math.cos(math.radians(10))])
    assert "LEVEL: tilted by 20 deg" in story.play(0.5).blocks


def test_a_flight_controller_that_does_not_answer_is_reported():
    firmware = FakeFirmware()
    firmware.mute = True
    assert "LINK" in Story(firmware).play(0.5).blocks


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"boxes": [0, 27, 50], "names": "ARM;FAILSAFE;MSP OVERRIDE;"}, "has no ANGLE box; enable its accelerometer"),
        ({"ranges": [wire.ModeRange(1, 1, 1700, 2100)]}, "no switch turns ARM on"),
        ({"ranges": [wire.ModeRange(0, 0, 1700, 2100), wire.ModeRange(1, 0, 1300, 1700)]}, "ARM and ANGLE share AUX1"),
        ({"variant": b"INAV"}, "runs INAV"),
        ({"api": wire.ApiVersion(0, 1, 40)}, "Betaflight 4.5 or newer"),
        ({"channel_map": bytes([0, 1, 1, 2, 4, 5, 6, 7])}, "no permutation"),
        ({"rates": wire.RcTuning(100, 0, (0,) * 3, 50, 0, 0, 100, 100, 0, 0, 100, (1998,) * 3, 0)}, "roll reaches 200"),
        ({"rates": wire.RcTuning(100, 0, (0,) * 3, 50, 0, 0, 100, 100, 0, 0, 100, (1998,) * 3, 9)}, "rates_type 9"),
    ],
)
def test_a_permanent_fault_is_reported_in_one_sentence(change, sentence):
    firmware = FakeFirmware()
    for name, value in change.items():
        setattr(firmware, name, value)
    with pytest.raises(UsageError, match=sentence):
        Story(firmware)


def test_override_needs_its_switch_and_a_radio():
    firmware = FakeFirmware()
    firmware.ranges = firmware.ranges[:2]
    with pytest.raises(UsageError, match="no switch turns MSP OVERRIDE on"):
        Story(firmware, receiver="msp_override")
    with pytest.raises(UsageError, match="'receiver' must be one of msp, msp_override, not 'sbus'"):
        Story(receiver="sbus")
    assert "RECEIVER: no pilot's radio" in Story(receiver="msp_override").play(0.3).blocks


def pilots_radio():
    firmware = FakeFirmware()
    firmware.features = 0
    firmware.override = True
    return firmware


def test_override_never_sends_arm_and_waits_for_the_pilot():
    firmware = pilots_radio()
    story = Story(firmware, receiver="msp_override").play(0.3)
    assert "PILOT: ARM is off on the pilot's radio" in story.blocks
    firmware.pilot_arms = True
    story.race()
    story.v_body = np.array([1.0, 0.0, 0.0])
    story.play(0.2).mark().alive.discard("command")
    story.play(2.0)
    assert story.link.phase is Phase.OVER
    assert story.history[-1][1][3] == 1000 and is_angle(story.history[-1][1])  # throttle closed: it cannot disarm
    assert not any(is_armed(frame) for frame in firmware.frames)


def test_under_override_the_pilot_takes_the_sticks_until_the_next_arming():
    firmware = pilots_radio()
    firmware.pilot_arms = True
    story = Story(firmware, receiver="msp_override").race()
    firmware.override = False
    story.play(0.3)
    assert story.link.phase is Phase.OVER and any("pilot took the sticks" in text for _, text in story.link.events)
    firmware.override = True
    assert story.play(0.5).link.phase is Phase.OVER and story.history[-1][1][3] == 1000


def test_a_flight_controller_that_disarms_itself_stays_disarmed():
    story = Story().race()
    story.firmware.flags, story.firmware.armed = 1 << 5, False
    story.firmware.refuses_arming = True
    story.play(0.3)
    assert story.link.phase is Phase.OVER
    assert any("disarmed itself: RUNAWAY_TAKEOFF" in text for _, text in story.link.events)


def test_a_flight_controller_that_falls_silent_in_flight_is_braked_and_landed_by_the_state():
    story = Story()
    story.v_body = np.array([10.0, 0.0, 0.0])
    story.race().firmware.mute = True
    story.mark().play(0.45)
    assert story.link.phase is Phase.RACING and not story.link.failsafe
    story.play(0.3)
    assert story.link.phase is Phase.ENDING and story.link.failsafe
    assert any("has not answered for 0.5 s; levelling, braking" in text for _, text in story.link.events)
    assert is_angle(story.history[-1][1]) and story.history[-1][1][1] < 1500  # leans back
    story.v_body = np.zeros(3)
    assert story.play(2.0).link.phase is Phase.OVER


def test_a_node_that_starts_late_does_not_join_an_armed_race():
    story = Story()
    story.link._race_state = ""
    story.play(0.3).announce("armed").play(0.3).announce("racing").play(0.3)
    assert story.link.phase is Phase.IDLE and not any(is_armed(c) for _, c in story.history)


def test_a_start_in_the_instant_of_arming_is_accepted():
    story = Story().play(0.5).announce("armed")
    while not story.link.armed:
        story.play(0.01)
    assert story.announce("racing").play(0.02).link.phase is Phase.RACING


def test_a_start_without_arming_has_no_effect():
    story = Story().play(0.3).announce("racing").play(0.3)
    assert story.link.phase is Phase.IDLE and ("error" in [level for level, _ in story.link.events])


def test_in_lockstep_frames_do_not_depend_on_the_order_of_arrival():
    """The same race with states and commands swapped and early race states gives the same frames."""
    flown = []
    for swapped in (False, True):
        story = Story(lockstep=True)
        for tick in range(300):
            story.ros_ns += 10_000_000
            story.steady_s += 0.003 + 0.5 * (swapped and tick == 250)  # a machine that hangs for half a second
            story.thrust = 10.0 + 0.1 * tick
            command = BodyRateThrust(story.ros_ns, story.thrust, np.array([0.01, 0.02, 0.0]) * tick)
            state = Odometry(story.ros_ns, np.zeros(3), story.q, np.zeros(3), np.zeros(3))
            messages = [(story.link.take_state, state), (story.link.take_command, command)]
            for take, message in reversed(messages) if swapped else messages:
                take(message, story.now)
                story.write(story.link.answer(story.now))
            story.link.take_judge_message(story.now)
            story.write(story.link.tick(story.now))
            if tick == 60 - 20 * swapped:
                story.link.take_race_state("armed", 1_000_000_000 + 80 * 10_000_000)
            if tick == 120 - 20 * swapped:
                story.link.take_race_state("racing", 1_000_000_000 + 150 * 10_000_000)
        assert story.link.phase is Phase.RACING and len(story.firmware.frames) == 300
        flown.append(story.firmware.frames)
    assert flown[0] == flown[1]


def test_the_idle_of_an_analog_motor_is_its_minimum_throttle_up_to_4_5():
    firmware = FakeFirmware()
    assert read_back.read_back(firmware.ask).motor_idle == pytest.approx(0.055)
    ask = firmware.ask
    analog = wire.encode(wire.AdvancedConfig(0, 0.055))
    firmware.ask = lambda code, payload=b"": analog if code == Code.ADVANCED_CONFIG else ask(code, payload)
    assert read_back.read_back(firmware.ask).motor_idle == pytest.approx(0.07)
    firmware.api = wire.ApiVersion(0, 1, 47)
    assert read_back.read_back(firmware.ask).motor_idle == pytest.approx(0.055)


def test_each_setting_has_a_description():
    assert all(spec.metadata["help"] for spec in fields(settings()))
    assert read_back.failsafe_end_s(wire.FailsafeConfig(0.0, 1.0, 1000, 0, 10.0, 1)) == 0.1
