"""The parts around the real firmware, without it: packets, configuration, MSP proxy, failures at its start."""

import dataclasses
import os
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from patience import PATIENCE_S, wait_for
from simulated_controller import FOLDER, SET_RAW_RC, request, shipped, sticks

from swift_ros import cli, configuration
from swift_ros.betaflight import msp
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.firmware import Readings
from swift_sim_bridge.flight_controller.sitl import msp_proxy, sitl, udp
from swift_sim_bridge.flight_controller.sitl.cli_lines import command_lines, patient_failsafe, unsupported_by_sitl
from swift_sim_bridge.flight_controller.sitl.program import Program
from swift_sim_bridge.simulation import sitl_vehicle

STATUS_EX, MOTOR, BATTERY_STATE = 150, 104, 130
DUMP = """# Betaflight / STM32F7X2 (S7X2) 4.5.1 Jul 27 2024
set dshot_bidir = ON
set dyn_notch_count = 2
profile 0
set p_roll = 60
"""


@pytest.fixture
def vehicle():
    return configuration.load(Vehicle, FOLDER / "drone.yaml")


def free(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def ports(monkeypatch):
    """Use free ports, so that a firmware of another user of this machine does not disturb."""
    for name in ("STATE_PORT", "MOTOR_PORT", "RAW_PORT", "RC_PORT"):
        monkeypatch.setattr(udp, name, free(socket.SOCK_DGRAM))
    monkeypatch.setattr(sitl, "MSP_PORT", free(socket.SOCK_STREAM))


def script(folder, text):
    path = folder / "firmware"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def test_the_firmware_reads_the_rates_attitude_and_gravity_that_were_sent():
    omega_body = np.array([1.3, -2.7, 0.4])
    packet = udp.state_packet(omega_body, [0.1, 0.2, 0.3, 0.9], [0.5, 1.0, 9.81])
    stamp, x, y, z, *rest = struct.unpack("<18d", packet)
    # sitl.c, updateState: FRD to its own FLU, times 16.4 a deg/s, cut to whole counts; a count is 1/16.384 deg/s.
    counts = np.array([int(value * 16.4 * 180 / np.pi) for value in (x, -y, -z)])
    assert np.allclose(np.radians(counts / 16.384), omega_body, atol=np.radians(0.5 / 16.384))
    assert np.allclose(-np.array(rest[:3]), [0.5, 1.0, 9.81]) and rest[3:7] == [0.9, 0.1, 0.2, 0.3]
    assert stamp == 0.0
    too_fast = struct.unpack("<18d", udp.state_packet([90.0, 0, 0], [0, 0, 0, 1], [0, 0, 9.81]))
    assert int(too_fast[1] * 16.4 * 180 / np.pi) == 32767


def test_motor_outputs_have_the_firmware_s_order_and_fractions_and_some_answers_contain_no_pass(ports):
    sockets = udp.UdpSockets()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as firmware:
        for port, packet in (
            (udp.MOTOR_PORT, struct.pack("<4f", 0.2, 0.3, 0.4, 0.1)),
            (udp.RAW_PORT, struct.pack("<H2x16f", 4, 1100.5, 1200.5, 1300.5, 1400.5, *[0.0] * 12)),
        ):
            firmware.sendto(packet, ("127.0.0.1", port))
        assert np.allclose(sockets.receive(1.0), [0.1005, 0.2005, 0.3005, 0.4005])
        firmware.sendto(bytes(16), ("127.0.0.1", udp.MOTOR_PORT))
        assert sockets.receive(1.0) is udp.NO_PASS
        assert sockets.receive(0.01) is None and sockets.newest() is None
    sockets.close()


def test_the_cli_lines_configure_the_profile_of_the_vehicle_file(vehicle):
    lines = command_lines(vehicle, shipped())
    for line in (
        "set p_roll = 52",
        "set d_pitch = 52",
        "set i_yaw = 3",
        "set min_throttle = 1055",
        "set roll_rc_rate = 120",
        "set yaw_srate = 30",
        "set rates_type = BETAFLIGHT",
        "set dterm_lpf1_static_hz = 70",
        "set rc_smoothing = OFF",
        "set failsafe_procedure = DROP",
        "set failsafe_delay = 5",
        "aux 0 0 0 1700 2100 0 0",
        "aux 1 1 1 1700 2100 0 0",
        "map AETR1234",
        "feature AIRMODE",
    ):
        assert line in lines, line
    assert patient_failsafe(shipped()) == "set failsafe_delay = 25"
    assert unsupported_by_sitl(vehicle) == []
    assert unsupported_by_sitl(dataclasses.replace(vehicle, terms={"command_latency": {}})) == [
        "the term command_latency"
    ]
    with pytest.raises(UsageError, match="no radio"):
        command_lines(vehicle, shipped(receiver="msp_override"))


def test_a_dump_is_entered_completely_except_for_what_sitl_lacks_which_is_reported(vehicle, tmp_path):
    (tmp_path / "diff.txt").write_text(DUMP)
    controller = {"type": "betaflight", "dump": "diff.txt"}
    dumped = dataclasses.replace(vehicle, controller=controller, folder=str(tmp_path))
    lines = command_lines(dumped, shipped())
    assert {"set p_roll = 60", "set rc_smoothing = ON", "set min_throttle = 1055"} <= set(lines)
    assert not any("dyn_notch" in line or "dshot" in line for line in lines)
    assert [phrase.split()[0] for phrase in unsupported_by_sitl(dumped)] == ["dyn_notch_count", "the"]


def test_a_program_that_cannot_start_is_reported_in_one_sentence(ports, tmp_path):
    for binary, sentence in (
        (tmp_path / "none", "there is no Betaflight SITL binary"),
        (FOLDER / "drone.yaml", "is not executable"),
        (script(tmp_path, "exit 3"), "exited with 3"),
    ):
        with pytest.raises(UsageError, match=sentence):
            sitl.Sitl(binary, tmp_path / "scratch")


@pytest.mark.parametrize("name", ["STATE_PORT", "MOTOR_PORT", "RC_PORT"])
def test_a_udp_port_in_use_is_reported_before_anything_starts(ports, tmp_path, name):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", getattr(udp, name)))
        with pytest.raises(UsageError, match=f"UDP port {getattr(udp, name)}"):
            sitl.Sitl(script(tmp_path, "exit 0"), tmp_path / "scratch")


def test_an_msp_port_in_use_and_one_that_never_opens_are_reported(ports, tmp_path, monkeypatch):
    with socket.create_server(("127.0.0.1", sitl.MSP_PORT)), pytest.raises(UsageError, match="TCP port .* in use"):
        sitl.Sitl(script(tmp_path, "exit 0"), tmp_path / "scratch")
    monkeypatch.setattr(sitl, "START_S", 0.2)
    with pytest.raises(UsageError, match="opens no MSP port"):
        sitl.Sitl(script(tmp_path, "exec sleep 3600"), tmp_path / "scratch")


OTHER_FIRMWARE = """#!{python}
import socket, sys
sys.path.insert(0, "{folder}")
from fake_firmware import FakeFirmware
firmware = FakeFirmware()
firmware.variant = b"INAV"
client, _ = socket.create_server(("127.0.0.1", {port})).accept()
while data := client.recv(4096):
    client.sendall(firmware.feed(data))
"""


def test_another_firmware_is_reported(ports, tmp_path, monkeypatch):
    for name in ("START_S", "ANSWER_S"):
        monkeypatch.setattr(sitl, name, PATIENCE_S)
    binary = tmp_path / "firmware"
    text = OTHER_FIRMWARE.format(
        python=sys.executable, folder=Path(__file__).parents[2] / "support", port=sitl.MSP_PORT
    )
    binary.write_text(text)
    binary.chmod(0o755)
    with pytest.raises(UsageError, match="is INAV 4.5.6; give a SITL binary of Betaflight 4.5"):
        sitl.Sitl(binary, tmp_path / "scratch")


def test_the_firmware_ends_with_its_parent_even_when_the_parent_is_killed(tmp_path):
    pid_file = tmp_path / "pid"
    binary = script(tmp_path, f"echo $$ > {pid_file}.part; mv {pid_file}.part {pid_file}; exec sleep 3600")
    imports = "import time\nfrom swift_sim_bridge.flight_controller.sitl.program import Program\n"
    code = f"{imports}Program({str(binary)!r}, {str(tmp_path)!r}).start()\ntime.sleep(3600)"
    parent = subprocess.Popen([sys.executable, "-c", code])
    wait_for(pid_file.exists)
    child = f"/proc/{pid_file.read_text().strip()}"
    assert os.path.exists(child)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    wait_for(lambda: not os.path.exists(child), "the firmware outlives its parent")


def test_the_command_asks_for_the_binary(capsys):
    chosen = ["--flight-controller", "sitl"]
    for wrong in (chosen, ["--sitl", "/x"], [*chosen, "--sitl", "/none"]):
        for command in ("race", "sim"):
            assert cli.main([command, *wrong]) == 2
    assert "needs --sitl PATH" in capsys.readouterr().err


class ProxyStory:
    """The MSP proxy between a client and a firmware, both played by the test."""

    def __init__(self, vehicle):
        still = Readings(np.array([0, 0, 0, 1.0]), np.zeros(3), 16.0, 5.0, 36.0, np.full(4, 0.25), np.full(4, 500.0))
        self.controller = msp_proxy.SitlController(shipped(), vehicle, still)
        with socket.create_server(("127.0.0.1", 0)) as listener:
            firmware_end = socket.create_connection(listener.getsockname())
            self.firmware, _ = listener.accept()
        self.server = msp_proxy.SitlProxy(self.controller, 0, firmware_end)
        self.client = socket.create_connection(("127.0.0.1", int(self.server.name.rsplit(":", 1)[1])))
        for connection in (self.client, self.firmware):
            connection.settimeout(PATIENCE_S)

    def close(self):
        self.client.close()
        self.server.close()
        self.firmware.close()


@pytest.fixture
def port(vehicle):
    story = ProxyStory(vehicle)
    yield story
    story.close()


def codes(data):
    return [message.code for message in msp.Parser().feed(data)]


def test_the_proxy_answers_for_meters_and_motors_and_forwards_the_rest_in_order(port):
    port.client.sendall(request(STATUS_EX) + request(BATTERY_STATE) + request(MOTOR))
    assert codes(port.firmware.recv(4096).replace(b"<", b">")) == [STATUS_EX]
    port.client.settimeout(0.1)
    with pytest.raises(TimeoutError):
        port.client.recv(4096)  # the later answers wait for the first
    port.firmware.sendall(msp.encode(msp.Message(STATUS_EX, b"\x01\x02", version=1)))
    port.client.settimeout(PATIENCE_S)
    received = b""
    while len(codes(received)) < 3:
        received += port.client.recv(4096)
    status, battery, motors = msp.Parser().feed(received)
    assert (status.code, status.payload) == (STATUS_EX, b"\x01\x02")
    assert struct.unpack_from("<BHBH", battery.payload)[3] == 10  # mAh drawn
    assert struct.unpack_from("<4H", motors.payload) == (1251,) * 4


def test_stick_frames_are_counted_forwarded_answered_at_once_and_repeated_while_time_is_paused(port):
    before = port.controller.commands_sha256
    port.client.sendall(sticks(arm=2000))
    assert codes(port.client.recv(4096)) == [SET_RAW_RC]
    assert port.controller.frames == 1 and port.controller.commands_sha256 != before
    assert port.firmware.recv(len(sticks())) == sticks(arm=2000)
    assert port.firmware.recv(len(sticks())) == sticks(arm=2000)  # repeated
    assert port.controller.frames == 1
    for _ in range(5):
        port.controller.update(0, port.controller.readings)
    port.firmware.settimeout(4 * msp_proxy.REPEAT_S)
    with pytest.raises(TimeoutError):
        while True:  # frames already sent, then none: time advances, so the client is silent
            port.firmware.recv(4096)
    assert port.controller.arming.armed


class WallClockFirmware:
    """Answers every state with the same motor outputs."""

    stepped = False
    states = 0

    def exchange(self, *_):
        self.states += 1
        return np.full(4, 0.3)


def test_without_gyro_sync_steps_follow_the_wall_clock_and_catch_up(monkeypatch, vehicle):
    now = [100.0]
    monkeypatch.setattr(sitl_vehicle.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(sitl_vehicle.time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    flight = sitl_vehicle.SitlFlight(WallClockFirmware(), np.zeros(1), np.zeros(1))
    monkeypatch.setattr(sitl_vehicle, "_move", lambda state, motors, *_: (state, state))

    class Still:
        omega_body = specific_force_body = np.zeros(3)

    flight.fly(Still, None, np.zeros(3), np.zeros((5, 3)), None, True)
    assert now[0] == pytest.approx(100.008)  # the fifth step begins 8 ms after the first
    now[0] += 0.5
    for _ in range(3):
        flight.fly(Still, None, np.zeros(3), np.zeros((5, 3)), None, True)
    assert flight.max_drift_s == pytest.approx(0.498)
    assert flight.drift_s == pytest.approx(0.498 - 14 * 0.4e-3)  # late steps follow each other faster than their length
    assert flight.sitl.states == 20


def test_the_signal_that_killed_the_program_is_reported(tmp_path):
    program = Program(script(tmp_path, "kill -9 $$"), tmp_path)
    program.start()
    with pytest.raises(UsageError, match="killed by SIGKILL"):
        program.await_end()
        program.check()
