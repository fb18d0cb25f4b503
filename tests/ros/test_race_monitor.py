"""The race monitor in a real graph: services, latched status, race/judged, markers, diagnostics."""

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

from swift_msgs.msg import BetaflightLink, RaceStatus
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import SERVICES, TOPICS
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.nodes.race_monitor import RUNNER, RaceMonitorNode
from swift_ros.race.judge import RaceEvent
from swift_ros.types import Odometry

TICK_NS = 10_000_000
RECEIVED = ("race/status", "race/judged", "track/markers", "/diagnostics")


class Graph:
    """The monitor, and a tester that publishes for all other nodes, in one process."""

    def __init__(self, **parameters):
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
        rclpy.init(args=["--ros-args", *given])
        self.lockstep = parameters.get("use_sim_time", False)
        self.monitor = RaceMonitorNode()
        self.tester = rclpy.create_node("tester")
        self.executor = SingleThreadedExecutor()
        for node in (self.monitor, self.tester):
            self.executor.add_node(node)
        self.received = {name: [] for name in RECEIVED}
        for name in RECEIVED:
            kind = message_type(TOPICS[name].type)
            self.tester.create_subscription(
                kind, name, self.received[name].append, qos_profile(TOPICS[name], self.lockstep)
            )
        self._publishers, self._link = {}, None
        self.clients = {name: self.tester.create_client(Trigger, name) for name in SERVICES}

    def publisher(self, name):
        """Return a publisher that the monitor has discovered."""
        if name not in self._publishers:
            kind, profile = message_type(TOPICS[name].type), qos_profile(TOPICS[name], self.lockstep)
            self._publishers[name] = self.tester.create_publisher(kind, name, profile)
            self.until(lambda: self._publishers[name].get_subscription_count() > 0)
        return self._publishers[name]

    def publish(self, name, message):
        self.publisher(name).publish(message)

    def keep_publishing(self, name, period_s, message):
        """Publish what `message()` returns periodically; return the timer."""
        publisher = self.publisher(name)
        return self.tester.create_timer(period_s, lambda: publisher.publish(message()))

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            counts = {name: len(collected) for name, collected in self.received.items()}
            assert time.monotonic() < end, f"the condition did not become true; received {counts}"
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, name):
        self.until(self.clients[name].service_is_ready)
        answer = self.clients[name].call_async(Trigger.Request())
        self.until(answer.done)
        return answer.result()

    def refusal(self, name, why):
        """Call a service until it is refused for this reason: earlier messages may still be in transit."""
        self.until(lambda: why in self.call(name).message)

    def granted(self, name):
        """Call a service until it succeeds."""
        self.until(lambda: self.call(name).success)

    def link(self, **fields):
        """Publish these fields on betaflight/link periodically: stale messages do not count."""
        if self._link is None:
            self.keep_publishing("betaflight/link", 0.02, self._link_message)
        self._link = fields

    def _link_message(self):
        message = BetaflightLink(**self._link)
        message.header.stamp = self.tester.get_clock().now().to_msg()
        return message

    def states(self):
        return [message.state for message in self.received["race/status"]]

    def progress_ns(self):
        return from_time(self.received["race/judged"][-1].stamp) if self.received["race/judged"] else None

    def close(self):
        self.executor.shutdown()
        self.monitor.destroy_node()
        self.tester.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def graph():
    graphs = []

    def make(**parameters):
        graphs.append(Graph(**parameters))
        return graphs[-1]

    yield make
    for each in graphs:
        each.close()


def pose(stamp_ns, p):
    still = np.zeros(3)
    return to_odometry(Odometry(stamp_ns, np.array(p), np.array([0, 0, 0, 1.0]), still, still), "map")


def test_a_manual_race_is_refused_armed_started_and_stopped(graph):
    g = graph(nodes=["betaflight"], arm_timeout_s=60.0)
    g.until(lambda: g.states() == ["idle"])  # latched: received although it was published before
    assert "betaflight/link" in g.call("race/arm").message
    g.link(arming_blocks=["BOOT_GRACE_TIME"])
    g.refusal("race/arm", "BOOT_GRACE_TIME")
    g.link()
    g.granted("race/arm")
    g.refusal("race/start", "has not armed yet")
    g.link(armed=True)
    g.granted("race/start")
    assert g.call("race/stop").success
    g.until(lambda: g.states() == ["idle", "armed", "racing", "stopped"])
    assert "motors stopped" in g.call("race/stop").message
    g.until(lambda: g.states()[-1] == "idle")
    assert not g.call("race/stop").success


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_late_subscriber_receives_the_last_state_alone_and_present_ones_miss_none_of_a_burst(graph, lockstep):
    g = graph(nodes=["betaflight"], use_sim_time=lockstep)
    g.until(lambda: g.states() == ["idle"])
    states = [f"state {number}" for number in range(8)]
    g.monitor._publish([RaceEvent(0, state) for state in states])
    g.until(lambda: len(g.states()) > len(states))
    assert g.states() == ["idle", *states]
    late = []
    profile = qos_profile(TOPICS["race/status"], False)
    g.tester.create_subscription(RaceStatus, "race/status", late.append, profile)
    g.until(lambda: late)
    g.monitor._publish([RaceEvent(0, "last")])
    g.until(lambda: late[-1].state == "last")
    assert [message.state for message in late] == [states[-1], "last"]


def test_in_lockstep_a_race_starts_at_the_announced_stamps_and_is_judged_until_the_crash(graph):
    g = graph(nodes=["betaflight"], use_sim_time=True, auto_arm_s=0.5, auto_start_s=0.5, stall_s=60.0)
    g.until(lambda: g.states() == ["idle"])  # discovered: of latched states only the last one is sent again
    armed, start = False, None
    for tick in range(260):
        stamp = tick * TICK_NS
        g.publish("/clock", Clock(clock=to_time(stamp)))
        flying = [0.0, 0.0, max(1.2 - 0.02 * max(0, tick - 200), 0.0)]
        g.publish("ground_truth/odometry", pose(stamp, flying))
        for status in g.received["race/status"]:
            announced = from_time(status.header.stamp)
            armed = armed or status.state == "armed" and announced <= stamp
            start = announced if status.state == "racing" else start
        message = BetaflightLink(armed=armed)
        message.command_stamp = to_time(stamp)
        g.publish("betaflight/link", message)
        g.until(lambda stamp=stamp: g.progress_ns() == stamp)
    assert g.states() == ["idle", "armed", "racing", "crashed"]
    stamps = [from_time(message.header.stamp) for message in g.received["race/status"]]
    assert stamps[1:3] == [700_000_000, 1_700_000_000] and start == stamps[2]
    assert g.received["race/status"][-1].text == "touched the ground"


def test_a_silent_node_ends_the_race_and_is_named(graph):
    g = graph(nodes=["vio", "betaflight"])
    g.link(armed=True)
    odometry = g.keep_publishing("vio/odometry", 0.01, lambda: pose(1, [0, 0, 1]))
    g.granted("race/arm")
    assert g.call("race/start").success
    odometry.cancel()
    g.until(lambda: g.states()[-1:] == ["lost"])
    assert g.received["race/status"][-1].text == "vio is silent: no message on vio/odometry"


def test_a_dead_node_reported_by_the_runner_ends_the_race(graph):
    g = graph(nodes=["betaflight"])
    g.link(armed=True)
    g.granted("race/arm")
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name=RUNNER, message="recorder was killed by SIGKILL")
    g.keep_publishing("/diagnostics", 0.05, lambda: DiagnosticArray(status=[status]))
    g.until(lambda: g.states()[-1:] == ["lost"])
    assert g.received["race/status"][-1].text == "recorder was killed by SIGKILL"


def test_arming_needs_all_topics_and_a_second_publisher_of_commands_is_an_error_that_names_it(graph):
    g = graph(nodes=["policy", "betaflight"])
    g.link()
    g.refusal("race/arm", "no message received on policy/step, command/body_rate_thrust;")
    intruder, name = rclpy.create_node("intruder"), "command/body_rate_thrust"
    for node in (g.tester, intruder):
        node.create_publisher(message_type(TOPICS[name].type), name, 10)
    g.until(lambda: any("intruder, tester" in s.message for m in g.received["/diagnostics"] for s in m.status))
    found = [s for m in g.received["/diagnostics"] for s in m.status if "intruder" in s.message]
    assert found[0].level == DiagnosticStatus.ERROR
    intruder.destroy_node()


def test_diagnostics_hold_the_rates_and_markers_hold_the_gates(graph):
    g = graph(nodes=["vio"])
    g.until(lambda: g.received["track/markers"])
    assert len(g.received["track/markers"][0].markers) == 3 * len(g.monitor.track.gates)
    late_ms, published_s = 60_000, []

    def late_pose():
        published_s.append(time.monotonic())
        return pose(time.time_ns() - late_ms * 1_000_000, [0, 0, 1])

    def reported(key):
        rows = [s for m in g.received["/diagnostics"] for s in m.status if s.name == "topic vio/odometry"]
        return next((float(pair.value) for pair in rows[-1].values if pair.key == key), np.nan) if rows else np.nan

    g.keep_publishing("vio/odometry", 0.05, late_pose)
    begun_s = time.monotonic()
    g.until(lambda: reported("rate_hz") == pytest.approx(len(published_s) / (time.monotonic() - begun_s), rel=0.3))
    assert late_ms <= reported("latency_p50_ms") < late_ms + 1e3 * (time.monotonic() - begun_s)
