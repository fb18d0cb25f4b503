"""The nodes vio, gate_pose, state_estimator and camera in a real graph: their answers and diagnostics."""

import json
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
import rclpy
from patience import PATIENCE_S
from rclpy.executors import SingleThreadedExecutor

from swift_msgs.msg import GateDetections
from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera, project, world_to_camera
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.camera import to_camera_info
from swift_ros.messages.gates import from_gate_poses, incomplete_from_gate_poses, to_detections, to_gate_poses
from swift_ros.messages.motion import from_odometry, to_odometry
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.nodes.camera import CameraNode
from swift_ros.nodes.gate_pose import GatePoseNode
from swift_ros.nodes.state_estimator import StateEstimatorNode
from swift_ros.nodes.vio import VioNode
from swift_ros.perception.gate_pose import GatePoses, GatePoseSettings
from swift_ros.track import Track
from swift_ros.types import GateCorners, Odometry

TICK_NS = 10_000_000


class NodeWithPeer:
    """A node, and a peer that publishes its inputs and collects its answers."""

    def __init__(self, node_type, subscribes, repository, **parameters):
        parameters["config"] = str(repository / "config")
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
        rclpy.init(args=["--ros-args", *given])
        self.lockstep = parameters.get("use_sim_time", False)
        self.peer = rclpy.create_node("peer", use_global_arguments=False)
        self.received = {name: [] for name in (*subscribes, "/diagnostics")}
        for name, collected in self.received.items():
            kind = message_type(TOPICS[name].type)
            self.peer.create_subscription(kind, name, collected.append, qos_profile(TOPICS[name], self.lockstep))
        self.node = node_type()
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.peer)
        self._publishers = {}

    def publish(self, name, message):
        if name not in self._publishers:
            kind = message_type(TOPICS[name].type)
            self._publishers[name] = self.peer.create_publisher(kind, name, qos_profile(TOPICS[name], self.lockstep))
            self.until(lambda: self._publishers[name].get_subscription_count() > 0)
        self._publishers[name].publish(message)

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            counts = {name: len(collected) for name, collected in self.received.items()}
            assert time.monotonic() < end, f"the condition did not become true; received {counts}"
            self.executor.spin_once(timeout_sec=0.02)

    def expect(self, name, count, quiet_s=0.3):
        """Wait until a topic has exactly `count` messages and return them."""
        self.until(lambda: len(self.received[name]) >= count)
        end = time.monotonic() + quiet_s
        self.until(lambda: time.monotonic() > end)
        assert len(self.received[name]) == count
        return self.received[name]

    def diagnostic(self, text):
        """Wait for a diagnostic that contains a text and return its status."""

        def found():
            return [s for message in self.received["/diagnostics"] for s in message.status if text in s.message]

        self.until(found)
        return found()[0]

    def close(self):
        self.peer.destroy_node()
        if hasattr(self.node, "close"):
            self.node.close()
        self.node.destroy_node()
        rclpy.shutdown()


@pytest.fixture
def start_node(repository):
    """Return a function that starts the node of a test."""
    instances = []

    def make(node_type, *subscribes, **parameters):
        instances.append(NodeWithPeer(node_type, subscribes, repository, **parameters))
        return instances[0]

    yield make
    for instance in instances:
        instance.close()


def resting(tick: int, p_world=(-5.0, 4.5, 1.2)) -> Odometry:
    q = geometry.quaternion_from_yaw(np.radians(np.float64(-57.4)))
    return Odometry(tick * TICK_NS, np.array(p_world), q, np.zeros(3), np.zeros(3))


def gate_1_from_the_podium(repository):
    """Return the detection of gate 1 from the podium."""
    camera = configuration.load(Camera, repository / "config" / "camera.yaml")
    track = configuration.load(Track, repository / "config" / "track.yaml")
    state = resting(0)
    corners = world_to_camera(camera, state.p_world, state.q_world_body, track.corners[0])
    return GateCorners(project(camera, corners)[0], np.full(4, 0.8))


def test_vio_converts_a_declared_twist_and_refuses_invalid_odometry(start_node):
    peer = start_node(VioNode, "vio/odometry", velocity_frame="odom")
    truth = resting(0)
    v_odom = np.array([0.3, 0.1, 0.0])
    peer.publish("vio/raw", to_odometry(replace(truth, v_body=v_odom), "t265_odom"))
    [answer] = peer.expect("vio/odometry", 1)
    assert (answer.header.frame_id, answer.child_frame_id) == ("odom", "base_link")
    assert np.allclose(from_odometry(answer).v_body, geometry.rotate_inverse(truth.q_world_body, v_odom))

    peer.publish("vio/raw", to_odometry(resting(1, (np.nan, 0.0, 0.0)), "t265_odom"))
    status = peer.diagnostic("position is not a number")
    assert status.name == "vio"
    peer.publish("vio/raw", to_odometry(resting(2, (0.0, 0.0, 0.0)), "t265_odom"))
    peer.diagnostic("jumped to")
    peer.publish("vio/raw", to_odometry(resting(3), "t265_odom"))
    peer.expect("vio/odometry", 2)


def test_gate_pose_publishes_one_answer_for_every_image(start_node, repository):
    peer = start_node(GatePoseNode, "gates/poses", use_sim_time=True)
    gate = gate_1_from_the_podium(repository)
    invalid = replace(gate, corners_px=np.full((4, 2), np.nan))
    upper = np.array([1.0, 1.0, np.nan, np.nan])
    incomplete = GateCorners(gate.corners_px * upper[:, None], np.nan_to_num(0.8 * upper))
    for tick, gates in enumerate(([gate], [], [invalid, gate])):
        header = GateDetections().header
        header.stamp = to_time(tick * TICK_NS)
        peer.publish("gates/detections", to_detections(header, gates, [incomplete] * tick))
    answers = peer.expect("gates/poses", 3)
    assert [from_time(answer.header.stamp) // TICK_NS for answer in answers] == [0, 1, 2]
    assert [len(answer.gates) for answer in answers] == [1, 0, 1]
    [upper_rays, _] = incomplete_from_gate_poses(answers[2])
    whole_rays = from_gate_poses(answers[2])[0].rays_body
    assert [len(answer.incomplete) for answer in answers] == [0, 1, 2] and upper_rays.confidence == 0.8
    assert np.allclose(upper_rays.rays_body[:2], whole_rays[:2]) and np.isnan(upper_rays.rays_body[2:]).all()
    distance = np.linalg.norm(from_gate_poses(answers[0])[0].p_body)
    assert distance == pytest.approx(np.linalg.norm([3.9, 6.1, 2.4]), abs=0.01)
    assert peer.diagnostic("not a number").name == "gate_pose"


def test_in_lockstep_the_estimator_holds_states_until_the_gates_of_the_image_come(start_node, repository):
    peer = start_node(StateEstimatorNode, "state/odometry", "state/updates", use_sim_time=True)
    camera = configuration.load(Camera, repository / "config" / "camera.yaml")
    track = configuration.load(Track, repository / "config" / "track.yaml")
    content = configuration.read_yaml(repository / "config" / "nodes.yaml")["gate_pose"]
    gate_poses = GatePoses(configuration.build(GatePoseSettings, content, "gate_pose"), camera, track.inner_side)
    peer.publish("camera/camera_info", to_camera_info(camera, 0))
    peer.until(lambda: peer.node._estimator._images)
    for tick in range(8):
        peer.publish("vio/odometry", to_odometry(resting(tick), "odom"))
    peer.expect("state/odometry", 4)
    poses = gate_poses.locate(0, [gate_1_from_the_podium(repository)])[0]
    peer.publish("gates/poses", to_gate_poses(to_time(0), poses))
    states = peer.expect("state/odometry", 8)
    assert [from_time(state.header.stamp) // TICK_NS for state in states] == list(range(8))
    assert {(state.header.frame_id, state.child_frame_id) for state in states} == {("map", "base_link")}
    [update] = peer.received["state/updates"][0].updates
    assert update.gate == 0 and update.accepted and not update.reason
    variance = [np.trace(np.array(state.pose.covariance).reshape(6, 6)[:3, :3]) for state in states]
    assert variance[4] < 0.95 * variance[3] and variance[3] == pytest.approx(variance[0], rel=0.01), (
        "the gates take effect after 40 ms"
    )


def test_in_real_time_no_state_waits_and_invalid_odometry_gets_a_diagnostic(start_node, repository):
    peer = start_node(StateEstimatorNode, "state/odometry")
    camera = configuration.load(Camera, repository / "config" / "camera.yaml")
    peer.publish("camera/camera_info", to_camera_info(camera, 0))
    for tick in range(6):
        peer.publish("vio/odometry", to_odometry(resting(tick), "odom"))
    peer.expect("state/odometry", 6)
    peer.publish("vio/odometry", to_odometry(resting(7, (np.nan, 0.0, 0.0)), "odom"))
    assert peer.diagnostic("not a number").name == "state_estimator"
    peer.publish("vio/odometry", to_odometry(resting(2), "odom"))
    peer.diagnostic("follows stamp")
    peer.expect("state/odometry", 6)


def test_a_folder_of_images_is_published_at_its_rate_and_its_end_is_reported(start_node, tmp_path):
    for number in range(60):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((40, 40), 4 * number, np.uint8))
    begun_ns = time.time_ns()
    peer = start_node(CameraNode, "camera/camera_info", kind="folder", path=str(tmp_path))
    peer.until(lambda: len(peer.received["camera/camera_info"]) >= 5)
    stamps = [from_time(info.header.stamp) for info in peer.received["camera/camera_info"]]
    since_ns, period_ns = np.array(stamps) - begun_ns, 1e9 / 30
    assert np.all(np.diff(stamps) > 0) and stamps[-1] <= time.time_ns(), "stamps of the system clock"
    assert np.all(since_ns > (np.arange(len(stamps)) - 0.1) * period_ns), "no image is early"
    assert peer.received["camera/camera_info"][0].distortion_model == "equidistant"
    assert peer.diagnostic("ended after 60 images").name == "camera"
