"""The node gate_detector publishes one message for every image, in order, also for invalid images."""

import time

import numpy as np
import pytest
import rclpy
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Image

from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.camera import from_image, to_image
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import from_time
from swift_ros.nodes.gate_detector import GateDetectorNode
from swift_ros.types import Odometry
from swift_sim_bridge.gate_detector.evaluation.setup import load_setup
from swift_sim_bridge.rendering.renderer import Renderer

MS = 1_000_000
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


class NodeWithPeer:
    """The node in lockstep, and a peer that publishes its inputs and collects its answers."""

    def __init__(self, repository):
        rclpy.init(args=["--ros-args", "-p", "use_sim_time:=true", "-p", f"config:={repository / 'config'}"])
        self.node = GateDetectorNode()
        self.peer = rclpy.create_node("peer", use_global_arguments=False)
        self.answers = []
        self._images, self._odometry = (self._publisher(name) for name in ("camera/image_raw", "vio/odometry"))
        topic = TOPICS["gates/detections"]
        kind = message_type(topic.type)
        self.peer.create_subscription(kind, topic.name, self.answers.append, qos_profile(topic, True))
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.until(lambda: self._images.get_subscription_count() and self._odometry.get_subscription_count())

    def _publisher(self, name):
        return self.peer.create_publisher(message_type(TOPICS[name].type), name, qos_profile(TOPICS[name], True))

    def send_image(self, image, stamp_ms):
        self._images.publish(to_image(image, stamp_ms * MS))

    def send_odometry(self, stamp_ms):
        state = Odometry(stamp_ms * MS, np.zeros(3), LEVEL, np.zeros(3), np.zeros(3))
        self._odometry.publish(to_odometry(state, "odom"))

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"the condition did not become true; {len(self.answers)} answers received"
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)

    def close(self):
        self.node.destroy_node()
        self.peer.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def peer(repository):
    peer = NodeWithPeer(repository)
    yield peer
    peer.close()


def test_there_is_one_answer_for_every_image_in_order(peer, repository):
    stage = load_setup(repository / "config")
    renderer = Renderer(stage.camera, stage.track, stage.looks, 1001)
    gate = stage.track.positions[0]
    view = renderer.render(gate - [5.0, 0.4, 0.3], LEVEL, np.zeros(3), np.zeros(3))
    stamps = [0, 40, 70, 100]
    images = (view, np.zeros((384, 384), np.uint8), np.zeros((10, 10), np.uint8), view)
    for stamp, image in zip(stamps, images, strict=True):
        peer.send_image(image, stamp)
    peer.send_odometry(0)
    peer.until(lambda: len(peer.answers) >= 1)
    peer.spin(0.5)
    assert len(peer.answers) == 1  # the others wait for odometry with their stamps
    for stamp in (50, 100):
        peer.send_odometry(stamp)
    peer.until(lambda: len(peer.answers) >= 4)
    peer.spin(0.5)
    assert [from_time(answer.header.stamp) // MS for answer in peer.answers] == stamps
    found = [len(answer.gates) for answer in peer.answers]
    assert found[0] >= 1 and found[1:3] == [0, 0] and found[3] == found[0]
    assert {answer.header.frame_id for answer in peer.answers} == {"camera_optical"}


@pytest.mark.parametrize(("encoding", "red"), [("bgr8", 2), ("rgb8", 0)])
def test_a_red_gate_is_bright_and_a_blue_one_dark_in_a_coloured_image(encoding, red):
    """Rows may be padded; another encoding is refused by name."""
    colours = np.zeros((4, 6, 3), np.uint8) + 90
    colours[1:3, 2:4, red] = 150
    colours[1:3, 4, 2 - red] = 150
    padded = np.concatenate([colours.reshape(4, 18), np.zeros((4, 6), np.uint8)], axis=1)
    message = Image(height=4, width=6, encoding=encoding, step=24, data=padded.tobytes())
    grey = from_image(message)
    assert grey.shape == (4, 6) and np.all(grey[1:3, 2:4] == 167) and np.all(grey[1:3, 4] == 47)
    assert np.sum(grey == 77) == 18
    message.encoding = "32FC1"
    with pytest.raises(ValueError, match="has the encoding '32FC1'; publish mono8 or bgr8 or rgb8"):
        from_image(message)
