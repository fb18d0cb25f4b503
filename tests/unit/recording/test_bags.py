"""Bags: written messages stay readable, also by other tools, after a kill or a truncated copy."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.recording import bags
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.recording.mcap_format import message_definitions


def odometry(k: int) -> Odometry:
    message = Odometry()
    message.header.stamp.nanosec = k
    message.pose.pose.position.x = float(k)
    return message


def write_bag(folder, count=100, close=True):
    writer = BagWriter(folder, {"hash": "abc"})
    writer.add_topic("/swift/vio/odometry", "nav_msgs/msg/Odometry")
    for k in range(count):
        writer.write("/swift/vio/odometry", serialize_message(odometry(k)), k * 10)
    if close:
        writer.close()
    return writer


def test_written_messages_are_read_back_in_order_with_their_metadata(tmp_path):
    write_bag(tmp_path / "bag")
    rows = list(bags.read(tmp_path / "bag"))
    assert [m.pose.pose.position.x for _, m, _ in rows] == list(range(100))
    assert [t for *_, t in rows] == [k * 10 for k in range(100)]
    assert bags.custom_data(tmp_path / "bag") == {"hash": "abc"}
    assert bags.topic_types(tmp_path / "bag") == {"/swift/vio/odometry": "nav_msgs/msg/Odometry"}


def test_rosbags_and_mcap_read_a_finished_bag(tmp_path):
    write_bag(tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        values = [reader.deserialize(raw, c.msgtype).pose.pose.position.x for c, _, raw in reader.messages()]
    np.testing.assert_array_equal(values, np.arange(100))
    with open(bags.mcap_files(tmp_path / "bag")[0], "rb") as stream:
        assert sum(1 for _ in make_reader(stream).iter_messages()) == 100


KILLED = """
import sys
sys.path[:0] = {path!r}
from tests.unit.recording.test_bags import write_bag
write_bag({folder!r}, count=20000, close=False)
print("written", flush=True)
import time; time.sleep(60)
"""


def test_a_killed_recorder_leaves_a_bag_that_other_tools_read(tmp_path):
    folder = tmp_path / "bag"
    code = KILLED.format(path=[p for p in sys.path if p] + [os.getcwd()], folder=str(folder))
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert child.stdout.readline().strip() == b"written"
    child.send_signal(signal.SIGKILL)
    child.wait()
    times = [raw.log_time_ns for raw in bags.read_raw(folder)]
    assert len(times) > 19000 and times == sorted(times)
    with open(bags.mcap_files(folder)[0], "rb") as stream:
        assert sum(1 for _ in make_reader(stream).iter_messages()) == len(times)
    with AnyReader([folder]) as reader:
        assert sum(1 for _ in reader.messages()) == len(times)


def test_a_truncated_file_is_read_up_to_its_end(tmp_path):
    write_bag(tmp_path / "bag", count=20000)
    file = bags.mcap_files(tmp_path / "bag")[0]
    assert bags.damage(file) == []
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.warns(DamagedRecording, match=r"the file was cut there, and the messages after 0\.\d+ s are missing"):
        messages = list(bags.read_raw(tmp_path / "bag"))
    assert 1000 < len(messages) < 20000


@pytest.mark.parametrize("content", [b"", b"this is a text file"])
def test_a_file_of_another_kind_is_refused_in_one_sentence(tmp_path, content):
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(UsageError, match="not an MCAP file"):
        list(bags.read_raw(tmp_path / "x.mcap"))


@pytest.mark.parametrize(
    "kind", ["foreign_msgs/msg/Thing", "qensor_msgs/msg/Imu", "os/path/join", "nav_msgs/msg/Thing"]
)
def test_topics_of_types_that_are_not_installed_are_left_out_and_named(tmp_path, kind):
    path = tmp_path / "foreign.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        for name, type_name in (("/thing", kind), ("/odometry", "nav_msgs/msg/Odometry")):
            channel = writer.register_channel(name, "cdr", writer.register_schema(type_name, "ros2msg", b""))
            writer.add_message(channel, 1, serialize_message(odometry(1)), 1)
        writer.finish()
    with pytest.warns(DamagedRecording, match=f"/thing is left out: no installed package has the type {kind}"):
        (row,) = bags.read(path)
    assert row[0] == "/odometry"


def test_the_error_for_a_missing_topic_names_the_present_ones(tmp_path):
    write_bag(tmp_path / "bag")
    with pytest.raises(UsageError, match=r"no topic /swift/imu.*it has /swift/vio/odometry"):
        bags.require(tmp_path / "bag", "/swift/imu")


def test_schemas_hold_every_nested_type():
    text = message_definitions.schema_text("geometry_msgs/msg/Vector3Stamped")
    for nested in ("std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Vector3"):
        assert f"MSG: {nested}" in text
    assert message_definitions.type_hash("geometry_msgs/msg/Vector3Stamped").startswith("RIHS01_")


def test_a_bag_that_is_resumed_after_a_kill_is_one_recording_for_all_readers(tmp_path):
    write_bag(tmp_path / "bag", close=False)  # killed
    writer = BagWriter(tmp_path / "bag", {"hash": "abc"}, resume=True)
    writer.add_topic("/swift/vio/odometry", "nav_msgs/msg/Odometry")
    for k in range(100, 150):
        writer.write("/swift/vio/odometry", serialize_message(odometry(k)), k * 10)
    writer.close()
    xs = [message.pose.pose.position.x for _, message, _ in bags.read(tmp_path / "bag")]
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == len(xs)
        assert [time for _, time, _ in reader.messages()] == sorted(10 * int(x) for x in xs)
    assert xs == sorted(xs) and xs[-50:] == list(range(100, 150))
    with pytest.raises(UsageError, match="holds a bag already"):
        BagWriter(tmp_path / "bag")
