"""The recorder on a real graph: nothing is lost, and neither a kill nor a full disk costs what was written."""

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

from swift_ros import messages
from swift_ros.graph.runner import command_line, launch_row
from swift_ros.graph.topic_table import NODES, TOPICS
from swift_ros.nodes.shell import quality
from swift_ros.recording import bags

TICK_NS = 10_000_000


class Speaker:
    """A node that speaks as the simulator does."""

    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("speaker", namespace="swift")
        self.voices = {}
        self.random = np.random.default_rng(0)

    def speak(self, name, message):
        if name not in self.voices:
            topic = TOPICS[name]
            kind = messages.message_type(topic.type)
            self.voices[name] = self.node.create_publisher(kind, name, quality(topic, True))
            wait_for(self.voices[name].get_subscription_count)
        self.voices[name].publish(message)

    def tick(self, k):
        odometry = messages.message_type("nav_msgs/msg/Odometry")()
        odometry.header.stamp = messages.to_time(k * TICK_NS)
        odometry.pose.covariance = self.random.normal(size=36)  # nothing that could be compressed
        self.speak("/clock", Clock(clock=odometry.header.stamp))
        self.speak("vio/odometry", odometry)

    def heard_out(self):
        """Wait until whoever listens has received everything."""
        for voice in self.voices.values():
            heard_out(voice)


@pytest.fixture
def speaker():
    made = Speaker()
    yield made
    made.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def start(tmp_path):
    """Start the recorder as the runner does; its output goes to `log`."""
    processes = []

    def start(before=None, **parameters):
        words = launch_row(NODES["recorder"], {"folder": str(tmp_path / "bag")} | parameters, lockstep=True)
        with open(tmp_path / "log", "wb") as log:
            process = subprocess.Popen(command_line(words), stdout=log, stderr=log, preexec_fn=before)
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.wait()


def stamps(folder, topic="/swift/vio/odometry"):
    return [messages.stamp_ns(message.header.stamp) for _, message, _ in bags.read(folder, [topic])]


def ready(tmp_path):
    """Wait until the recorder says that it records."""
    wait_for(lambda: b"recording to" in (tmp_path / "log").read_bytes(), "the recorder did not start")


def heard_out(voice):
    """Wait until whoever listens to a publisher has received everything."""
    assert voice.wait_for_all_acked(Duration(seconds=PATIENCE_S))


def test_nothing_is_lost_and_times_are_those_of_the_clock(speaker, start, tmp_path):
    recorder = start()
    ready(tmp_path)
    for k in range(600):
        speaker.tick(k)
        time.sleep(0.001)
    speaker.heard_out()
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(timeout=PATIENCE_S) == 0
    assert stamps(tmp_path / "bag") == [k * TICK_NS for k in range(600)]
    recorded = list(bags.read_raw(tmp_path / "bag", ["/swift/vio/odometry"]))
    assert [raw.publish_time_ns for raw in recorded] == [messages.header_stamp_ns(raw.data) for raw in recorded]
    log_times = [raw.log_time_ns for raw in recorded]  # two topics may overtake one another on the way
    assert log_times == sorted(log_times) and set(log_times) <= {k * TICK_NS for k in range(600)}


def test_a_bag_says_who_flew_and_how_surely_topics_were_sent(speaker, start, tmp_path, repository):
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


def test_killed_in_flight_it_leaves_a_bag_that_others_read(speaker, start, tmp_path):
    recorder = start()
    ready(tmp_path)
    for k in range(1000):
        speaker.tick(k)
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


def test_a_full_disk_is_said_in_a_sentence_and_what_was_written_stays(speaker, start, tmp_path):
    limit = 1_200_000  # bytes: writing beyond fails as on a full disk
    recorder = start(before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    ready(tmp_path)
    for k in range(20):
        speaker.tick(k)
    speaker.heard_out()  # or a busy machine may bring the images first, and nothing else fits
    for k in range(20, 80):
        speaker.tick(k)
        speaker.speak("camera/image_raw", messages.to_image(speaker.random.integers(0, 255, (200, 200), np.uint8), k))
        time.sleep(0.005)
    wait_for(lambda: b"what was written stays" in (tmp_path / "log").read_bytes())
    assert recorder.poll() is None
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(timeout=PATIENCE_S) == 0
    kept = stamps(tmp_path / "bag")
    assert len(kept) > 10 and kept == [k * TICK_NS for k in range(len(kept))]
    with AnyReader([tmp_path / "bag"]) as reader:
        assert sum(1 for _ in reader.messages()) >= len(kept)


def test_a_folder_that_cannot_be_written_is_one_sentence(start, tmp_path):
    (tmp_path / "file").write_text("")
    recorder = start(folder=str(tmp_path / "file" / "bag"))
    assert recorder.wait(timeout=PATIENCE_S) == 2
    last = (tmp_path / "log").read_text().strip().splitlines()[-1]
    assert last.startswith("recorder: ") and "cannot be written" in last


def test_a_topic_that_the_table_lacks_is_recorded_once_somebody_speaks_there(speaker, start, tmp_path):
    recorder = start(topics="vio/odometry,/camp/fire")
    voice = speaker.node.create_publisher(PointStamped, "/camp/fire", 10)
    wait_for(voice.get_subscription_count)
    for _ in range(5):
        voice.publish(PointStamped())
    heard_out(voice)
    ready(tmp_path)
    recorder.send_signal(signal.SIGINT)
    recorder.wait(timeout=PATIENCE_S)
    assert bags.topic_types(tmp_path / "bag") == {
        "/swift/vio/odometry": "nav_msgs/msg/Odometry",
        "/camp/fire": "geometry_msgs/msg/PointStamped",
        "/clock": "rosgraph_msgs/msg/Clock",  # always, in lockstep: log times come from there
    }
    assert sum(1 for _ in bags.read_raw(tmp_path / "bag", ["/camp/fire"])) == 5


def test_the_command_records_what_is_spoken_counts_it_and_ends_at_ctrl_c(speaker, tmp_path):
    out = tmp_path / "flight"
    command = [sys.executable, "-m", "swift_ros.cli", "record", "--out", str(out), "--topics", "vio/odometry"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"})
    assert "recording to" in process.stdout.readline()
    topic = TOPICS["vio/odometry"]
    voice = speaker.node.create_publisher(messages.message_type(topic.type), topic.name, quality(topic, False))
    wait_for(voice.get_subscription_count)
    for k in range(50):
        voice.publish(messages.message_type(topic.type)())
        if k == 0:
            heard_out(voice)  # from here on the recorder knows the speaker, too: in real time only a few words are kept
        time.sleep(0.01)
    heard_out(voice)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0 and "/swift/vio/odometry  50" in said
    assert len(stamps(out)) == json.loads((out / "result.json").read_text())["messages"]["/swift/vio/odometry"] == 50
