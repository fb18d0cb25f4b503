"""Runaway-takeoff prevention: a vehicle that rotates despite full control effort is disarmed, normal flight is not."""

from dataclasses import replace

import numpy as np
import pytest
from dumped_loop import quiet, run
from free_flight import vehicle

from swift_ros.configuration import configuration_folder, load_section
from swift_sim_bridge.flight_controller.arming import Block
from swift_sim_bridge.flight_controller.firmware import FlightController, Readings
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings
from swift_sim_bridge.flight_controller.rate_loop.loop import DEGREES
from swift_sim_bridge.flight_controller.rate_loop.runaway import RunawayPrevention, RunawaySettings

PASSES = 1200


@pytest.mark.parametrize(
    ("turning_deg_s", "passes", "tripped"),
    # core.c: 600 PID units on any axis, 15 deg/s (50 in yaw), 75 ms without interruption.
    [((160, 0, 0), 640, True), ((160, 0, 0), 560, False), ((100, 0, 0), 1200, False), ((0, 0, 160), 640, True)],
)
def test_the_loop_measures_how_long_full_effort_has_no_effect(turning_deg_s, passes, tripped):
    gyro = np.zeros((PASSES, 3))
    gyro[:passes] = np.array(turning_deg_s) / DEGREES
    built = quiet(p_roll=125, p_yaw=125, runaway_takeoff_prevention="ON")
    assert run(built, PASSES, gyro=gyro)[1].terms["runaway"][-1] == tripped


def test_normal_flight_ends_the_detection_after_its_time_and_sooner_at_high_throttle():
    still, quiet_sum, busy = np.zeros(3), np.full(3, 50.0), np.full(3, 300.0)
    for throttle, deflections, pid_sum, needed_ms in (
        (0.5, still, quiet_sum, 510),
        (0.8, still, quiet_sum, 260),
        (0.25, still + 0.2, quiet_sum, 510),
        (0.25, still, quiet_sum, None),
        (0.5, still, busy, None),
    ):
        prevention = RunawayPrevention(RunawaySettings(20, 500))
        finished_ms = None
        for now_ms in range(0, 3000, 10):
            prevention.take_frame(now_ms, throttle, deflections, pid_sum)
            finished_ms = now_ms if prevention.finished and finished_ms is None else finished_ms
        assert finished_ms == needed_ms


def test_a_detected_runaway_disarms_until_the_switch_was_off(tmp_path):
    (tmp_path / "dump.txt").write_text("set p_roll = 45\n")
    flown = replace(vehicle(), folder=str(tmp_path), controller={"type": "betaflight", "dump": "dump.txt"})
    settings = load_section(FirmwareSettings, configuration_folder() / "simulation.yaml", "flight_controller")
    calm = Readings(np.array([0, 0, 0, 1.0]), np.zeros(3), 16.0, 1.0, 0.0, np.zeros(4), np.zeros(4), np.zeros(3))
    controller = FlightController(settings, flown, calm)
    safe, armed = [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000], [1500, 1500, 1000, 1500, 2000, 1000, 1000, 1000]

    def fly(channels, begin_s, seconds, readings):
        for tick in range(round(100 * begin_s), round(100 * (begin_s + seconds))):
            controller.receiver.take_msp(channels)
            setpoint = controller.update(tick * 10_000_000, readings)
        return setpoint.armed

    assert not fly(safe, 0.0, 7.0, calm) and fly(armed, 7.0, 0.2, calm)
    assert not fly(armed, 7.2, 0.2, replace(calm, runaway=True))
    assert controller.arming.blocks & Block.RUNAWAY_TAKEOFF and not fly(armed, 7.4, 0.2, calm)
    assert not fly(safe, 7.6, 0.2, calm) and not controller.arming.blocks and fly(armed, 7.8, 0.2, calm)
