"""A recorded race is played to a graph that is slower than the recorded one."""

import os
import threading
import time

import numpy as np
import pytest
import rclpy
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from swift_ros.errors import UsageError
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.serialization import serialize
from swift_ros.types import Odometry
from swift_sim_bridge.benchmarks.race_player import SERVICES, RacePlayer, TimedInput

PERIOD_NS = 10_000_000
ARM, START = SERVICES


class SlowGraph:
    """A node whose race/start is refused until some time after race/arm."""

    def __init__(self, domain: int, arms_after_s: float):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("race_monitor", namespace="swift", context=self.context)
        self.arms_after_s, self.armed_s, self.starts = arms_after_s, np.inf, []
        self.node.create_service(Trigger, ARM, self.arm)
        self.node.create_service(Trigger, START, self.start)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin)

    def arm(self, _, answer):
        self.armed_s = time.monotonic() + self.arms_after_s
        return self.answered(answer, True)

    def start(self, _, answer):
        self.starts.append(time.monotonic())
        return self.answered(answer, time.monotonic() > self.armed_s)

    def answered(self, answer, accepted):
        answer.success, answer.message = accepted, "" if accepted else "the flight controller has not armed yet"
        return answer

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.executor.shutdown()
        self.thread.join()
        self.node.destroy_node()
        self.context.try_shutdown()


def race(seconds_before_start: float) -> list[TimedInput]:
    """Return odometry at rest, armed at its first sample, with the start some time later and 2 s more."""
    still, upright = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
    start_ns = round(1e9 * seconds_before_start)
    due = range(0, start_ns + 2_000_000_000, PERIOD_NS)
    rows = [TimedInput(at, serialize(to_odometry(Odometry(at, still, upright, still, still), "odom"))) for at in due]
    rows += [TimedInput(1, service=ARM), TimedInput(start_ns + 1, service=START)]
    return sorted(rows, key=lambda entry: entry.due_ns)


def play(domain: int, arms_after_s: float) -> list[float]:
    """Play the race to a graph; return the times of the calls of race/start, s."""
    with SlowGraph(domain, arms_after_s) as graph:
        player = RacePlayer(domain)
        try:
            for client in player._services.values():
                assert client.wait_for_service(timeout_sec=PATIENCE_S)
            player.play(race(0.2), time.time_ns())
        finally:
            player.close()
            assert os.sched_getscheduler(0) == os.SCHED_OTHER  # the priority over the nodes ends with the play
    return graph.starts


def test_a_start_that_is_refused_because_arming_takes_longer_is_called_again(domain):
    starts = play(domain, arms_after_s=0.5)
    assert len(starts) > 1 and 0.2 < starts[-1] - starts[0] < 1.5


def test_a_start_that_is_refused_for_long_ends_the_play_with_the_reason(domain):
    with pytest.raises(UsageError, match="race/start was refused while the race was played: the flight controller has"):
        play(domain, arms_after_s=60.0)
