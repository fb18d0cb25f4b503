"""The race monitor on a real graph: services, latched status, the judge's sign of life, markers, diagnostics."""

import json
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from swift_msgs.msg import BetaflightLink
from swift_ros import messages
from swift_ros.graph import SERVICES, TOPICS
from swift_ros.nodes.race_monitor import RUNNER, RaceMonitorNode
from swift_ros.nodes.shell import quality
from swift_ros.types import Odometry

TICK_NS = 10_000_000
HEARD = ("race/status", "race/judged", "track/markers", "/diagnostics")


class Graph:
    """The monitor and a tester that speaks for all other nodes, in one process."""

    def __init__(self, **parameters):
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
        rclpy.init(args=["--ros-args", *given])
        self.lockstep = parameters.get("use_sim_time", False)
        self.monitor = RaceMonitorNode()
        self.tester = rclpy.create_node("tester")
        self.executor = SingleThreadedExecutor()
        for node in (self.monitor, self.tester):
            self.executor.add_node(node)
        self.heard = {name: [] for name in HEARD}
        for name in HEARD:
            kind = messages.message_type(TOPICS[name].type)
            self.tester.create_subscription(kind, name, self.heard[name].append, quality(TOPICS[name], self.lockstep))
        self._voices = {}
        self.clients = {name: self.tester.create_client(Trigger, name) for name in SERVICES}

    def publish(self, name, message):
        if name not in self._voices:
            kind, there = messages.message_type(TOPICS[name].type), quality(TOPICS[name], self.lockstep)
            self._voices[name] = self.tester.create_publisher(kind, name, there)
            self.until(lambda: self._voices[name].get_subscription_count() > 0)
        self._voices[name].publish(message)

    def until(self, condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"it did not happen; heard {[(k, len(v)) for k, v in self.heard.items()]}"
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end, seconds + 1)

    def ask(self, name):
        self.until(self.clients[name].service_is_ready)
        answer = self.clients[name].call_async(Trigger.Request())
        self.until(answer.done)
        return answer.result()

    def link(self, **fields):
        message = BetaflightLink(**fields)
        message.header.stamp = self.tester.get_clock().now().to_msg()
        self.publish("betaflight/link", message)

    def states(self):
        return [message.state for message in self.heard["race/status"]]

    def judged_ns(self):
        return messages.stamp_ns(self.heard["race/judged"][-1].stamp) if self.heard["race/judged"] else None

    def close(self):
        self.executor.shutdown()
        self.monitor.destroy_node()
        self.tester.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def graph():
    made = []

    def make(**parameters):
        made.append(Graph(**parameters))
        return made[-1]

    yield make
    for each in made:
        each.close()


def pose(stamp_ns, p):
    still = np.zeros(3)
    return messages.to_odometry(Odometry(stamp_ns, np.array(p), np.array([0, 0, 0, 1.0]), still, still), "map")


def test_a_race_by_hand_is_refused_armed_started_and_stopped(graph):
    g = graph(nodes=["betaflight"])
    g.until(lambda: g.states() == ["idle"])  # latched: heard although it was said before
    assert "betaflight/link" in g.ask("race/arm").message
    g.link(arming_blocks=["BOOT_GRACE_TIME"])
    g.spin(0.1)
    refusal = g.ask("race/arm")
    assert not refusal.success and "BOOT_GRACE_TIME" in refusal.message
    g.link()
    g.spin(0.1)
    assert g.ask("race/arm").success
    assert "has not armed yet" in g.ask("race/start").message
    g.link(armed=True)
    g.spin(0.05)
    assert g.ask("race/start").success
    g.link(armed=True)
    assert g.ask("race/stop").success
    g.until(lambda: g.states() == ["idle", "armed", "racing", "stopped"])
    assert not g.ask("race/stop").success


def test_in_lockstep_a_race_starts_itself_at_announced_stamps_and_is_judged_to_its_crash(graph):
    g = graph(nodes=["betaflight"], use_sim_time=True, auto_arm_s=0.5, auto_start_s=0.5)
    armed, start = False, None
    for tick in range(260):
        stamp = tick * TICK_NS
        g.publish("/clock", Clock(clock=messages.to_time(stamp)))
        flying = [0.0, 0.0, max(1.2 - 0.02 * max(0, tick - 200), 0.0)]
        g.publish("ground_truth/odometry", pose(stamp, flying))
        for status in g.heard["race/status"]:
            announced = messages.stamp_ns(status.header.stamp)
            armed = armed or status.state == "armed" and announced <= stamp
            start = announced if status.state == "racing" else start
        message = BetaflightLink(armed=armed)
        message.command_stamp = messages.to_time(stamp)
        g.publish("betaflight/link", message)
        g.until(lambda stamp=stamp: g.judged_ns() == stamp)
    assert g.states() == ["idle", "armed", "racing", "crashed"]
    stamps = [messages.stamp_ns(message.header.stamp) for message in g.heard["race/status"]]
    assert stamps[1:3] == [700_000_000, 1_700_000_000] and start == stamps[2]
    assert g.heard["race/status"][-1].text == "touched the ground"


def test_a_node_that_falls_silent_ends_the_race_and_is_named(graph):
    g = graph(nodes=["vio", "betaflight"])
    g.link(armed=True)
    g.publish("vio/odometry", pose(1, [0, 0, 1]))
    g.tester.create_timer(0.02, lambda: g.link(armed=True))
    odometry = g.tester.create_timer(0.01, lambda: g.publish("vio/odometry", pose(1, [0, 0, 1])))
    g.spin(0.2)
    assert g.ask("race/arm").success and g.ask("race/start").success
    odometry.cancel()
    g.until(lambda: g.states()[-1] == "lost")
    assert g.heard["race/status"][-1].text == "vio fell silent: nothing on vio/odometry"


def test_who_started_the_nodes_may_say_that_one_died(graph):
    g = graph(nodes=["betaflight"])
    g.link(armed=True)
    g.spin(0.1)
    assert g.ask("race/arm").success
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name=RUNNER, message="recorder was killed by SIGKILL")
    g.publish("/diagnostics", DiagnosticArray(status=[status]))
    g.until(lambda: g.states()[-1] == "lost")
    assert g.heard["race/status"][-1].text == "recorder was killed by SIGKILL"


def test_arming_needs_everybody_and_a_second_speaker_of_commands_is_an_error_by_name(graph):
    g = graph(nodes=["policy", "betaflight"])
    g.link()
    g.spin(0.1)
    assert "policy/step, command/body_rate_thrust" in g.ask("race/arm").message
    intruder, name = rclpy.create_node("intruder"), "command/body_rate_thrust"
    for node in (g.tester, intruder):
        node.create_publisher(messages.message_type(TOPICS[name].type), name, 10)
    g.until(lambda: any("intruder, tester" in s.message for m in g.heard["/diagnostics"] for s in m.status))
    found = [s for m in g.heard["/diagnostics"] for s in m.status if "intruder" in s.message]
    assert found[0].level == DiagnosticStatus.ERROR
    intruder.destroy_node()


def test_rates_stand_in_the_diagnostics_and_the_gates_in_the_markers(graph):
    g = graph(nodes=["vio"])
    g.until(lambda: g.heard["track/markers"])
    assert len(g.heard["track/markers"][0].markers) == 3 * len(g.monitor.track.gates)
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        g.publish("vio/odometry", pose(time.time_ns(), [0, 0, 1]))
        g.spin(0.01)
    g.until(lambda: any(s.name == "topic vio/odometry" for s in g.heard["/diagnostics"][-1].status))
    rows = [s for m in g.heard["/diagnostics"] for s in m.status if s.name == "topic vio/odometry"]
    values = {pair.key: float(pair.value) for pair in rows[-1].values}
    assert values["rate_hz"] > 5 and 0 <= values["latency_p50_ms"] < 500
