"""Replay: no message is dropped, results are reproduced to the bit, and errors are reported."""

import json

import numpy as np
import pytest
import synthetic_flight as flight
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from swift_ros import cli
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.camera import to_image
from swift_ros.messages.gates import to_detections
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.recording import bags, replay
from swift_ros.recording.bag_writer import BagWriter

TICKS = range(60, 330)  # from the podium towards the first gates
IMAGE_TICKS = range(60, 330, 10)


class Bag:
    """Collects the messages of a bag by topic of the table, with log times after their stamps."""

    def __init__(self, folder, late_ns=0):
        self.folder, self._late_ns, self._messages = folder, late_ns, []

    def add(self, topic, message, late_ns=None):
        stamp_ns = from_time(message.header.stamp)
        self._messages.append((stamp_ns + (self._late_ns if late_ns is None else late_ns), topic, message))
        return self

    def write(self):
        writer = BagWriter(self.folder)
        for at_ns, topic, message in sorted(self._messages, key=lambda entry: entry[0]):
            writer.add_topic(full_name(topic), TOPICS[topic].type)
            writer.write(full_name(topic), serialize_message(message), at_ns)
        writer.close()
        return self.folder


def detections_bag(folder):
    """Write the bag of a flight with detections, odometry with drift, and ground truth."""
    truth, bag = flight.race(), Bag(folder)
    odometry = flight.odometry(truth, flight.Drift(), seed=3)
    detected = flight.images(truth, flight.Detector(), seed=3)
    for i in TICKS:
        bag.add("ground_truth/odometry", to_odometry(truth.odometry(i), "map"))
        bag.add("vio/odometry", to_odometry(odometry[i], "odom"))
        if i in detected:
            header = Header(stamp=to_time(int(truth.stamps_ns[i])), frame_id="camera_optical")
            bag.add("gates/detections", to_detections(header, detected[i]), late_ns=25_000_000)
    return bag.write()


def images_bag(folder, shape=(384, 384)):
    """Write the bag of a flight with images and raw odometry; one odometry message is NaN."""
    truth, bag, random = flight.race(), Bag(folder), np.random.default_rng(0)
    for i in TICKS:
        raw = to_odometry(truth.odometry(i), "odom")
        if i == 200:
            raw.pose.pose.position.x = float("nan")
        bag.add("vio/raw", raw)
        if i in IMAGE_TICKS:
            image = random.integers(0, 255, shape, np.uint8)
            bag.add("camera/image_raw", to_image(image, int(truth.stamps_ns[i])), late_ns=30_000_000)
    return bag.write()


def replayed(bag, out):
    """Replay a bag and return exit code and result."""
    code = cli.main(["replay", str(bag), "--out", str(out)])
    return code, json.loads((out / "result.json").read_text())


def contents(bag, topic):
    return [raw.data for raw in bags.read_raw(bag, [full_name(topic)])]


def test_recorded_detections_correct_the_state_and_a_second_replay_is_identical(tmp_path, capfd):
    bag = detections_bag(tmp_path / "recorded")
    code, result = replayed(bag, tmp_path / "first")
    output = capfd.readouterr().out
    assert code == 0 and result["nodes"] == ["gate_pose", "state_estimator"]
    assert "gate_detector does not run: no camera/image_raw in the recording" in output
    assert result["replay"]["answered"]["gates/poses"] == len(contents(bag, "gates/detections"))
    assert result["replay"]["answered"]["state/odometry"] == len(TICKS)
    assert result["corrections_accepted"]["replayed"] > 50
    truth = result["state_to_truth"]
    assert truth["recorded"] is None and truth["replayed"]["rmse_m"] < 0.25
    new = tmp_path / "first" / "bag"
    for topic in ("ground_truth/odometry", "vio/odometry", "gates/detections"):
        assert contents(new, topic) == contents(bag, topic)
    assert (tmp_path / "first" / "replay.png").stat().st_size > 10_000

    code, again = replayed(new, tmp_path / "second")
    assert code == 0 and again["state_difference"]["max_m"] == 0 and again["pose_position_m"]["max"] == 0
    for topic in ("gates/poses", "state/odometry", "state/updates"):
        assert contents(tmp_path / "second" / "bag", topic) == contents(new, topic)


def test_all_images_are_processed_by_all_nodes_of_perception(tmp_path, capfd):
    bag = images_bag(tmp_path / "recorded")
    code, result = replayed(bag, tmp_path / "out")
    assert code == 0 and result["nodes"] == ["vio", "gate_detector", "gate_pose", "state_estimator"]
    answered = result["replay"]["answered"]
    assert answered["gates/detections"] == answered["gates/poses"] == len(IMAGE_TICKS)
    assert answered["state/odometry"] == len(TICKS) - 1 and result["replay"]["odometry_refused"] == 1
    assert "1 odometry messages were refused" in capfd.readouterr().out
    assert contents(tmp_path / "out" / "bag", "camera/image_raw") == contents(bag, "camera/image_raw")


def refused(capfd, *arguments):
    code = cli.main(["replay", *map(str, arguments)])
    output = capfd.readouterr()
    assert code == 2 and len(output.err.strip().splitlines()) == 1
    return output.err


def test_a_recording_that_cannot_be_replayed_is_refused_in_one_sentence(tmp_path, capfd):
    truth = flight.race().odometry(0)
    blind = Bag(tmp_path / "blind").add("ground_truth/odometry", to_odometry(truth, "map")).write()
    assert "neither /swift/vio/odometry nor /swift/vio/raw; it has ground_truth/odometry" in refused(capfd, blind)
    small = images_bag(tmp_path / "small", shape=(100, 120))
    assert "images of 120 x 100" in refused(capfd, small)
    assert "holds 2 bags" in refused(capfd, tmp_path)
    assert "does not exist" in refused(capfd, tmp_path / "nowhere")


def test_a_replay_never_removes_the_recording_it_reads(tmp_path, capfd):
    out = tmp_path / "replay"
    bag = detections_bag(out / "bag")
    assert "holds the recording itself" in refused(capfd, bag, "--out", out)
    assert contents(bag, "vio/odometry")


def test_messages_are_played_at_their_stamps_for_any_log_time(tmp_path):
    bag = images_bag(tmp_path / "recorded")
    plan = replay.plan(replay.recorded_topics(bag), bag)
    played = list(replay.schedule(bag, plan, lambda stamp_ns: b"an image was taken"))
    assert [play.at_ns for play in played] == sorted(play.at_ns for play in played)
    at_first_image = [play.topic for play in played if play.at_ns == played[0].at_ns]
    assert at_first_image == ["camera/camera_info", "vio/raw", "camera/image_raw"]


@pytest.mark.parametrize(
    "topics, nodes",
    [
        ({"vio/odometry", "imu/data_raw"}, ("state_estimator",)),
        ({"vio/raw"}, ("vio", "state_estimator")),
        (
            {"vio/raw", "vio/odometry", "camera/image_raw", "gates/poses"},
            ("gate_detector", "gate_pose", "state_estimator"),
        ),
        ({"vio/odometry", "gates/detections", "gates/poses"}, ("gate_pose", "state_estimator")),
        ({"vio/odometry", "gates/poses"}, ("state_estimator",)),
    ],
)
def test_the_nodes_of_a_replay_depend_on_the_recorded_topics(topics, nodes):
    plan = replay.plan(topics, "bag")
    assert plan.nodes == nodes
    assert set(plan.idle) | set(nodes) == set(replay.REPLAYED) and not set(plan.recomputed) & set(plan.played)


def test_without_odometry_nothing_runs():
    with pytest.raises(UsageError, match="no topic of the graph"):
        replay.plan(set(), "bag")


def test_the_error_of_a_node_that_cannot_start_ends_the_replay(tmp_path, capfd, repository):
    config = tmp_path / "config"
    config.mkdir()
    for file in (repository / "config").iterdir():
        (config / file.name).symlink_to(file)
    (config / "nodes.yaml").unlink()
    text = (repository / "config" / "nodes.yaml").read_text()
    (config / "nodes.yaml").write_text(text.replace("models/gate_detector.onnx", "models/lost.onnx"))
    bag = images_bag(tmp_path / "recorded")
    output = refused(capfd, bag, "--config", config, "--out", tmp_path / "out")
    assert "gate_detector" in output and "lost.onnx" in output
