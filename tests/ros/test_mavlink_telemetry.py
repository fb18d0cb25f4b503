"""The telemetry node on a real graph: a ground station receives it, and the node reads nothing from it."""

import socket
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from patience import PATIENCE_S
from pymavlink.dialects.v20 import common
from rclpy.experimental import EventsExecutor

from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.control import to_battery, to_link
from swift_ros.messages.motion import to_odometry
from swift_ros.messages.race import to_race_status
from swift_ros.messages.serialization import message_type
from swift_ros.nodes import mavlink_telemetry
from swift_ros.nodes.mavlink_telemetry import MavlinkTelemetryNode
from swift_ros.race.judge import RACING, RaceEvent
from swift_ros.types import Odometry


@pytest.fixture
def station():
    """Yield a ground station's socket, the telemetry node that sends to it, and the node's executor."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", 0))
    listener.setblocking(False)
    rclpy.init(
        args=["--ros-args", "-r", "__ns:=/swift", "-p", f"endpoint:=udpout:127.0.0.1:{listener.getsockname()[1]}"]
    )
    node = MavlinkTelemetryNode()
    executor = EventsExecutor()
    executor.add_node(node)
    yield listener, node, executor
    node.close()
    node.destroy_node()
    listener.close()
    rclpy.try_shutdown()


def received(listener, executor, until):
    """Return the messages by type, received until all types of `until` are there, and the sender's address."""
    decoder, found, end, sender = common.MAVLink(None), {}, time.monotonic() + PATIENCE_S, None
    while not until <= set(found) and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
        try:
            while True:
                data, sender = listener.recvfrom(300)
                message = decoder.decode(bytearray(data))
                found.setdefault(message.get_type(), []).append(message)
        except BlockingIOError:
            pass
    assert until <= set(found), f"only {sorted(found)} arrived"
    return found, sender


def test_a_ground_station_receives_telemetry_and_its_commands_are_ignored(station, monkeypatch):
    listener, node, executor = station
    monkeypatch.setattr(mavlink_telemetry, "SAME_TEXT_S", PATIENCE_S)
    publisher_node = rclpy.create_node("publisher_node", namespace="swift")
    publishers = {
        name: publisher_node.create_publisher(message_type(TOPICS[name].type), name, qos_profile(TOPICS[name], False))
        for name in ("state/odometry", "battery", "race/status", "betaflight/link", "/diagnostics")
    }
    executor.add_node(publisher_node)

    def publish():
        state = Odometry(10**9, np.array([1, 2, 3.0]), np.array([0, 0, 0, 1.0]), np.zeros(3), np.zeros(3))
        publishers["state/odometry"].publish(to_odometry(state, "map"))
        publishers["battery"].publish(to_battery(0, 15.0, 10.0, 0.1, 1.55))
        publishers["race/status"].publish(to_race_status(RaceEvent(0, RACING, text="go")))
        publishers["betaflight/link"].publish(to_link(0, 0, armed=True))
        trouble = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="vio", message="the source jumped by 3.0 m")
        publishers["/diagnostics"].publish(DiagnosticArray(status=[trouble]))

    while any(publisher.get_subscription_count() < 1 for publisher in publishers.values()):
        executor.spin_once(timeout_sec=0.05)
    publisher_node.create_timer(0.05, publish)
    wanted = {"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "SYS_STATUS", "BATTERY_STATUS", "STATUSTEXT"}
    found, sender = received(listener, executor, wanted)
    assert (found["LOCAL_POSITION_NED"][0].x, found["LOCAL_POSITION_NED"][0].z) == (2.0, -3.0)
    texts = [message.text for message in found["STATUSTEXT"]]
    assert "go" in texts or "vio: the source jumped by 3.0 m" in texts
    assert texts.count("vio: the source jumped by 3.0 m") <= 1

    packer = common.MAVLink(None, srcSystem=255)
    disarm = packer.command_long_encode(1, 1, common.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0)
    listener.sendto(disarm.pack(packer), sender)
    found, _ = received(listener, executor, {"HEARTBEAT", "ATTITUDE"})
    assert "COMMAND_ACK" not in found
    own = publisher_node.get_publisher_names_and_types_by_node("mavlink_telemetry", "/swift")
    assert {name for name, _ in own} <= {"/diagnostics", "/rosout", "/parameter_events"}
    publisher_node.destroy_node()
