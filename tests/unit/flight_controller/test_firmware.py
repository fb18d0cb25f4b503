"""The simulated firmware treats sticks, switches and a lost signal as Betaflight 4.5 does."""

import numpy as np
import pytest
from simulated_controller import ControllerRig, sticks

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.arming import Block
from swift_sim_bridge.flight_controller.configuration import rates
from swift_sim_bridge.flight_controller.configuration.rates import RateProfile, rate_deg_s, throttle_share
from swift_sim_bridge.flight_controller.failsafe import Phase
from swift_sim_bridge.flight_controller.firmware_settings import FailsafeSettings, ModeSwitch


def profile(family: str, rc_rate: int, super_rate: int, expo: int) -> RateProfile:
    return RateProfile(rates.RATES_TYPES.index(family), (rc_rate,) * 3, (super_rate,) * 3, (expo,) * 3)


@pytest.mark.parametrize(
    ("family", "numbers", "deflection", "expected"),
    [
        # What the configurator shows as maximum for its best-known settings, and points computed by hand.
        ("betaflight", (100, 70, 0), 1.0, 200 / 0.3),
        ("betaflight", (100, 70, 0), 0.5, 100 / 0.65),
        ("betaflight", (150, 50, 0), 1.0, 600.0),
        ("betaflight", (220, 0, 0), 1.0, 200 * (2.2 + 14.54 * 0.2)),
        ("betaflight", (100, 0, 50), 0.5, 200 * (0.5 * 0.125 * 0.5 + 0.5 * 0.5)),
        ("actual", (7, 67, 0), 1.0, 670.0),
        ("actual", (7, 67, 0), 0.5, 70 * 0.5 + 600 * 0.25),
        ("actual", (7, 67, 100), 0.5, 70 * 0.5 + 600 * 0.5**6),
        ("kiss", (100, 70, 0), 1.0, 200 / 0.3),
        ("raceflight", (37, 80, 50), 1.0, 370 * 1.8),
        ("quick", (100, 67, 0), 1.0, 670.0),
    ],
)
def test_rate_curves_give_the_rates_of_the_firmware_in_both_directions(family, numbers, deflection, expected):
    p = profile(family, *numbers)
    assert rate_deg_s(p, 0, deflection) == pytest.approx(expected, rel=1e-6)
    assert rate_deg_s(p, 0, -deflection) == pytest.approx(-expected, rel=1e-6)


def test_the_throttle_range_begins_at_min_check_and_has_whole_thousandths():
    assert throttle_share(1000, 1050) == 0.0
    assert throttle_share(1050, 1050) == 0.0
    assert throttle_share(2000, 1050) == 1.0
    assert throttle_share(1525, 1050) == 0.5
    assert throttle_share(1526, 1050) == 0.501  # 501.05 thousandths: the firmware counts whole ones


def test_sticks_become_rates_with_the_signs_of_flu():
    rig = ControllerRig()
    rig.arm()
    right = rig.fly(0.02, sticks(arm=2000, roll=2000)).omega_body
    nose_down = rig.fly(0.02, sticks(arm=2000, pitch=2000)).omega_body
    yaw_right = rig.fly(0.02, sticks(arm=2000, yaw=2000)).omega_body
    assert right[0] > 5 and nose_down[1] > 5 and yaw_right[2] < -2
    assert np.count_nonzero(right) == np.count_nonzero(nose_down) == np.count_nonzero(yaw_right) == 1


def test_channels_follow_the_receiver_s_map():
    rig = ControllerRig(channel_map="TAER1234")
    rig.arm()  # frames in the shipped map: its roll is the throttle of this map
    assert not rig.last.armed and Block.THROTTLE in rig.controller.arming.blocks


def test_a_level_vehicle_arms_after_its_grace_time_and_not_before():
    rig = ControllerRig()
    rig.fly(4.9, sticks())
    assert rig.controller.arming.blocks == Block.BOOT_GRACE_TIME
    rig.fly(0.3, sticks())
    assert not rig.controller.arming.blocks
    assert rig.fly(0.05, sticks(arm=2000)).armed
    assert rig.controller.flight_modes() == {"ARM"}


@pytest.mark.parametrize(
    ("wrong", "block"),
    [({"throttle": 1100}, Block.THROTTLE), ({"tilt": 30.0}, Block.ANGLE), ({"off": 2000}, Block.BOXFAILSAFE)],
)
def test_arming_is_refused_with_the_flag_of_the_reason(wrong, block):
    rig = ControllerRig()
    rig.tilt(wrong.pop("tilt", 0.0))
    rig.fly(6.0, sticks(**wrong))
    assert block in rig.controller.arming.blocks
    assert not rig.fly(0.1, sticks(arm=2000, **wrong)).armed
    assert Block.ARM_SWITCH in rig.controller.arming.blocks
    rig.q = np.array([0.0, 0.0, 0.0, 1.0])
    assert not rig.fly(1.0, sticks(arm=2000)).armed  # corrected too late: the switch must go off first
    rig.fly(1.0, sticks())
    assert rig.fly(0.1, sticks(arm=2000)).armed


def test_a_switch_that_is_on_when_the_signal_appears_does_not_arm():
    rig = ControllerRig()
    rig.fly(6.0)
    rig.fly(1.0, sticks(arm=2000))
    assert not rig.last.armed and Block.NOT_DISARMED in rig.controller.arming.blocks


def test_one_bad_frame_does_not_disarm_but_a_switch_does():
    rig = ControllerRig()
    rig.arm()
    rig.tick(sticks())
    assert rig.fly(0.1, sticks(arm=2000)).armed
    assert not rig.fly(0.06, sticks()).armed


def test_after_a_lost_signal_sticks_are_held_then_centred_then_the_vehicle_is_dropped():
    rig = ControllerRig()
    rig.arm()
    flying = sticks(arm=2000, roll=1700, throttle=1600)
    held = rig.fly(0.5, flying)
    timeline = [rig.tick() for _ in range(80)]  # entry i is the setpoint 10 (i + 1) ms after the last frame
    assert all(np.array_equal(s.omega_body, held.omega_body) and s.throttle == held.throttle for s in timeline[:29])
    assert not timeline[29].omega_body.any() and timeline[29].throttle == 0 and timeline[29].armed
    assert timeline[49].armed and not timeline[50].armed
    assert {Block.RX_FAILSAFE, Block.FAILSAFE} <= set(rig.controller.arming.blocks)
    assert "FAILSAFE" in rig.controller.flight_modes()


def test_the_signal_is_lost_after_100_ms():
    rig = ControllerRig()
    rig.arm()
    rig.fly(0.09)
    assert rig.controller.receiver.signal
    rig.tick()
    assert not rig.controller.receiver.signal and Block.RX_FAILSAFE in rig.controller.arming.blocks


def test_a_signal_that_returns_in_time_continues_the_flight_and_after_the_drop_the_vehicle_stays_disarmed():
    rig = ControllerRig()
    rig.arm()
    flying = sticks(arm=2000, throttle=1600)
    rig.fly(0.2, flying)
    rig.fly(0.4)
    assert rig.fly(0.02, flying).armed and rig.last.throttle > 0.5
    rig.fly(1.0)
    assert not rig.fly(2.0, flying).armed
    assert rig.controller.failsafe.phase is Phase.IDLE
    rig.fly(0.1, sticks())
    assert rig.fly(0.1, sticks(arm=2000)).armed


def test_landing_levels_the_vehicle_at_the_landing_throttle_and_ends():
    land = FailsafeSettings(0.5, "land", 1.0, 1300, 10.0, 0.5)
    rig = ControllerRig(failsafe=land)
    rig.arm()
    rig.fly(0.5, sticks(arm=2000, throttle=1600))
    rig.tilt(20.0)
    rig.fly(0.75)
    assert rig.last.armed and rig.last.throttle == pytest.approx(0.263, abs=0.001)
    assert rig.last.omega_body[0] == pytest.approx(np.radians(-20 * 5.0), rel=1e-6)
    rig.fly(1.0)
    assert not rig.last.armed


def test_in_angle_mode_sticks_command_angles():
    rig = ControllerRig()
    rig.arm()
    rig.tilt(20.0)
    level = rig.fly(0.05, sticks(arm=2000, angle=2000)).omega_body
    assert np.degrees(level) == pytest.approx([-100.0, 0.0, 0.0], abs=1e-6)
    full = rig.fly(0.05, sticks(arm=2000, angle=2000, roll=2000)).omega_body
    assert np.degrees(full[0]) == pytest.approx((60 - 20) * 5.0, abs=1e-6)
    assert rig.controller.flight_modes() == {"ARM", "ANGLE"}


def test_under_override_the_pilot_s_radio_arms_and_msp_keeps_the_sticks():
    rig = ControllerRig(receiver="msp_override")
    radio = [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000]
    rig.controller.receiver.radio = radio
    rig.fly(6.0, sticks(arm=2000))
    assert not rig.last.armed  # a switch by MSP is ignored
    radio[4] = 2000
    assert rig.fly(0.1).armed
    radio[6] = 2000
    assert rig.fly(0.1, sticks(roll=1700, throttle=1600)).omega_body[0] > 1
    assert rig.fly(1.0).omega_body[0] > 1  # 4.5 holds the last MSP values while the radio sends
    radio[6] = 1000
    assert not rig.fly(0.05).omega_body.any()
    rig.controller.receiver.radio = None
    assert not rig.fly(1.0).armed


def test_a_switch_for_an_unknown_box_and_rates_too_high_for_a_byte_are_refused():
    with pytest.raises(ValueError, match="GPS RESCUE"):
        ControllerRig(modes={"GPS RESCUE": ModeSwitch(1, 1700, 2100)})
    vehicle = ControllerRig().vehicle
    vehicle.controller["rc_rate"] = [3.0, 3.0, 3.0]
    with pytest.raises(UsageError, match="rc_rate"):
        ControllerRig(vehicle)
