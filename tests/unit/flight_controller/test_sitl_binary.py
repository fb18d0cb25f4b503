"""The real firmware, where $SWIFT_SITL names a binary: it starts configured, counteracts rotations and flies."""

import socket

import numpy as np
import pytest
from simulated_controller import FOLDER, shipped, sticks

from swift_ros import configuration
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.rate_loop.mixer import MIX
from swift_sim_bridge.flight_controller.sitl.cli_lines import command_lines
from swift_sim_bridge.flight_controller.sitl.msp_proxy import SitlProxy
from swift_sim_bridge.flight_controller.sitl.replay import FRAME_PASSES, arm, replay
from swift_sim_bridge.flight_controller.sitl.sitl import Sitl
from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

SAFE = [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000]
ARMED = [*SAFE[:4], 2000, 1000, 1000, 1000]
HALF = [1500, 1500, 1525, 1500, 2000, 1000, 1000, 1000]  # half of the throttle above min_check
MSP_PID = 112
SETTLE_S = 0.015


@pytest.fixture
def firmware(sitl_binary, tmp_path):
    vehicle = configuration.load(Vehicle, FOLDER / "drone.yaml")
    with Sitl(sitl_binary, tmp_path, command_lines(vehicle, shipped(grace_s=0.0))) as sitl:
        sitl.await_calibration()
        yield sitl


def test_it_starts_with_the_gains_of_the_vehicle_file(firmware):
    assert firmware.version[:2] == (4, 5)
    assert tuple(firmware.ask(MSP_PID)[:9]) == (52, 40, 48, 56, 42, 52, 75, 3, 0)


def test_it_arms_and_counteracts_a_rotation_about_each_axis(firmware):
    if not firmware.stepped:
        pytest.skip("needs a binary with gyro sync, the firmware's option SIMULATOR_GYROPID_SYNC")
    arm(firmware, SAFE, ARMED)
    level = replay(firmware, np.zeros((10 * FRAME_PASSES, 3)), [HALF] * 10, settle_s=SETTLE_S)[-1]
    assert level == pytest.approx(np.full(4, 0.055 + 0.945 * 0.5), abs=2e-3)
    for axis, row in enumerate(MIX * [[1.0], [1.0], [-1.0]]):  # propellers turn inwards at the front
        turning = np.zeros((FRAME_PASSES, 3))
        turning[:, axis] = 0.5
        response = replay(firmware, turning, [HALF], settle_s=SETTLE_S)[-1] - level
        assert response @ row / 4 < -0.01, axis
        replay(firmware, np.zeros((20 * FRAME_PASSES, 3)), [HALF] * 20)


def test_with_gyro_sync_the_same_gyro_and_sticks_give_the_same_motors(firmware):
    if not firmware.stepped:
        pytest.skip("needs a binary with gyro sync, the firmware's option SIMULATOR_GYROPID_SYNC")
    arm(firmware, SAFE, ARMED)
    time_s = np.arange(40 * FRAME_PASSES) / 8000
    gyro = 0.5 * np.sin(2 * np.pi * np.outer(time_s, [10.0, 15.0, 5.0]))  # whole periods
    flown = []
    for _ in range(2):
        flown.append(replay(firmware, gyro, [HALF] * 40))
        replay(firmware, np.zeros((2, 3)), [ARMED])  # closed throttle: with air mode the I term keeps its value
    periods = [motors[20 * FRAME_PASSES :] - motors[20 * FRAME_PASSES :].mean(axis=0) for motors in flown]
    assert np.sqrt(np.mean((periods[0] - periods[1]) ** 2)) < 2e-3


def fly(vehicle, server, seconds, frame):
    """Fly with the same frame in every tick; return the ground truth at the end."""
    with socket.create_connection(("127.0.0.1", int(server.name.rsplit(":", 1)[1]))) as client:
        for _ in range(round(100 * seconds)):
            client.sendall(frame)
            assert client.recv(4096)[:3] == b"$M>"
            truth = vehicle.sense(vehicle.tick * TICK_NS).truth
            vehicle.advance()
    return truth


def test_a_client_flies_it_through_the_port_of_the_simulator(sitl_binary, tmp_path):
    for name in ("drone.yaml", "track.yaml", "simulation.yaml"):
        text = (FOLDER / name).read_text()
        (tmp_path / name).write_text(text.replace("grace_s: 5.0", "grace_s: 0.0"))
    vehicle = SimulatedVehicle(tmp_path, 1000, sitl_binary)
    vehicle.compile()
    server = SitlProxy(vehicle.flight_controller, 0, vehicle.firmware.sitl.open_port())
    try:
        start = fly(vehicle, server, 1.5, sticks())
        fly(vehicle, server, 0.5, sticks(arm=2000))
        assert vehicle.flight_controller.arming.armed
        climbed = fly(vehicle, server, 1.0, sticks(arm=2000, throttle=1500))
    finally:
        server.close()
        vehicle.firmware.close()
    assert np.allclose(start.p_world, vehicle.track.start, atol=1e-3)
    assert climbed.p_world[2] > start.p_world[2] + 0.3 and vehicle.crash is None
    assert np.linalg.norm(climbed.omega_body) < 0.5
