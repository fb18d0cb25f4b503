"""What surrounds the real firmware, without it: packets, set-up, its MSP port, what goes wrong at its start."""

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
from swift_sim_bridge.flight_controller.sitl import msp_proxy as sitl_port
from swift_sim_bridge.flight_controller.sitl import sitl, udp
from swift_sim_bridge.flight_controller.sitl.cli_lines import command_lines, unsupported_by_sitl, patient_failsafe
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
    """Ports that no firmware of this machine's other users holds."""
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


def test_motor_outputs_come_in_the_firmware_s_order_with_their_fractions_and_some_answers_have_none(ports):
    link = udp.UdpSockets()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as firmware:
        for port, packet in (
            (udp.MOTOR_PORT, struct.pack("<4f", 0.2, 0.3, 0.4, 0.1)),
            (udp.RAW_PORT, struct.pack("<H2x16f", 4, 1100.5, 1200.5, 1300.5, 1400.5, *[0.0] * 12)),
        ):
            firmware.sendto(packet, ("127.0.0.1", port))
        assert np.allclose(link.receive(1.0), [0.1005, 0.2005, 0.3005, 0.4005])
        firmware.sendto(bytes(16), ("127.0.0.1", udp.MOTOR_PORT))
        assert link.receive(1.0) is udp.NO_PASS
        assert link.receive(0.01) is None and link.newest() is None
    link.close()


def test_the_command_line_sets_up_the_vehicle_file_s_profile(vehicle):
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
    assert unsupported_by_sitl(dataclasses.replace(vehicle, terms={"command_latency": {}})) == ["the term command_latency"]
    with pytest.raises(UsageError, match="no radio"):
        command_lines(vehicle, shipped(receiver="msp_override"))


def test_a_dump_is_typed_whole_but_for_what_sitl_lacks_which_is_named(vehicle, tmp_path):
    (tmp_path / "diff.txt").write_text(DUMP)
    controller = {"type": "betaflight", "dump": "diff.txt"}
    dumped = dataclasses.replace(vehicle, controller=controller, folder=str(tmp_path))
    lines = command_lines(dumped, shipped())
    assert {"set p_roll = 60", "set rc_smoothing = ON", "set min_throttle = 1055"} <= set(lines)
    assert not any("dyn_notch" in line or "dshot" in line for line in lines)
    assert [phrase.split()[0] for phrase in unsupported_by_sitl(dumped)] == ["dyn_notch_count", "the"]


def test_what_cannot_start_is_one_sentence(ports, tmp_path):
    for binary, sentence in (
        (tmp_path / "none", "there is no Betaflight SITL binary"),
        (FOLDER / "drone.yaml", "is not executable"),
        (script(tmp_path, "exit 3"), "exited with 3"),
    ):
        with pytest.raises(UsageError, match=sentence):
            sitl.Sitl(binary, tmp_path / "scratch")


@pytest.mark.parametrize("name", ["STATE_PORT", "MOTOR_PORT", "RC_PORT"])
def test_a_taken_udp_port_is_named_before_anything_starts(ports, tmp_path, name):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", getattr(udp, name)))
        with pytest.raises(UsageError, match=f"UDP port {getattr(udp, name)}"):
            sitl.Sitl(script(tmp_path, "exit 0"), tmp_path / "scratch")


def test_a_taken_msp_port_and_one_that_never_opens(ports, tmp_path, monkeypatch):
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


def test_another_firmware_is_named(ports, tmp_path, monkeypatch):
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


def test_the_firmware_ends_with_who_started_it_even_when_that_is_killed(tmp_path):
    told = tmp_path / "pid"
    binary = script(tmp_path, f"echo $$ > {told}.part; mv {told}.part {told}; exec sleep 3600")
    imports = "import time\nfrom swift_sim_bridge.flight_controller.sitl.program import Program\n"
    code = f"{imports}Program({str(binary)!r}, {str(tmp_path)!r}).start()\ntime.sleep(3600)"
    parent = subprocess.Popen([sys.executable, "-c", code])
    wait_for(told.exists)
    child = f"/proc/{told.read_text().strip()}"
    assert os.path.exists(child)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    wait_for(lambda: not os.path.exists(child), "the firmware outlives who started it")


def test_the_command_asks_for_the_binary(capsys):
    chosen = ["--flight-controller", "sitl"]
    for wrong in (chosen, ["--sitl", "/x"], [*chosen, "--sitl", "/none"]):
        for command in ("race", "sim"):
            assert cli.main([command, *wrong]) == 2
    assert "needs --sitl PATH" in capsys.readouterr().err


class Port:
    """The port in front of a firmware that a story plays itself."""

    def __init__(self, vehicle):
        still = Readings(np.array([0, 0, 0, 1.0]), np.zeros(3), 16.0, 5.0, 36.0, np.full(4, 0.25), np.full(4, 500.0))
        self.controller = sitl_port.SitlController(shipped(), vehicle, still)
        with socket.create_server(("127.0.0.1", 0)) as listener:
            theirs = socket.create_connection(listener.getsockname())
            self.firmware, _ = listener.accept()
        self.server = sitl_port.SitlProxy(self.controller, 0, theirs)
        self.client = socket.create_connection(("127.0.0.1", int(self.server.name.rsplit(":", 1)[1])))
        for end in (self.client, self.firmware):
            end.settimeout(PATIENCE_S)

    def close(self):
        self.client.close()
        self.server.close()
        self.firmware.close()


@pytest.fixture
def port(vehicle):
    port = Port(vehicle)
    yield port
    port.close()


def codes(data):
    return [message.code for message in msp.Parser().feed(data)]


def test_the_port_answers_for_meters_and_motors_and_passes_on_the_rest_in_order(port):
    port.client.sendall(request(STATUS_EX) + request(BATTERY_STATE) + request(MOTOR))
    assert codes(port.firmware.recv(4096).replace(b"<", b">")) == [STATUS_EX]
    port.client.settimeout(0.1)
    with pytest.raises(TimeoutError):
        port.client.recv(4096)  # the later answers wait for the first
    port.firmware.sendall(msp.encode(msp.Message(STATUS_EX, b"\x01\x02", version=1)))
    port.client.settimeout(PATIENCE_S)
    said = b""
    while len(codes(said)) < 3:
        said += port.client.recv(4096)
    status, battery, motors = msp.Parser().feed(said)
    assert (status.code, status.payload) == (STATUS_EX, b"\x01\x02")
    assert struct.unpack_from("<BHBH", battery.payload)[3] == 10  # mAh drawn
    assert struct.unpack_from("<4H", motors.payload) == (1251,) * 4


def test_sticks_are_counted_passed_on_and_answered_at_once_and_repeated_while_time_stands(port):
    before = port.controller.commands_sha256
    port.client.sendall(sticks(arm=2000))
    assert codes(port.client.recv(4096)) == [SET_RAW_RC]
    assert port.controller.frames == 1 and port.controller.commands_sha256 != before
    assert port.firmware.recv(len(sticks())) == sticks(arm=2000)
    assert port.firmware.recv(len(sticks())) == sticks(arm=2000)  # again, unasked
    assert port.controller.frames == 1
    for _ in range(5):
        port.controller.update(0, port.controller.readings)
    port.firmware.settimeout(4 * sitl_port.REPEAT_S)
    with pytest.raises(TimeoutError):
        while True:  # what was under way, then nothing: time goes on, and silence is the client's
            port.firmware.recv(4096)
    assert port.controller.arming.armed


class WallClockFirmware:
    """Answers every state with the same motors."""

    stepped = False
    states = 0

    def exchange(self, *_):
        self.states += 1
        return np.full(4, 0.3)


def test_without_gyro_sync_steps_keep_to_the_wall_clock_and_lateness_is_made_up_for(monkeypatch, vehicle):
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
    assert flight.drift_s == pytest.approx(0.498 - 14 * 0.4e-3)  # a little sooner than they last
    assert flight.sitl.states == 20


def test_a_program_knows_how_its_child_died(tmp_path):
    program = Program(script(tmp_path, "kill -9 $$"), tmp_path)
    program.start()
    with pytest.raises(UsageError, match="killed by SIGKILL"):
        program.await_end()
        program.check()
