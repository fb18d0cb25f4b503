"""The topic monitor: rates, latencies, silent topics and the node at fault."""

import pytest

from swift_ros.graph.topic_health import MIN_SILENT_CHECKS, TopicMonitor
from swift_ros.graph.topic_table import NODES, TOPICS

FLYING = ("bridge", "vio", "gate_detector", "gate_pose", "state_estimator", "policy", "betaflight")
CHAIN = ("vio/raw", "vio/odometry", "state/odometry", "policy/step", "command/body_rate_thrust", "betaflight/link")
IMAGE_CHAIN = ("camera/image_raw", "gates/detections", "gates/poses")


class Flight:
    """Feeds a monitor with the messages of a healthy graph, tick by tick; nodes in `without` publish nothing."""

    def __init__(self):
        self.monitor, self.tick, self.image_ns = TopicMonitor(FLYING), 0, None

    def fly(self, ticks, without=(), latency_ms=1.0):
        dead = [topic for node in without for topic in NODES[node].publishes]
        for _ in range(ticks):
            stamp, self.tick = self.tick * 10_000_000, self.tick + 1
            topics = [*(IMAGE_CHAIN if self.tick % 3 == 0 else ()), *CHAIN]
            for topic in topics:
                blocked = topic in dead or self._needs(topic, dead)
                if not blocked:
                    now = stamp + round(1e6 * latency_ms)
                    self.monitor.record(topic, stamp, now, 1e-9 * now)
            self.monitor.count_check()
        return self.tick * 10_000_000

    def _needs(self, topic, dead):
        chain = IMAGE_CHAIN if topic in IMAGE_CHAIN else CHAIN
        return any(earlier in dead for earlier in chain[: chain.index(topic)])


def test_a_healthy_graph_has_its_rates_and_latencies_and_no_missing_topic():
    flight = Flight()
    now = flight.fly(300, latency_ms=2.5)
    health = {row.topic: row for row in flight.monitor.health(now, racing=True)}
    assert health["state/odometry"].rate_hz == pytest.approx(100, rel=0.02)
    assert health["camera/image_raw"].rate_hz == pytest.approx(33, rel=0.05)
    assert health["state/odometry"].latency_p99_ms == pytest.approx(2.5)
    assert all(row.level == "ok" for row in health.values() if row.topic in CHAIN + IMAGE_CHAIN)
    assert flight.monitor.silent_topics(now) == [] and flight.monitor.topics_not_received() == []


@pytest.mark.parametrize("victim", ["vio", "gate_detector", "gate_pose", "state_estimator", "policy", "betaflight"])
def test_a_dead_node_is_at_fault_and_not_the_nodes_that_wait_for_it(victim):
    flight = Flight()
    flight.fly(100)
    now = flight.fly(40, without=[victim])
    silent = flight.monitor.silent_topics(now)
    assert set(silent) & set(NODES[victim].publishes)
    assert flight.monitor.node_at_fault(now, 1e-9 * now) == victim


def test_a_silent_source_is_at_fault_when_every_other_node_has_answered():
    flight = Flight()
    now = flight.fly(100)
    now = flight.fly(50, without=["bridge"])
    assert flight.monitor.node_at_fault(now, 1e-9 * now) == "bridge"


def test_a_detector_that_still_processes_an_image_is_not_at_fault():
    flight = Flight()
    now = flight.fly(100)
    flight.monitor.record("camera/image_raw", now, now, 1e-9 * now)
    for _ in range(4):
        now = flight.fly(2, without=["policy"])
    assert flight.monitor.node_at_fault(now, 1e-9 * now) == "policy"


def test_a_delayed_monitor_reads_its_queues_before_it_reports_silence():
    flight = Flight()
    now = flight.fly(100) + 10**9
    flight.monitor.count_check()
    assert flight.monitor.silent_topics(now) == []
    for _ in range(MIN_SILENT_CHECKS):
        flight.monitor.count_check()
    assert "vio/odometry" in flight.monitor.silent_topics(now)


def test_topics_without_a_message_are_listed_before_the_race_and_slow_topics_get_a_warning():
    flight = Flight()
    missing = flight.monitor.topics_not_received()
    assert "gates/detections" in missing and "battery" not in missing
    for tick in range(200):
        flight.monitor.record("state/odometry", tick * 20_000_000, tick * 20_000_000, tick * 0.02)
    health = {row.topic: row for row in flight.monitor.health(200 * 20_000_000, racing=True)}
    assert (health["state/odometry"].level, health["state/odometry"].text) == ("warn", "50 Hz instead of 100")
    assert (health["gates/poses"].level, health["gates/poses"].text) == ("error", "no message received")
    assert TOPICS["gates/poses"].rate_hz == 30
