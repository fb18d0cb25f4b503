"""The betaflight node as a process, against the simulated flight controller on a TCP port and a pseudo-terminal."""

import contextlib
import os
import pty
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from patience import PATIENCE_S, wait_for
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Header

from swift_msgs.msg import RaceStatus
from swift_ros import configuration
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.control import to_command
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.firmware import FlightController, Readings
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings
from swift_sim_bridge.flight_controller.receiver import STICKS

FOLDER = configuration.configuration_folder()
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
SUBSCRIBED = ("betaflight/link", "betaflight/rotors", "battery", "/diagnostics")
ARM = STICKS  # the first switch's channel
MAIN = [sys.executable, "-c", "from swift_ros.nodes.betaflight import main; main()"]


class Controller:
    """A simulated flight controller at rest, in real time, on a TCP port or pseudo-terminal."""

    def __init__(self, **changes):
        section = configuration.read_yaml(FOLDER / "simulation.yaml")["flight_controller"]
        section |= {"grace_s": 0.3, "calibration_s": 0.1, "failsafe": section["failsafe"] | {"delay_s": 2.0}} | changes
        settings = configuration.build(FirmwareSettings, section, "the test's flight controller")
        vehicle = configuration.load(Vehicle, FOLDER / "drone.yaml")
        rotors = np.full(4, 500.0)
        self.readings = Readings(UPRIGHT, np.zeros(3), 16.4, 5.0, 100.0, rotors / 5000, rotors)
        self.firmware = FlightController(settings, vehicle, self.readings)
        self.setpoint, self.closing = None, False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self._threads = []

    def serve_tcp(self):
        def accept():
            self.connection, _ = self._listener.accept()
            self._serve(self.connection.fileno())

        return self._start(accept)

    def serve_terminal(self):
        master, slave = pty.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        return self._start(lambda: self._serve(master))

    def _start(self, target):
        self._threads.append(threading.Thread(target=target, daemon=True))
        self._threads[-1].start()
        return self

    def _serve(self, descriptor):
        due_s, ticks, connected = time.monotonic(), 0, True
        while not self.closing:
            if select.select([descriptor] * connected, [], [], 0.002)[0]:
                data = os.read(descriptor, 4096)
                connected = bool(data)
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the node may have just ended
                    os.write(descriptor, self.firmware.feed(data) if data else b"")
            if time.monotonic() >= due_s:  # late ticks are not caught up: no byte may wait
                self.setpoint = self.firmware.update(ticks * 10_000_000, self.readings)
                due_s, ticks = time.monotonic() + 0.01, ticks + 1

    def close(self):
        self.closing = True
        self._listener.close()
        for thread in self._threads:
            thread.join(timeout=2.0)


class Graph:
    """The node in its process, and a tester that publishes for the other nodes."""

    def __init__(self, port, **parameters):
        words = [w for name, value in ({"port": port} | parameters).items() for w in ("-p", f"{name}:={value}")]
        self.process = subprocess.Popen([*MAIN, "--ros-args", *words], stderr=subprocess.PIPE, text=True)
        rclpy.init()
        self.tester = rclpy.create_node("tester")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.tester)
        self.received = {name: [] for name in SUBSCRIBED}
        for name, received in self.received.items():
            kind = message_type(TOPICS[name].type)
            self.tester.create_subscription(kind, name, received.append, qos_profile(TOPICS[name], False))
        published = ("command/body_rate_thrust", "state/odometry", "race/judged", "race/status")
        kinds = {name: message_type(TOPICS[name].type) for name in published}
        self.publishers = {
            name: self.tester.create_publisher(kind, name, qos_profile(TOPICS[name], False))
            for name, kind in kinds.items()
        }
        self.alive, self.omega, self.thrust = set(published), np.zeros(3), 0.0
        self.tester.create_timer(0.02, self._pulse)

    def _pulse(self):
        now_ns = time.time_ns()
        if "state/odometry" in self.alive:
            state = Odometry(now_ns, np.zeros(3), UPRIGHT, np.zeros(3), np.zeros(3))
            self.publishers["state/odometry"].publish(to_odometry(state, "map"))
        if "race/judged" in self.alive:
            self.publishers["race/judged"].publish(Header(stamp=to_time(now_ns)))
        if "command/body_rate_thrust" in self.alive:
            command = BodyRateThrust(now_ns, self.thrust, self.omega)
            self.publishers["command/body_rate_thrust"].publish(to_command(command))

    def announce(self, state):
        status = RaceStatus(state=state)
        status.header.stamp = to_time(time.time_ns())
        self.publishers["race/status"].publish(status)

    @property
    def link(self):
        return self.received["betaflight/link"][-1] if self.received["betaflight/link"] else None

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert self.process.poll() is None, self.process.stderr.read()
            assert time.monotonic() < end, f"it did not happen; last link {self.link}"
            self.executor.spin_once(timeout_sec=0.02)

    def race(self):
        self.until(lambda: self.link and not self.link.arming_blocks)
        self.announce("idle")
        self.announce("armed")
        self.until(lambda: self.link.armed)
        self.announce("racing")
        self.until(lambda: "ANGLE" not in self.link.modes)

    def close(self):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.executor.shutdown()
        self.tester.destroy_node()
        rclpy.try_shutdown()


# A busy machine stalls longer than these limits normally allow; tests/unit checks the timeline.
PATIENT = {"silence_s": 1.0, "stale_s": 5.0, "judge_silence_s": 5.0}


@pytest.fixture
def closing():
    things = []
    yield lambda thing: things.append(thing) or thing
    for thing in reversed(things):
        thing.close()


@pytest.mark.parametrize("how", ["serve_tcp", "serve_terminal"])
def test_a_race_over_a_real_port(closing, how):
    controller = closing(getattr(Controller(), how)())
    graph = closing(Graph(controller.port, **PATIENT))
    graph.race()
    graph.thrust, graph.omega = 12.0, np.array([1.0, -2.0, 0.5])
    graph.until(lambda: np.allclose(controller.setpoint.omega_body, graph.omega, atol=0.02))
    link, sent = graph.link, graph.link.frames_sent
    assert link.armed and link.modes == ["ARM"] and link.frames_bad == 0 and link.round_trip_ms > 0
    assert from_time(link.command_stamp) > 0
    graph.until(lambda: graph.link.frames_sent >= sent + 20)
    assert graph.received["battery"][-1].voltage == pytest.approx(16.4, abs=0.02)
    assert graph.received["battery"][-1].current == pytest.approx(-5.0, abs=0.02)
    rotors = graph.received["betaflight/rotors"][-1]
    assert np.allclose(rotors.speed, 500.0, atol=0.1) and np.allclose(rotors.motor, 0.1, atol=0.002)
    graph.announce("finished")
    graph.until(lambda: not graph.link.armed)


def test_messages_of_another_publisher_do_not_steer_and_are_named(closing):
    controller = closing(Controller().serve_tcp())
    graph = closing(Graph(controller.port, **PATIENT))
    graph.race()
    graph.thrust, graph.omega = 12.0, np.array([1.0, -2.0, 0.5])
    graph.until(lambda: np.allclose(controller.setpoint.omega_body, graph.omega, atol=0.02))
    intruder = rclpy.create_node("intruder")
    # Its status is latched: the node of the next test would receive it.
    closing(SimpleNamespace(close=intruder.destroy_node))
    topics = ("command/body_rate_thrust", "state/odometry", "race/status")
    kinds = {name: message_type(TOPICS[name].type) for name in topics}
    publishers = {n: intruder.create_publisher(kind, n, qos_profile(TOPICS[n], False)) for n, kind in kinds.items()}
    graph.until(lambda: all(publisher.get_subscription_count() for publisher in publishers.values()))
    seen = []
    for count in range(300):  # its numbers reach those of the tester, which publishes three times slower
        command = BodyRateThrust(time.time_ns() if count % 2 else 0, 0.0, np.array([-6.0, 0.0, 0.0]))
        publishers["command/body_rate_thrust"].publish(to_command(command))
        upside_down = Odometry(time.time_ns(), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
        publishers["state/odometry"].publish(to_odometry(upside_down, "map"))
        publishers["race/status"].publish(RaceStatus(state="lost"))
        due_s = time.monotonic() + 0.007
        while time.monotonic() < due_s:
            graph.executor.spin_once(timeout_sec=0.001)
        seen.append(controller.setpoint.omega_body[0])
    # Where both have the same number next, a busy machine may send at the other's time, until its period shows it.
    foreign = np.array(seen) < 0.9
    assert foreign.mean() < 0.1 and not foreign[-1]
    assert graph.link.armed and not graph.link.failsafe
    refused = {s.message for m in graph.received["/diagnostics"] for s in m.status if "refused" in s.message}
    assert {name for name in topics for text in refused if name in text and "intruder" in text} == set(topics)


def test_a_silent_source_ends_the_flight_and_is_reported(closing):
    controller = closing(Controller().serve_tcp())
    graph = closing(Graph(controller.port, **PATIENT))
    graph.race()
    graph.alive.discard("state/odometry")
    graph.until(lambda: graph.link.failsafe and "ANGLE" in graph.link.modes)
    graph.until(lambda: not graph.link.armed)
    texts = [status.message for message in graph.received["/diagnostics"] for status in message.status]
    assert any("failsafe: state/odometry is silent" in text for text in texts)


def test_an_orderly_end_stops_the_motors(closing):
    controller = closing(Controller().serve_tcp())
    graph = closing(Graph(controller.port, **PATIENT))
    graph.race()
    graph.process.send_signal(signal.SIGINT)
    assert graph.process.wait(PATIENCE_S) == 0
    wait_for(lambda: not controller.setpoint.armed)
    assert controller.firmware.receiver.channels[ARM] < 1700  # by its switch, not by a lost signal


def test_a_lost_connection_ends_the_node_with_a_sentence(closing):
    controller = closing(Controller().serve_tcp())
    graph = closing(Graph(controller.port, **PATIENT))
    graph.until(lambda: graph.link and not graph.link.arming_blocks)
    controller.connection.shutdown(socket.SHUT_RDWR)
    assert graph.process.wait(PATIENCE_S) == 2
    assert "the link to the flight controller is lost" in graph.process.stderr.read()


def last_log_line(*words) -> tuple[int, str]:
    done = subprocess.run([*MAIN, "--ros-args", *words], capture_output=True, text=True, timeout=PATIENCE_S)
    return done.returncode, done.stderr.strip().splitlines()[-1]


def test_bad_input_is_one_sentence_and_exit_2(closing):
    unused = socket.create_server(("127.0.0.1", 0))
    port = f"tcp://127.0.0.1:{unused.getsockname()[1]}"
    unused.close()
    patience = ("-p", "connect_timeout_s:=0.3")  # no flight controller: waiting would not help
    code, text = last_log_line("-p", f"port:={port}", *patience)
    assert code == 2 and f"no flight controller on {port}: Connection refused" in text
    code, text = last_log_line("-p", "port:=/dev/null", *patience)
    assert code == 2 and "'/dev/null' is not a serial device" in text
    code, text = last_log_line("-p", "port:=udp://here", *patience)
    assert code == 2 and "neither tcp://HOST:PORT nor a serial device" in text
    controller = closing(Controller(modes={"ARM": {"aux": 1, "low_us": 1700, "high_us": 2100}}).serve_tcp())
    code, text = last_log_line("-p", f"port:={controller.port}", "-p", f"connect_timeout_s:={PATIENCE_S}")
    assert code == 2 and "no switch turns ANGLE on" in text
