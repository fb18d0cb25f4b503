"""The policy node on a real graph: one command for every state, rest before the start, silence on nonsense."""

import time

import numpy as np
import pytest
import rclpy
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor

from swift_msgs.msg import RaceStatus
from swift_ros import geometry, messages
from swift_ros.errors import UsageError
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.nodes.policy import PolicyNode
from swift_ros.types import Odometry

TICK_NS = 10_000_000
ANSWERS = ("command/body_rate_thrust", "policy/step", "/diagnostics")


class Peer:
    """Speaks states and race words to a policy node and keeps its answers."""

    def __init__(self):
        self.node, self.peer = PolicyNode(), rclpy.create_node("peer", use_global_arguments=False)
        self.heard = {name: [] for name in ANSWERS}
        for name, answers in self.heard.items():
            kind = messages.message_type(TOPICS[name].type)
            self.peer.create_subscription(kind, name, answers.append, qos_profile(TOPICS[name], False))
        self.voices = {}
        for name in ("state/odometry", "race/status"):
            kind = messages.message_type(TOPICS[name].type)
            self.voices[name] = self.peer.create_publisher(kind, name, qos_profile(TOPICS[name], False))
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.until(lambda: all(voice.get_subscription_count() for voice in self.voices.values()))
        self.until(lambda: all(self.peer.count_publishers(name) for name in ANSWERS))

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"it did not happen; heard {[(k, len(v)) for k, v in self.heard.items()]}"
            self.executor.spin_once(timeout_sec=0.02)

    def race(self, tick: int, state: str):
        word = RaceStatus(state=state)
        word.header.stamp = messages.to_time(tick * TICK_NS)
        self.voices["race/status"].publish(word)

    def state(self, tick: int, position=(-5.0, 4.5, 1.2)):
        q = geometry.quaternion_from_yaw(np.radians(np.float64(-57.4)))
        odometry = Odometry(tick * TICK_NS, np.array(position), q, np.zeros(3), np.zeros(3))
        self.voices["state/odometry"].publish(messages.to_odometry(odometry, "map"))

    def command(self, count: int):
        """Wait for the `count`-th command and its step; return both."""
        self.until(lambda: all(len(self.heard[name]) >= count for name in ANSWERS[:2]))
        return self.heard[ANSWERS[0]][count - 1], self.heard[ANSWERS[1]][count - 1]


@pytest.fixture
def ros(repository, request):
    given = [word for name, value in getattr(request, "param", {}).items() for word in ("-p", f"{name}:={value}")]
    rclpy.init(args=["--ros-args", "-p", f"config:={repository / 'config'}", *given])
    yield
    rclpy.try_shutdown()


def test_every_state_gets_a_command_which_is_rest_until_the_start(ros):
    there = Peer()
    there.race(0, RaceStatus.ARMED)
    there.race(3, RaceStatus.RACING)  # announced ahead
    for tick in range(1, 5):
        there.state(tick)
        command, step = there.command(tick)
        assert messages.stamp_ns(command.header.stamp) == messages.stamp_ns(step.header.stamp) == tick * TICK_NS
        assert (command.thrust > 1.0) == (tick >= 3)
        assert (step.next_gate, step.lap, command.header.frame_id) == (0, 0, "base_link")
    assert not there.heard["/diagnostics"]


def test_a_state_that_is_not_a_number_gets_no_command_but_a_sentence(ros):
    there = Peer()
    there.state(1, (np.nan, 0.0, 0.0))
    there.until(lambda: there.heard["/diagnostics"])
    [status] = there.heard["/diagnostics"][0].status
    assert status.name == "policy" and "p_world that is not finite" in status.message
    there.state(2)
    command, _ = there.command(1)
    assert messages.stamp_ns(command.header.stamp) == 2 * TICK_NS


@pytest.mark.parametrize("ros", [{"model": "models/none.onnx"}], indirect=True)
def test_a_missing_model_stops_the_node_with_a_sentence(ros):
    with pytest.raises(UsageError, match="models/none.onnx is missing"):
        PolicyNode()
