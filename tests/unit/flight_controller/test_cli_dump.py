"""The configuration of a flight controller from its CLI dump: what is read, refused and reported as not simulated."""

from dataclasses import replace

import numpy as np
import pytest
from dumped_loop import controller, profile
from free_flight import vehicle

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.configuration import cli_dump, cli_settings, rates
from swift_sim_bridge.flight_controller.configuration.controller_section import (
    DumpedController,
    controller_from_vehicle,
    unmodelled,
)
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle

DIFF = """
# version
# Betaflight / STM32F7X2 (S7X2) 4.5.1 Jul 27 2024 / 11:38:49 (77d01ba3b) MSP API: 1.46
batch start
board_name MAMBAF722
feature RX_MSP
resource MOTOR 1 B04
set osd_vbat_pos = 2048
set dshot_idle_value = 600
profile 0
set p_roll = 60
set d_min_roll = 0
profile 1
set p_roll = 99
# restore original profile selection
profile 0
rateprofile 1
set rates_type = QUICK
set roll_srate = 80
rateprofile 0
set roll_rc_rate = 9
rateprofile 1
save
"""
ALWAYS = {"yaw_spin_recovery = AUTO (the firmware's default)", "gyro_overflow_detect = ALL (the firmware's default)"}


def test_the_active_profiles_are_read_and_missing_settings_have_the_default_of_the_firmware():
    dump = cli_dump.parse(DIFF, "a diff")
    changed = {name for name, value in cli_settings.all_defaults().items() if dump.settings[name] != value}
    assert changed == {"dshot_idle_value", "p_roll", "d_min_roll", "rates_type", "roll_srate"}
    assert dump.settings["p_roll"] == 60 and dump.settings["rates_type"] == "QUICK"
    assert dump.features >= {"AIRMODE", "ANTI_GRAVITY", "RX_MSP"}
    assert set(dump.unmodelled) == ALWAYS


def test_a_function_that_is_not_simulated_is_reported_when_it_is_switched_on():
    lines = """
        # Betaflight / STM32F405 (S405) 4.4.2 Jun  1 2023 / 02:01:17 (abc) MSP API: 1.45
        set crash_recovery = ON
        set abs_control_gain = 0
        set use_integrated_yaw = on
        set yaw_spin_recovery = OFF
        set gyro_overflow_detect = OFF
        set mixer_type = EZLANDING
        feature 3D
        feature -AIRMODE
        aux 0 0 0 1700 2100 0 0
        aux 1 49 3 1300 2100 0 0
        aux 2 2 0 900 900 0 0
        set warp_drive = 9
        mixer HEX6
        frobnicate now
    """
    dump = cli_dump.parse(lines, "a diff")
    assert "AIRMODE" not in dump.features
    named = "\n".join(dump.unmodelled)
    expected = ("4.4", "crash_recovery = ON", "use_integrated_yaw = ON", "EZLANDING", "3D", "warp", "HEX6", "LAUNCH")
    assert all(what in named for what in expected)
    assert "line 16: the unknown 'frobnicate now'" in dump.unmodelled
    assert "abs_control" not in named and "yaw_spin" not in named and "HORIZON" not in named
    assert len(dump.unmodelled) == 9


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("set p_roll = 300", "line 1: p_roll = 300 is not a whole number from 0 to 250"),
        ("set p_roll = much", "p_roll = much"),
        ("set rates_type = LINEAR", "rates_type = LINEAR is not one of BETAFLIGHT"),
        ("set rpm_filter_weights = 100,50", "rpm_filter_weights = 100,50 is not 3 whole numbers"),
        ("profile", "lacks the number"),
        ("aux 0 arm", "is not a mode switch"),
        ("board_name X", "contains no settings"),
    ],
)
def test_a_value_outside_the_range_of_the_firmware_is_reported_in_one_sentence(line, sentence):
    with pytest.raises(UsageError, match=sentence.replace("(", r"\(")):
        cli_dump.parse(line, "a diff")


def test_the_path_of_a_dump_is_relative_to_the_vehicle_file(tmp_path):
    (tmp_path / "mine.txt").write_text(DIFF + "set pid_process_denom = 2\nset iterm_rotation = ON\n")
    keys = {"type": "betaflight", "dump": "mine.txt", "gyro_hz": 3200}
    mine = replace(vehicle(), folder=str(tmp_path), controller=keys)
    built = controller_from_vehicle(mine)
    assert isinstance(built, DumpedController) and built.loop_hz == 1600 and built.motor_idle == 6.0
    built = profile_from_vehicle(mine)
    assert built.loop_hz == 1600 and built.rotate_iterm and built.dynamic_notch is None  # the loop is too slow for it
    assert set(unmodelled(mine)) == ALWAYS and unmodelled(vehicle()) == ()
    for change, named in (({"dump": "none.txt"}, "none.txt cannot be read"), ({"p_roll": 3}, "unknown key 'p_roll'")):
        with pytest.raises(UsageError, match=named):
            controller_from_vehicle(replace(mine, controller={**keys, **change}))
    with pytest.raises(UsageError, match="serial_phase_s"):
        controller_from_vehicle(replace(mine, controller={**keys, "serial_phase_s": 0.02}))


def test_the_same_numbers_give_the_same_gains_in_a_dump_and_in_the_vehicle_file(tmp_path):
    pid = {"roll": [45, 80, 40], "pitch": [47, 84, 46], "yaw": [45, 80, 0]}
    lines = [f"set {term}_{axis} = {gain}" for axis in pid for term, gain in zip("pid", pid[axis], strict=True)]
    (tmp_path / "mine.txt").write_text("\n".join(lines))
    typed = profile_from_vehicle(replace(vehicle(), controller={**vehicle().controller, "pid": pid}))
    dump = {"type": "betaflight", "dump": "mine.txt"}
    dumped = profile_from_vehicle(replace(vehicle(), folder=str(tmp_path), controller=dump))
    for name in ("kp", "ki", "kd"):
        assert np.array_equal(getattr(typed, name), getattr(dumped, name))
    assert typed.ki[2] == pytest.approx(2.5 * 80 * 0.244381)  # pid_init.c


def test_terms_that_a_dump_switches_off_are_absent_from_the_loop():
    off = {"rc_smoothing": "OFF", "anti_gravity_gain": 0, "tpa_rate": 0, "tpa_low_rate": 0, "throttle_boost": 0}
    flown = profile(**off, dyn_notch_count=0, yaw_lowpass_hz=0, iterm_windup=100)
    absent = ("smoothing", "feedforward", "anti_gravity", "tpa", "throttle_boost", "dynamic_notch", "yaw_lowpass_hz")
    absent += ("windup_inverse", "rpm_filter", "thrust_linear", "sag_compensation", "motor_output_limit")
    assert all(getattr(flown, name) is None for name in absent)
    assert all(getattr(profile(), name) is not None for name in absent[:7])


def test_rates_of_a_dump_are_the_bytes_of_the_firmware():
    actual = rates.rate_profile(controller(roll_rc_rate=12, roll_srate=60, roll_expo=40, roll_rate_limit=500))
    assert rates.rate_deg_s(actual, 0, 1.0) == 500.0 and rates.full_rate_deg_s(actual, 0) == pytest.approx(600.0)
    assert rates.rate_deg_s(actual, 0, 0.1) == pytest.approx(12.0 + 480 * 0.1 * (0.4 * 1e-5 + 0.6 * 0.1))
    quick = rates.rate_profile(controller(rates_type="QUICK", roll_rc_rate=100, roll_srate=80, roll_expo=50))
    bent = rates.rate_profile(
        controller(rates_type="QUICK", roll_rc_rate=100, roll_srate=80, roll_expo=50, quickrates_rc_expo="ON")
    )
    share = 1 - 200 / 800
    assert rates.rate_deg_s(quick, 0, 0.5) == pytest.approx(100.0 / (1 - (0.5 * 0.125 + 0.5 * 0.5) * share))
    assert rates.rate_deg_s(bent, 0, 0.5) == pytest.approx(200 * (0.5 * 0.125 + 0.5 * 0.5) / (1 - 0.5 * share))


def test_deadband_and_throttle_curve_are_those_of_the_firmware():
    held = rates.rate_profile(controller(deadband=10, thr_mid=30, thr_expo=60))
    assert rates.deflection_of(1508, 0, 1500, held.deadband_us[0]) == 0.0
    assert rates.deflection_of(1990, 0, 1500, 10) == pytest.approx(480 / 490)
    assert rates.deflection_of(1000, 2, 1500, 10) == 1.0  # the yaw stick alone is reversed
    shares = [rates.throttle_share(us, 1050, held) for us in (1000, 1050, 1335, 1620, 2000, 2300)]
    # initRcProcessing: steep at both ends, flat (40 %) around 30 %; 1335 us is exactly 300 thousandths.
    assert shares[0] == shares[1] == 0.0 and shares[2] == 0.3 and shares[4] == shares[5] == 1.0
    assert shares[3] == pytest.approx(0.3 + 0.3 * (0.4 + 0.6 * (30 / 70) ** 2), abs=2e-3)
    plain = rates.rate_profile(controller())
    assert rates.throttle_share(1525, 1050, plain) == rates.throttle_share(1525, 1050) == 0.5
