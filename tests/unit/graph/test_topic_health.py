"""The watchdog: rates and latencies, who fell silent, and whom to blame for it."""

import pytest

from swift_ros.graph.topic_health import BELIEF_LOOKS, Watchdog
from swift_ros.graph.topic_table import NODES, TOPICS

FLYING = ("bridge", "vio", "gate_detector", "gate_pose", "state_estimator", "policy", "betaflight")
CHAIN = ("vio/raw", "vio/odometry", "state/odometry", "policy/step", "command/body_rate_thrust", "betaflight/link")
IMAGE_CHAIN = ("camera/image_raw", "gates/detections", "gates/poses")


class Flight:
    """Plays a healthy graph into a watchdog, tick by tick; `without` names nodes that say nothing from now on."""

    def __init__(self):
        self.dog, self.tick, self.image_ns = Watchdog(FLYING), 0, None

    def fly(self, ticks, without=(), latency_ms=1.0):
        dead = [topic for node in without for topic in NODES[node].publishes]
        for _ in range(ticks):
            stamp, self.tick = self.tick * 10_000_000, self.tick + 1
            topics = [*(IMAGE_CHAIN if self.tick % 3 == 0 else ()), *CHAIN]
            for topic in topics:
                blocked = topic in dead or self._needs(topic, dead)
                if not blocked:
                    now = stamp + round(1e6 * latency_ms)
                    self.dog.hear(topic, stamp, now, 1e-9 * now)
            self.dog.look()
        return self.tick * 10_000_000

    def _needs(self, topic, dead):
        chain = IMAGE_CHAIN if topic in IMAGE_CHAIN else CHAIN
        return any(earlier in dead for earlier in chain[: chain.index(topic)])


def test_a_healthy_graph_has_its_rates_and_latencies_and_misses_nothing():
    flight = Flight()
    now = flight.fly(300, latency_ms=2.5)
    health = {row.topic: row for row in flight.dog.health(now, racing=True)}
    assert health["state/odometry"].rate_hz == pytest.approx(100, rel=0.02)
    assert health["camera/image_raw"].rate_hz == pytest.approx(33, rel=0.05)
    assert health["state/odometry"].latency_p99_ms == pytest.approx(2.5)
    assert all(row.level == "ok" for row in health.values() if row.topic in CHAIN + IMAGE_CHAIN)
    assert flight.dog.silent(now) == [] and flight.dog.unheard() == []


@pytest.mark.parametrize("victim", ["vio", "gate_detector", "gate_pose", "state_estimator", "policy", "betaflight"])
def test_a_dead_node_is_blamed_and_not_those_that_wait_for_it(victim):
    flight = Flight()
    flight.fly(100)
    now = flight.fly(40, without=[victim])
    silent = flight.dog.silent(now)
    assert set(silent) & set(NODES[victim].publishes)
    assert flight.dog.culprit(now, 1e-9 * now) == victim


def test_a_source_that_falls_silent_is_blamed_when_everybody_has_answered():
    flight = Flight()
    now = flight.fly(100)
    now = flight.fly(50, without=["bridge"])
    assert flight.dog.culprit(now, 1e-9 * now) == "bridge"


def test_an_image_in_the_making_is_nobodys_fault():
    flight = Flight()
    now = flight.fly(100)
    flight.dog.hear("camera/image_raw", now, now, 1e-9 * now)
    for _ in range(4):
        now = flight.fly(2, without=["policy"])
    assert flight.dog.culprit(now, 1e-9 * now) == "policy"


def test_a_starved_watchdog_reads_its_queues_before_it_complains():
    flight = Flight()
    now = flight.fly(100) + 10**9
    flight.dog.look()
    assert flight.dog.silent(now) == []
    for _ in range(BELIEF_LOOKS):
        flight.dog.look()
    assert "vio/odometry" in flight.dog.silent(now)


def test_what_was_never_heard_is_named_before_the_race_and_slow_topics_get_a_warning():
    flight = Flight()
    assert "gates/detections" in flight.dog.unheard() and "battery" not in flight.dog.unheard()
    for tick in range(200):
        flight.dog.hear("state/odometry", tick * 20_000_000, tick * 20_000_000, tick * 0.02)
    health = {row.topic: row for row in flight.dog.health(200 * 20_000_000, racing=True)}
    assert (health["state/odometry"].level, health["state/odometry"].text) == ("warn", "50 Hz instead of 100")
    assert (health["gates/poses"].level, health["gates/poses"].text) == ("error", "never heard")
    assert TOPICS["gates/poses"].rate_hz == 30
