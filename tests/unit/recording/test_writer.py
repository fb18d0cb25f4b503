"""The recording writer: order and log times of messages that are received in any order."""

from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from swift_ros.messages.serialization import serialize
from swift_ros.messages.stamps import to_time
from swift_ros.recording import bags
from swift_ros.recording.writer import ReceivedMessage, RecordingWriter

TICK_NS = 10_000_000


def clock(k, received_ns):
    return ReceivedMessage("/clock", serialize(Clock(clock=to_time(k * TICK_NS))), received_ns)


def header(k, received_ns):
    data = serialize(Header(stamp=to_time(k * TICK_NS)))
    return ReceivedMessage("/swift/race/judged", data, received_ns)


def test_log_times_are_those_of_the_clock_at_reception_for_any_order_of_a_batch(tmp_path, repository):
    recording = RecordingWriter(tmp_path / "bag", repository / "config", simulated=True)
    recording.declare("/swift/race/judged", "std_msgs/msg/Header", "")
    recording.declare("/clock", "rosgraph_msgs/msg/Clock", "")
    recording.write([header(1, 110), header(2, 210), header(3, 215), clock(2, 200), clock(1, 100)])
    recording.write([clock(3, 300), header(3, 310)])
    recording.close()
    written = list(bags.read_raw(tmp_path / "bag", ["/swift/race/judged"]))
    assert [raw.log_time_ns // TICK_NS for raw in written] == [1, 2, 2, 3]
    assert [raw.publish_time_ns // TICK_NS for raw in written] == [1, 2, 3, 3]
    assert recording.counts == {"/swift/race/judged": 4, "/clock": 3} and recording.fault is None
