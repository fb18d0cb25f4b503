"""What the recorder writes: order and times of messages that came in any order, told by a recorded clock."""

from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from swift_ros import messages
from swift_ros.recording import bags
from swift_ros.recording.writer import Heard, Recording

TICK_NS = 10_000_000


def clock(k, received_ns):
    return Heard("/clock", messages.serialize(Clock(clock=messages.to_time(k * TICK_NS))), received_ns)


def header(k, received_ns):
    return Heard("/swift/race/judged", messages.serialize(Header(stamp=messages.to_time(k * TICK_NS))), received_ns)


def test_log_times_are_those_of_the_clock_at_reception_however_a_batch_is_ordered(tmp_path, repository):
    recording = Recording(tmp_path / "bag", repository / "config", simulated=True)
    recording.declare("/swift/race/judged", "std_msgs/msg/Header", "")
    recording.declare("/clock", "rosgraph_msgs/msg/Clock", "")
    recording.take([header(1, 110), header(2, 210), header(3, 215), clock(2, 200), clock(1, 100)])
    recording.take([clock(3, 300), header(3, 310)])
    recording.close()
    written = list(bags.read_raw(tmp_path / "bag", ["/swift/race/judged"]))
    assert [raw.log_time_ns // TICK_NS for raw in written] == [1, 2, 2, 3]
    assert [raw.publish_time_ns // TICK_NS for raw in written] == [1, 2, 3, 3]
    assert recording.counts == {"/swift/race/judged": 4, "/clock": 3} and recording.fault is None
