"""The telemetry node on a real graph: a ground station hears it, and it hears no ground station."""

import socket
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from patience import PATIENCE_S
from pymavlink.dialects.v20 import common

from swift_ros import messages
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import TOPICS
from swift_ros.nodes import mavlink_telemetry
from swift_ros.nodes.mavlink_telemetry import MavlinkTelemetryNode
from swift_ros.race.judge import RACING, RaceEvent
from swift_ros.types import Odometry


@pytest.fixture
def station():
    """A ground station's socket, and the node that talks to it."""
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.bind(("127.0.0.1", 0))
    ear.setblocking(False)
    rclpy.init(args=["--ros-args", "-r", "__ns:=/swift", "-p", f"endpoint:=udpout:127.0.0.1:{ear.getsockname()[1]}"])
    node = MavlinkTelemetryNode()
    executor = node.executor_type()
    executor.add_node(node)
    yield ear, node, executor
    node.close()
    node.destroy_node()
    ear.close()
    rclpy.try_shutdown()


def heard(ear, executor, until):
    """Return the messages by type that came until there were all in `until`, and where they came from."""
    decoder, found, end, sender = common.MAVLink(None), {}, time.monotonic() + PATIENCE_S, None
    while not until <= set(found) and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
        try:
            while True:
                data, sender = ear.recvfrom(300)
                message = decoder.decode(bytearray(data))
                found.setdefault(message.get_type(), []).append(message)
        except BlockingIOError:
            pass
    assert until <= set(found), f"only {sorted(found)} came"
    return found, sender


def test_a_ground_station_hears_the_vehicle_and_is_not_heard(station, monkeypatch):
    ear, node, executor = station
    monkeypatch.setattr(mavlink_telemetry, "SAME_TEXT_S", PATIENCE_S)
    speaker = rclpy.create_node("speaker", namespace="swift")
    voices = {
        name: speaker.create_publisher(messages.message_type(TOPICS[name].type), name, qos_profile(TOPICS[name], False))
        for name in ("state/odometry", "battery", "race/status", "betaflight/link", "/diagnostics")
    }
    executor.add_node(speaker)

    def speak():
        state = Odometry(10**9, np.array([1, 2, 3.0]), np.array([0, 0, 0, 1.0]), np.zeros(3), np.zeros(3))
        voices["state/odometry"].publish(messages.to_odometry(state, "map"))
        voices["battery"].publish(messages.to_battery(0, 15.0, 10.0, 0.1, 1.55))
        voices["race/status"].publish(messages.to_race_status(RaceEvent(0, RACING, text="go")))
        voices["betaflight/link"].publish(messages.to_link(0, 0, armed=True))
        trouble = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="vio", message="the source jumped by 3.0 m")
        voices["/diagnostics"].publish(DiagnosticArray(status=[trouble]))

    while any(voice.get_subscription_count() < 1 for voice in voices.values()):
        executor.spin_once(timeout_sec=0.05)
    speaker.create_timer(0.05, speak)
    wanted = {"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "SYS_STATUS", "BATTERY_STATUS", "STATUSTEXT"}
    found, sender = heard(ear, executor, wanted)
    assert (found["LOCAL_POSITION_NED"][0].x, found["LOCAL_POSITION_NED"][0].z) == (2.0, -3.0)
    texts = [message.text for message in found["STATUSTEXT"]]
    assert "go" in texts or "vio: the source jumped by 3.0 m" in texts
    assert texts.count("vio: the source jumped by 3.0 m") <= 1

    packer = common.MAVLink(None, srcSystem=255)
    disarm = packer.command_long_encode(1, 1, common.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0)
    ear.sendto(disarm.pack(packer), sender)
    found, _ = heard(ear, executor, {"HEARTBEAT", "ATTITUDE"})
    assert "COMMAND_ACK" not in found
    own = speaker.get_publisher_names_and_types_by_node("mavlink_telemetry", "/swift")
    assert {name for name, _ in own} <= {"/diagnostics", "/rosout", "/parameter_events"}
    speaker.destroy_node()
