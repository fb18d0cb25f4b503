"""The gate_detector node answers every image with one message, in order, also when it cannot read the image."""

import time

import numpy as np
import pytest
import rclpy
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor

from swift_ros import messages
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.nodes.gate_detector import GateDetectorNode
from swift_ros.types import Odometry
from swift_sim_bridge.gate_detector import report
from swift_sim_bridge.rendering.renderer import Renderer

MS = 1_000_000
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


class Bench:
    """The node in lockstep, and a peer that feeds it and keeps its answers."""

    def __init__(self, repository):
        rclpy.init(args=["--ros-args", "-p", "use_sim_time:=true", "-p", f"config:={repository / 'config'}"])
        self.node = GateDetectorNode()
        self.peer = rclpy.create_node("peer", use_global_arguments=False)
        self.answers = []
        self._images, self._odometry = (self._speak(name) for name in ("camera/image_raw", "vio/odometry"))
        topic = TOPICS["gates/detections"]
        kind = messages.message_type(topic.type)
        self.peer.create_subscription(kind, topic.name, self.answers.append, qos_profile(topic, True))
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self.until(lambda: self._images.get_subscription_count() and self._odometry.get_subscription_count())

    def _speak(self, name):
        return self.peer.create_publisher(
            messages.message_type(TOPICS[name].type), name, qos_profile(TOPICS[name], True)
        )

    def see(self, image, stamp_ms):
        self._images.publish(messages.to_image(image, stamp_ms * MS))

    def move(self, stamp_ms):
        state = Odometry(stamp_ms * MS, np.zeros(3), LEVEL, np.zeros(3), np.zeros(3))
        self._odometry.publish(messages.to_odometry(state, "odom"))

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"it did not happen; {len(self.answers)} answers came"
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)

    def close(self):
        self.node.destroy_node()
        self.peer.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def bench(repository):
    bench = Bench(repository)
    yield bench
    bench.close()


def test_every_image_is_answered_once_and_in_order(bench, repository):
    stage = report.load(repository / "config")
    renderer = Renderer(stage.camera, stage.track, stage.looks, 1001)
    gate = stage.track.positions[0]
    seen = renderer.render(gate - [5.0, 0.4, 0.3], LEVEL, np.zeros(3), np.zeros(3))
    stamps = [0, 40, 70, 100]
    images = (seen, np.zeros((384, 384), np.uint8), np.zeros((10, 10), np.uint8), seen)
    for stamp, image in zip(stamps, images, strict=True):
        bench.see(image, stamp)
    bench.move(0)
    bench.until(lambda: len(bench.answers) >= 1)
    bench.spin(0.5)
    assert len(bench.answers) == 1  # the others wait for odometry of their stamps
    for stamp in (50, 100):
        bench.move(stamp)
    bench.until(lambda: len(bench.answers) >= 4)
    bench.spin(0.5)
    assert [messages.stamp_ns(answer.header.stamp) // MS for answer in bench.answers] == stamps
    found = [len(answer.gates) for answer in bench.answers]
    assert found[0] >= 1 and found[1:3] == [0, 0] and found[3] == found[0]
    assert {answer.header.frame_id for answer in bench.answers} == {"camera_optical"}
