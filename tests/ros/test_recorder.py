"""The recorder in a real graph: no message is lost, and a kill or a full disk leaves a readable bag."""

import json
import os
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
import yaml
from geometry_msgs.msg import PointStamped
from mcap.reader import make_reader
from patience import PATIENCE_S, wait_for
from rclpy.duration import Duration
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock

from swift_ros.graph.qos import qos_profile
from swift_ros.graph.runner import command_line, launch_row
from swift_ros.graph.topic_table import NODES, TOPICS
from swift_ros.messages.camera import to_image
from swift_ros.messages.serialization import message_type
from swift_ros.messages.stamps import from_time, header_stamp_ns, to_time
from swift_ros.recording import bags

TICK_NS = 10_000_000


class FakeSimulator:
    """A node that publishes like the simulator."""

    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("simulator", namespace="swift")
        self.publishers = {}
        self.random = np.random.default_rng(0)

    def publish(self, name, message):
        if name not in self.publishers:
            topic = TOPICS[name]
            kind = message_type(topic.type)
            self.publishers[name] = self.node.create_publisher(kind, name, qos_profile(topic, True))
            wait_for(self.publishers[name].get_subscription_count)
        self.publishers[name].publish(message)

    def tick(self, k):
        odometry = message_type("nav_msgs/msg/Odometry")()
        odometry.header.stamp = to_time(k * TICK_NS)
        odometry.pose.covariance = self.random.normal(size=36)  # not compressible
        self.publish("/clock", Clock(clock=odometry.header.stamp))
        self.publish("vio/odometry", odometry)

    def wait_until_received(self):
        """Wait until all subscribers have received everything."""
        for publisher in self.publishers.values():
            wait_until_received(publisher)


@pytest.fixture
def simulator():
    instance = FakeSimulator()
    yield instance
    instance.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def start(tmp_path):
    """Return a function that starts the recorder as the runner does; its output goes to `log`."""
    processes = []

    def start(before=None, **parameters):
        launch = launch_row(NODES["recorder"], {"folder": str(tmp_path / "bag")} | parameters, lockstep=True)
        with open(tmp_path / "log", "wb") as log:
            process = subprocess.Popen(command_line(launch), stdout=log, stderr=log, preexec_fn=before)
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.wait()


def stamps(folder, topic="/swift/vio/odometry"):
    return [from_time(message.header.stamp) for _, message, _ in bags.read(folder, [topic])]


def ready(tmp_path):
    """Wait until the recorder reports that it records."""
    wait_for(lambda: b"recording to" in (tmp_path / "log").read_bytes(), "the recorder did not start")


def wait_until_received(publisher):
    """Wait until all subscribers of a publisher have received everything."""
    assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))


def test_no_message_is_lost_and_log_times_are_those_of_the_clock(simulator, start, tmp_path):
    recorder = start()
    ready(tmp_path)
    for k in range(600):
        simulator.tick(k)
        time.sleep(0.001)
    simulator.wait_until_received()
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(timeout=PATIENCE_S) == 0
    assert stamps(tmp_path / "bag") == [k * TICK_NS for k in range(600)]
    recorded = list(bags.read_raw(tmp_path / "bag", ["/swift/vio/odometry"]))
    assert [raw.publish_time_ns for raw in recorded] == [header_stamp_ns(raw.data) for raw in recorded]
    log_times = [raw.log_time_ns for raw in recorded]  # messages of two topics may overtake one another in transit
    assert log_times == sorted(log_times) and set(log_times) <= {k * TICK_NS for k in range(600)}


def test_a_bag_holds_the_configuration_and_the_qos_of_its_topics(simulator, start, tmp_path, repository):
    recorder = start(config=str(repository / "config"))
    ready(tmp_path)
    recorder.terminate()
    recorder.wait(timeout=PATIENCE_S)
    custom = bags.custom_data(tmp_path / "bag")
    assert custom["config/drone.yaml"] == (repository / "config" / "drone.yaml").read_text()
    models = sorted(path.name for path in (repository / "config" / "models").glob("*.onnx"))
    assert [name for name in sorted(custom) if name.startswith("sha256")] == [f"sha256 models/{m}" for m in models]
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    offered = {
        row["topic_metadata"]["name"]: row["topic_metadata"]["offered_qos_profiles"][0]
        for row in information["topics_with_message_count"]
    }
    assert set(offered) == {f"/swift/{name}" if name[0] != "/" else name for name in TOPICS}
    assert offered["/swift/race/status"]["durability"] == "transient_local"
    assert offered["/swift/camera/image_raw"]["reliability"] == "reliable"


def test_a_killed_recorder_leaves_a_bag_that_other_readers_accept(simulator, start, tmp_path):
    recorder = start()
    ready(tmp_path)
    for k in range(1000):
        simulator.tick(k)
        time.sleep(0.001)
    file = tmp_path / "bag" / "bag_0.mcap"
    wait_for(lambda: file.stat().st_size > 200_000)
    recorder.send_signal(signal.SIGKILL)
    recorder.wait()
    kept = stamps(tmp_path / "bag")
    assert len(kept) > 200 and kept == [k * TICK_NS for k in range(len(kept))]
    with open(file, "rb") as stream:
        assert sum(1 for _ in make_reader(stream).iter_messages(topics=["/swift/vio/odometry"])) == len(kept)
    with AnyReader([tmp_path / "bag"]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/swift/vio/odometry"]
        assert sum(1 for _ in reader.messages(wanted)) == len(kept)


def test_a_full_disk_is_reported_and_earlier_messages_stay_readable(simulator, start, tmp_path):
    limit = 1_200_000  # bytes; a write beyond this size fails as on a full disk
    recorder = start(before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    ready(tmp_path)
    for k in range(20):
        simulator.tick(k)
    simulator.wait_until_received()  # else a busy machine may deliver the images first, which leave no space
    for k in range(20, 80):
        simulator.tick(k)
        simulator.publish("camera/image_raw", to_image(simulator.random.integers(0, 255, (200, 200), np.uint8), k))
        time.sleep(0.005)
    wait_for(lambda: b"earlier messages stay readable" in (tmp_path / "log").read_bytes())
    assert recorder.poll() is None
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(timeout=PATIENCE_S) == 0
    kept = stamps(tmp_path / "bag")
    assert len(kept) > 10 and kept == [k * TICK_NS for k in range(len(kept))]
    with AnyReader([tmp_path / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) >= len(kept)


def test_a_folder_that_cannot_be_written_is_an_error_of_one_sentence(start, tmp_path):
    (tmp_path / "file").write_text("")
    recorder = start(folder=str(tmp_path / "file" / "bag"))
    assert recorder.wait(timeout=PATIENCE_S) == 2
    last = (tmp_path / "log").read_text().strip().splitlines()[-1]
    assert last.startswith("recorder: ") and "cannot be written" in last


def test_a_topic_outside_the_table_is_recorded_once_it_has_a_publisher(simulator, start, tmp_path):
    recorder = start(topics="vio/odometry,/camp/fire")
    publisher = simulator.node.create_publisher(PointStamped, "/camp/fire", 10)
    wait_for(publisher.get_subscription_count)
    for _ in range(5):
        publisher.publish(PointStamped())
    wait_until_received(publisher)
    ready(tmp_path)
    recorder.send_signal(signal.SIGINT)
    recorder.wait(timeout=PATIENCE_S)
    assert bags.topic_types(tmp_path / "bag") == {
        "/swift/vio/odometry": "nav_msgs/msg/Odometry",
        "/camp/fire": "geometry_msgs/msg/PointStamped",
        "/clock": "rosgraph_msgs/msg/Clock",  # always recorded in lockstep: log times are those of /clock
    }
    assert sum(1 for _ in bags.read_raw(tmp_path / "bag", ["/camp/fire"])) == 5


def test_the_command_records_counts_messages_and_ends_at_ctrl_c(simulator, tmp_path):
    out = tmp_path / "flight"
    command = [sys.executable, "-m", "swift_ros.cli", "record", "--out", str(out), "--topics", "vio/odometry"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"})
    assert "recording to" in process.stdout.readline()
    topic = TOPICS["vio/odometry"]
    publisher = simulator.node.create_publisher(message_type(topic.type), topic.name, qos_profile(topic, False))
    wait_for(publisher.get_subscription_count)
    for k in range(50):
        publisher.publish(message_type(topic.type)())
        if k == 0:
            # from here on the recorder has discovered the publisher, whose queue is short in real time
            wait_until_received(publisher)
        time.sleep(0.01)
    wait_until_received(publisher)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0 and "/swift/vio/odometry  50" in output
    assert len(stamps(out)) == json.loads((out / "result.json").read_text())["messages"]["/swift/vio/odometry"] == 50
