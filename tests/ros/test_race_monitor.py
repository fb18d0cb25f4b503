"""The race monitor on a real graph: services, latched status, the judge's sign of life, markers, diagnostics."""

import json
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from swift_msgs.msg import BetaflightLink
from swift_ros import messages
from swift_ros.graph.topic_table import SERVICES, TOPICS
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
        self._voices, self._link = {}, None
        self.clients = {name: self.tester.create_client(Trigger, name) for name in SERVICES}

    def voice(self, name):
        """Return what publishes on a topic, once it is heard."""
        if name not in self._voices:
            kind, there = messages.message_type(TOPICS[name].type), quality(TOPICS[name], self.lockstep)
            self._voices[name] = self.tester.create_publisher(kind, name, there)
            self.until(lambda: self._voices[name].get_subscription_count() > 0)
        return self._voices[name]

    def publish(self, name, message):
        self.voice(name).publish(message)

    def keep_publishing(self, name, period_s, message):
        """Publish what `message()` returns again and again; return the timer."""
        voice = self.voice(name)
        return self.tester.create_timer(period_s, lambda: voice.publish(message()))

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"it did not happen; heard {[(k, len(v)) for k, v in self.heard.items()]}"
            self.executor.spin_once(timeout_sec=0.02)

    def ask(self, name):
        self.until(self.clients[name].service_is_ready)
        answer = self.clients[name].call_async(Trigger.Request())
        self.until(answer.done)
        return answer.result()

    def refusal(self, name, why):
        """Ask until it is refused for this reason: what was said before may still be under way."""
        self.until(lambda: why in self.ask(name).message)

    def granted(self, name):
        """Ask until it is granted."""
        self.until(lambda: self.ask(name).success)

    def link(self, **fields):
        """Say this on betaflight/link, again and again: an old word of it counts for nothing."""
        if self._link is None:
            self.keep_publishing("betaflight/link", 0.02, self._link_message)
        self._link = fields

    def _link_message(self):
        message = BetaflightLink(**self._link)
        message.header.stamp = self.tester.get_clock().now().to_msg()
        return message

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
    g = graph(nodes=["betaflight"], arm_timeout_s=60.0)
    g.until(lambda: g.states() == ["idle"])  # latched: heard although it was said before
    assert "betaflight/link" in g.ask("race/arm").message
    g.link(arming_blocks=["BOOT_GRACE_TIME"])
    g.refusal("race/arm", "BOOT_GRACE_TIME")
    g.link()
    g.granted("race/arm")
    g.refusal("race/start", "has not armed yet")
    g.link(armed=True)
    g.granted("race/start")
    assert g.ask("race/stop").success
    g.until(lambda: g.states() == ["idle", "armed", "racing", "stopped"])
    assert not g.ask("race/stop").success


def test_in_lockstep_a_race_starts_itself_at_announced_stamps_and_is_judged_to_its_crash(graph):
    g = graph(nodes=["betaflight"], use_sim_time=True, auto_arm_s=0.5, auto_start_s=0.5, stall_s=60.0)
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
    odometry = g.keep_publishing("vio/odometry", 0.01, lambda: pose(1, [0, 0, 1]))
    g.granted("race/arm")
    assert g.ask("race/start").success
    odometry.cancel()
    g.until(lambda: g.states()[-1:] == ["lost"])
    assert g.heard["race/status"][-1].text == "vio fell silent: nothing on vio/odometry"


def test_who_started_the_nodes_may_say_that_one_died(graph):
    g = graph(nodes=["betaflight"])
    g.link(armed=True)
    g.granted("race/arm")
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name=RUNNER, message="recorder was killed by SIGKILL")
    g.keep_publishing("/diagnostics", 0.05, lambda: DiagnosticArray(status=[status]))
    g.until(lambda: g.states()[-1:] == ["lost"])
    assert g.heard["race/status"][-1].text == "recorder was killed by SIGKILL"


def test_arming_needs_everybody_and_a_second_speaker_of_commands_is_an_error_by_name(graph):
    g = graph(nodes=["policy", "betaflight"])
    g.link()
    g.refusal("race/arm", "nothing was heard yet on policy/step, command/body_rate_thrust;")
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
    late_ms, spoken_s = 60_000, []

    def late_pose():
        spoken_s.append(time.monotonic())
        return pose(time.time_ns() - late_ms * 1_000_000, [0, 0, 1])

    def told(key):
        rows = [s for m in g.heard["/diagnostics"] for s in m.status if s.name == "topic vio/odometry"]
        return next((float(pair.value) for pair in rows[-1].values if pair.key == key), np.nan) if rows else np.nan

    g.keep_publishing("vio/odometry", 0.05, late_pose)
    begun_s = time.monotonic()
    g.until(lambda: told("rate_hz") == pytest.approx(len(spoken_s) / (time.monotonic() - begun_s), rel=0.3))
    assert late_ms <= told("latency_p50_ms") < late_ms + 1e3 * (time.monotonic() - begun_s)
