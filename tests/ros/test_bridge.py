"""The bridge as a process: lockstep with the answers, a limited wait without them, no waiting in real time."""

import hashlib
import itertools
import json
import signal
import socket
import struct
import subprocess
import time

import pytest
import rclpy
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock

from swift_msgs.msg import BetaflightLink
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.runner import command_line, launch_row
from swift_ros.graph.topic_table import NODES, TOPICS
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import from_time, to_time
from swift_sim_bridge.tcp_ports import free_port

TICK_NS = 10_000_000
SILENCE_S = 5.0  # patience of the bridge; longer than a busy machine may delay this test
FRAME_CHANNELS = (1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000)


def raw_rc(channels=FRAME_CHANNELS):
    body = bytes([16, 200]) + struct.pack("<8H", *channels)
    checksum = 0
    for byte in body:
        checksum ^= byte
    return b"$M<" + body + bytes([checksum])


class Betaflight:
    """Replaces the betaflight node: a node of that name with all its topics, and a connection to the MSP port."""

    def __init__(self, lockstep=True):
        rclpy.init()
        self.lockstep, self.clock_ns, self.raw_ns, self.frames = lockstep, [], [], 0
        self.node = rclpy.create_node("betaflight", namespace="swift")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        row = NODES["betaflight"]
        kinds = {name: message_type(TOPICS[name].type) for name in TOPICS}
        depth = {name: qos_profile(TOPICS[name], lockstep) for name in TOPICS}
        self.publishers = {name: self.node.create_publisher(kinds[name], name, depth[name]) for name in row.publishes}
        for name in row.subscribes:
            self.node.create_subscription(kinds[name], name, lambda message: None, depth[name])
        self.node.create_subscription(Clock, "/clock", self._on_clock, depth["/clock"])
        self.node.create_subscription(kinds["vio/raw"], "vio/raw", self._on_raw, depth["vio/raw"])

    def _on_clock(self, message):
        self.clock_ns.append(from_time(message.clock))

    def _on_raw(self, message):
        self.raw_ns.append(from_time(message.header.stamp))

    def connect(self, port):
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                self.connection = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
                return
            except OSError:
                assert time.monotonic() < end, "the bridge opened no port"
                time.sleep(0.1)

    def answer(self, stamp_ns, channels=FRAME_CHANNELS, write=True):
        """Write a frame and report it on betaflight/link; with write=False, report it without writing."""
        self.frames += 1
        if write:
            self.connection.sendall(raw_rc(channels))
        link = BetaflightLink(command_stamp=to_time(stamp_ns), frames_sent=self.frames)
        self.publishers["betaflight/link"].publish(link)

    def spin(self, until, seconds=PATIENCE_S):
        """Spin until a condition holds; return whether it does."""
        end = time.monotonic() + seconds
        while not until() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
        return until()

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def start(tmp_path):
    """Start the bridge as the runner does, without images; `stop` ends it and returns (exit code, report, log)."""
    processes = []

    def start(lockstep=True, **parameters):
        given = {"port": free_port(), "images": False, "report": str(tmp_path / "report.json"), "nodes": ["betaflight"]}
        arguments = launch_row(NODES["bridge"], given | parameters, lockstep=lockstep)
        with open(tmp_path / "log", "wb") as log:
            processes.append(subprocess.Popen(command_line(arguments), stdout=log, stderr=log))
        return (given | parameters)["port"]

    def stop(ask=True):
        if ask:
            processes[0].send_signal(signal.SIGINT)
        code = processes[0].wait(timeout=PATIENCE_S)
        report = tmp_path / "report.json"
        return code, json.loads(report.read_text()) if report.exists() else None, (tmp_path / "log").read_text()

    start.stop = stop
    yield start
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture
def peer(request):
    client = Betaflight(getattr(request, "param", True))
    yield client
    client.close()


def test_time_is_stopped_until_a_tick_is_answered_and_its_frame_has_arrived(peer, start):
    peer.connect(start())
    assert peer.spin(lambda: peer.raw_ns == [0])
    peer.spin(lambda: False, 0.5)
    assert peer.clock_ns == peer.raw_ns == [0]
    for k in range(50):
        peer.answer(k * TICK_NS)
        assert peer.spin(lambda k=k: peer.raw_ns[-1] == (k + 1) * TICK_NS)
    peer.answer(50 * TICK_NS, write=False)
    peer.spin(lambda: False, 1.5)  # longer than FRAMES_PATIENCE_S of the bridge
    assert peer.raw_ns[-1] == 50 * TICK_NS
    peer.connection.sendall(raw_rc())
    assert peer.spin(lambda: peer.raw_ns[-1] == 51 * TICK_NS)
    assert peer.spin(lambda: peer.clock_ns == peer.raw_ns == [k * TICK_NS for k in range(52)])
    code, report, _ = start.stop()
    assert code == 0 and report["ticks"] == 51 and report["contact"] is None
    assert report["thrust_to_weight"][0] == pytest.approx(4.1, abs=0.05)


@pytest.mark.slow
def test_the_same_answers_give_the_same_hashes(peer, start):
    peer.connect(start(seed=1003))
    for k in range(30):
        assert peer.spin(lambda k=k: peer.raw_ns and peer.raw_ns[-1] == k * TICK_NS)
        peer.answer(k * TICK_NS, (1500, 1500, 1000 + k, 1500, 1000, 1000, 1000, 1000))
    assert peer.spin(lambda: peer.raw_ns[-1] == 30 * TICK_NS)
    _, report, _ = start.stop()
    # The hash covers exactly the 30 frames above; it does not depend on times of arrival.
    again = hashlib.sha256()
    for k in range(30):
        again.update(raw_rc((1500, 1500, 1000 + k, 1500, 1000, 1000, 1000, 1000)))
    assert report["msp_sha256"] == again.hexdigest()


def test_without_answers_the_bridge_stops_waiting_and_the_firmware_ends_the_flight(peer, start):
    peer.connect(start(patience_s=SILENCE_S))
    for k in range(580):
        assert peer.spin(lambda k=k: peer.raw_ns and peer.raw_ns[-1] == k * TICK_NS)
        armed = 2000 if k > 560 else 1000
        answered_s = time.monotonic()
        peer.answer(k * TICK_NS, (1500, 1500, 1000, 1500, armed, 1000, 1000, 1000))
    assert peer.spin(lambda: peer.raw_ns[-1] > 660 * TICK_NS)
    assert time.monotonic() - answered_s > SILENCE_S
    peer.connection.recv(1 << 20)
    body = bytes([0, 150])
    peer.connection.sendall(b"$M<" + body + bytes([body[0] ^ body[1]]))
    status = peer.connection.recv(4096)[5:-1]
    assert not status[6] & 1  # disarmed: ARM is the first of the boxes
    _, _, log = start.stop()
    assert "continues without the graph" in log and "betaflight/link does not answer" in log


def test_a_missing_node_is_reported_in_one_sentence(peer, start):
    start(nodes=["betaflight", "vio"], graph_timeout_s=2.0)
    code, _, log = start.stop(ask=False)
    assert code == 2 and "missing: vio" in log.strip().splitlines()[-1]


def test_a_port_in_use_is_reported_in_one_sentence(start):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        start(port=port)
        code, _, log = start.stop(ask=False)
    assert code == 2 and f"port {port} for MSP is not available" in log.strip().splitlines()[-1]


@pytest.mark.parametrize("peer", [False], indirect=True)
def test_in_real_time_nothing_waits_and_stamps_are_of_the_system_clock(peer, start):
    begun_ns = time.time_ns()
    peer.connect(start(lockstep=False))
    assert peer.spin(lambda: len(peer.raw_ns) > 150)
    assert not peer.clock_ns
    assert begun_ns < peer.raw_ns[0] and peer.raw_ns[-1] <= time.time_ns() + TICK_NS  # a tick is flown at its beginning
    steps = [after - before for before, after in itertools.pairwise(peer.raw_ns)]
    assert min(steps) == TICK_NS and not any(step % TICK_NS for step in steps)  # a slow subscriber misses some
    code, report, _ = start.stop()
    assert code == 0 and report["ticks"] > 150
