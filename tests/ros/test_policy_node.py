"""The node policy in a real graph: one command for every state, idle before the start, none for invalid states."""

import shutil
import time

import numpy as np
import pytest
import rclpy
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor

from swift_msgs.msg import RaceStatus
from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.nodes.policy import PolicyNode
from swift_ros.types import Odometry

TICK_NS = 10_000_000
ANSWERS = ("command/body_rate_thrust", "policy/step", "/diagnostics")


class Peer:
    """Publishes states and race status to the node and collects its answers."""

    def __init__(self):
        self.node, self.peer = PolicyNode(), rclpy.create_node("peer", use_global_arguments=False)
        self.received = {name: [] for name in ANSWERS}
        for name, answers in self.received.items():
            kind = message_type(TOPICS[name].type)
            self.peer.create_subscription(kind, name, answers.append, qos_profile(TOPICS[name], False))
        self.publishers = {}
        for name in ("state/odometry", "race/status"):
            kind = message_type(TOPICS[name].type)
            self.publishers[name] = self.peer.create_publisher(kind, name, qos_profile(TOPICS[name], False))
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.until(lambda: all(publisher.get_subscription_count() for publisher in self.publishers.values()))
        self.until(lambda: all(self.peer.count_publishers(name) for name in ANSWERS))

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            counts = {name: len(collected) for name, collected in self.received.items()}
            assert time.monotonic() < end, f"the condition did not become true; received {counts}"
            self.executor.spin_once(timeout_sec=0.02)

    def race(self, tick: int, state: str):
        status = RaceStatus(state=state)
        status.header.stamp = to_time(tick * TICK_NS)
        self.publishers["race/status"].publish(status)

    def state(self, tick: int, position=(-5.0, 4.5, 1.2)):
        q = geometry.quaternion_from_yaw(np.radians(np.float64(-57.4)))
        odometry = Odometry(tick * TICK_NS, np.array(position), q, np.zeros(3), np.zeros(3))
        self.publishers["state/odometry"].publish(to_odometry(odometry, "map"))

    def command(self, count: int):
        """Wait for the `count`-th command and its step and return both."""
        self.until(lambda: all(len(self.received[name]) >= count for name in ANSWERS[:2]))
        return self.received[ANSWERS[0]][count - 1], self.received[ANSWERS[1]][count - 1]


@pytest.fixture
def ros(repository, request):
    given = [word for name, value in getattr(request, "param", {}).items() for word in ("-p", f"{name}:={value}")]
    rclpy.init(args=["--ros-args", "-p", f"config:={repository / 'config'}", *given])
    yield
    rclpy.try_shutdown()


def test_every_state_gets_a_command_which_is_idle_until_the_start(ros):
    peer = Peer()
    peer.race(0, RaceStatus.ARMED)
    peer.race(3, RaceStatus.RACING)  # announced in advance
    for tick in range(1, 5):
        peer.state(tick)
        command, step = peer.command(tick)
        assert from_time(command.header.stamp) == from_time(step.header.stamp) == tick * TICK_NS
        assert (command.thrust > 1.0) == (tick >= 3)
        assert (step.next_gate, step.lap, command.header.frame_id) == (0, 0, "base_link")
    assert not peer.received["/diagnostics"]


def test_an_invalid_state_gets_a_diagnostic_and_no_command(ros):
    peer = Peer()
    peer.state(1, (np.nan, 0.0, 0.0))
    peer.until(lambda: peer.received["/diagnostics"])
    [status] = peer.received["/diagnostics"][0].status
    assert status.name == "policy" and "p_world that is not finite" in status.message
    peer.state(2)
    command, _ = peer.command(1)
    assert from_time(command.header.stamp) == 2 * TICK_NS


def test_a_pilot_of_another_track_is_a_warning_in_the_log(repository, tmp_path, capfd):
    folder = shutil.copytree(repository / "config", tmp_path / "config")
    track = (folder / "track.yaml").read_text()
    (folder / "track.yaml").write_text(track.replace("[9.2, -4.0, 1.2]", "[9.2, -5.0, 1.2]"))
    for config, warned in ((folder, True), (repository / "config", False)):
        rclpy.init(args=["--ros-args", "-p", f"config:={config}"])
        PolicyNode()
        rclpy.try_shutdown()
        sentence = "the pilot was trained for another track: gate 3 is 1.0 m away from where it was"
        assert (sentence in capfd.readouterr().err) == warned


@pytest.mark.parametrize("ros", [{"model": "models/none.onnx"}], indirect=True)
def test_a_missing_model_stops_the_node_with_a_sentence(ros):
    with pytest.raises(UsageError, match="models/none.onnx is missing"):
        PolicyNode()
