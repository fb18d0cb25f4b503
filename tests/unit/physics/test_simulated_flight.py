"""From MSP bytes on a TCP port to a vehicle in the air: the simulator without the graph."""

import socket
import struct

import jax
import numpy as np
import pytest
from patience import PATIENCE_S
from simulated_controller import FOLDER, request, sticks

from swift_ros.betaflight.sticks import throttle_for_thrust, throttle_stick
from swift_ros.errors import UsageError
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.flight_controller.msp_socket import PSEUDO_TERMINAL, MspSocket
from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle


def hover_us(vehicle):
    """Return the throttle stick for hover, as the pilot's side computes it."""
    idle = vehicle.flight_controller.profile.motor_idle / 100
    share = throttle_for_thrust(np.asarray(GRAVITY), 16.5, vehicle.vehicle, idle)
    return int(throttle_stick(share, vehicle.flight_controller.settings.min_check_us))


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


class Client:
    """A raw MSP client on a socket, one frame and one tick at a time."""

    def __init__(self, vehicle, port):
        self.vehicle = vehicle
        self.connection = socket.create_connection(("127.0.0.1", port))
        self.connection.settimeout(PATIENCE_S)
        self.sent = 0

    def fly(self, server, seconds, frame):
        """Send the frame before each tick and read its answer; return the poses."""
        poses = []
        for _ in range(round(100 * seconds)):
            self.connection.sendall(frame)
            self.sent += 1
            assert server.wait_for_frames(self.sent, PATIENCE_S)
            poses.append(self.vehicle.sense(self.vehicle.tick * TICK_NS).truth)
            with server.lock:
                self.vehicle.advance()
            assert self.connection.recv(4096)[:3] == b"$M>"
        return poses

    def ask(self, command):
        self.connection.sendall(request(command))
        return self.connection.recv(4096)[5:-1]

    def rpm(self):
        return struct.unpack_from("<I", self.ask(139), 1)[0]


@pytest.fixture
def flight():
    vehicle = SimulatedVehicle(FOLDER, 1000)
    server = MspSocket(vehicle.flight_controller, 0)
    client = Client(vehicle, int(server.name.rsplit(":", 1)[1]))
    yield vehicle, server, client
    client.connection.close()
    server.close()


def test_a_raw_msp_client_arms_takes_off_and_hovers(flight):
    vehicle, server, client = flight
    start = client.fly(server, 6.0, sticks())[-1]
    assert np.allclose(start.p_world, vehicle.track.start, atol=1e-6)
    while not vehicle.flight_controller.arming.armed:
        client.fly(server, 0.01, sticks(arm=2000))
    assert client.rpm() > 0  # of this tick, not of the one before
    client.fly(server, 0.3, sticks(arm=2000))
    assert client.rpm() > 5000  # idling
    client.fly(server, 0.4, sticks(arm=2000, angle=2000, throttle=1400))
    hover = client.fly(server, 1.0, sticks(arm=2000, angle=2000, throttle=hover_us(vehicle)))
    climbing = [pose.v_body[2] for pose in hover]
    assert hover[-1].p_world[2] > start.p_world[2] + 0.2
    assert abs(climbing[-1] - climbing[-50]) < 0.3  # m/s: the throttle neither climbs nor sinks
    assert np.linalg.norm(hover[-1].p_world[:2] - start.p_world[:2]) < 0.5
    assert np.linalg.norm(hover[-1].omega_body) < 0.5 and vehicle.crash is None
    volts = struct.unpack_from("<H", client.ask(110), 7)[0] / 100
    assert 14.0 < volts < 16.8


def test_without_frames_the_failsafe_of_the_firmware_ends_the_flight_and_the_vehicle_crashes(flight):
    vehicle, server, client = flight
    client.fly(server, 6.0, sticks())
    client.fly(server, 0.2, sticks(arm=2000))
    client.fly(server, 0.5, sticks(arm=2000, angle=2000, throttle=1400))
    for _ in range(300):
        vehicle.sense(vehicle.tick * TICK_NS)
        vehicle.advance()
        if vehicle.crash:
            break
    assert not vehicle.flight_controller.arming.armed
    assert vehicle.disarmed_s == pytest.approx(6.7 + 0.5, abs=0.03)
    assert "ground" in vehicle.crash
    assert vehicle.thrust_to_weight(vehicle.pack) == pytest.approx(4.1, abs=0.05)


def test_equal_bytes_and_seed_give_equal_flights_and_another_seed_another_one():
    def truth(seed):
        vehicle = SimulatedVehicle(FOLDER, seed)
        for k in range(560):
            vehicle.sense(k * TICK_NS)
            armed = {"arm": 2000} if k > 520 else {}
            vehicle.flight_controller.feed(sticks(**armed, throttle=1600 if k > 530 else 1000))
            vehicle.advance()
        return vehicle.truth_sha256

    assert truth(1000) == truth(1000) != truth(1001)


def test_a_port_in_use_is_one_sentence_and_a_pseudo_terminal_answers(flight):
    vehicle, server, _ = flight
    with pytest.raises(UsageError, match="is not available"):
        MspSocket(vehicle.flight_controller, int(server.name.rsplit(":", 1)[1]))
    terminal = MspSocket(vehicle.flight_controller, PSEUDO_TERMINAL)
    with open(terminal.name, "r+b", buffering=0) as line:
        line.write(request(2))
        assert line.read(10)[:9] == b"$M>\x04\x02BTFL"
    terminal.close()
