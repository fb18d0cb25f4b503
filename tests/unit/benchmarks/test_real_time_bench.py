"""A recorded race prepared for its replay on the system clock."""

import cv2
import numpy as np
import pytest

from swift_ros.errors import UsageError
from swift_ros.messages.camera import to_image
from swift_ros.messages.motion import from_odometry, to_odometry
from swift_ros.messages.race import to_race_status
from swift_ros.messages.serialization import deserialize, serialize
from swift_ros.race.judge import ARMED, IDLE, RACING, RaceEvent
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.types import Odometry
from swift_sim_bridge.benchmarks import real_time
from swift_sim_bridge.benchmarks.race_player import TimedInput, restamped

TICK_NS = 10_000_000
ARMED_NS, START_NS = 52_000_000, 83_000_000


def standing(k):
    still = np.zeros(3)
    return Odometry(k * TICK_NS, np.array([0.1 * k, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0]), still, still)


def picture(k):
    return np.full((6, 8), 10 * k, np.uint8)


@pytest.fixture
def race(tmp_path):
    """Write a bag of ten ticks with three images; race/status is recorded later than its stamps."""
    writer = BagWriter(tmp_path / "bag")
    statuses = [to_race_status(RaceEvent(*event)) for event in ((0, IDLE), (ARMED_NS, ARMED), (START_NS, RACING))]
    rows = [(k * TICK_NS, "vio/raw", to_odometry(standing(k), "odom")) for k in range(10)]
    rows += [(k * TICK_NS, "camera/image_raw", to_image(picture(k), k * TICK_NS)) for k in (1, 4, 8)]
    rows += [(k * TICK_NS, "race/status", status) for k, status in zip((0, 7, 9), statuses, strict=True)]
    kinds = {
        "vio/raw": "nav_msgs/msg/Odometry",
        "camera/image_raw": "sensor_msgs/msg/Image",
        "race/status": "swift_msgs/msg/RaceStatus",
    }
    for name, kind in kinds.items():
        writer.add_topic(f"/swift/{name}", kind)
    for log_ns, name, message in sorted(rows, key=lambda row: row[:2]):
        writer.write(f"/swift/{name}", serialize(message), log_ns)
    writer.close()
    return tmp_path / "bag"


def test_odometry_and_service_calls_are_in_the_order_of_their_stamps(race):
    played = real_time.timed_inputs(race)
    assert [entry.due_ns for entry in played] == sorted(entry.due_ns for entry in played)
    assert [(entry.due_ns, entry.service) for entry in played if entry.service] == [
        (ARMED_NS, "race/arm"),
        (START_NS, "race/start"),
    ]
    assert sum(bool(entry.odometry) for entry in played) == 10


def test_the_stamp_of_an_image_is_found_by_its_pixels_and_black_images_come_first(race, tmp_path):
    (tmp_path / "images").mkdir()
    taken_ns = real_time.unpack_images(race, tmp_path / "images")
    files = sorted((tmp_path / "images").iterdir(), key=lambda file: int(file.stem))
    shown = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
    known = [taken_ns.get(hash(image.tobytes())) for image in shown]
    assert known == [None] * real_time.DARK_IMAGES + [k * TICK_NS for k in (1, 4, 8)]
    assert not shown[0].any()


def test_a_replayed_message_differs_only_in_its_stamp(race):
    entry = next(entry for entry in real_time.timed_inputs(race) if entry.odometry)
    moved = deserialize(restamped(entry.odometry, 3_000_000_007), "nav_msgs/msg/Odometry")
    odometry, recorded = from_odometry(moved), standing(0)
    assert odometry.stamp_ns == 3_000_000_007 and np.array_equal(odometry.p_world, recorded.p_world)
    assert restamped(restamped(entry.odometry, 5), -5) == entry.odometry == TimedInput(0, entry.odometry).odometry


def test_a_bag_without_images_is_refused_with_the_topic_s_name(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/swift/vio/raw", "nav_msgs/msg/Odometry")
    writer.close()
    with pytest.raises(UsageError, match="camera/image_raw"):
        real_time.unpack_images(tmp_path / "bag", tmp_path)
