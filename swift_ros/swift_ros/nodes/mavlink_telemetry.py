"""Node mavlink_telemetry: sends the state of the vehicle to a ground station over UDP. It receives no commands.

No other node waits for it. Therefore it takes messages only at the rate of its telemetry, not at the rate of the graph.
"""

import time
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from swift_ros import mavlink
from swift_ros.configuration import setting
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.motion import from_odometry
from swift_ros.messages.serialization import message_type
from swift_ros.nodes.polled_subscriptions import detach_clock, take_all
from swift_ros.nodes.shell import Shell, run, without_numbers

SAME_TEXT_S = 5.0  # s; shortest period in which the same text is sent again
SEVERITIES = {DiagnosticStatus.WARN: mavlink.WARNING, DiagnosticStatus.ERROR: mavlink.ERROR}


@dataclass(frozen=True)
class Settings:
    """Settings of the node."""

    endpoint: str = setting("address of the ground station: udpout:HOST:PORT")
    rate_hz: float = setting("rate of attitude and position, Hz; the other messages are sent at 1 Hz", 1.0, 100.0)
    system_id: int = setting("MAVLink system identifier of this vehicle", 1, 255)

    def __post_init__(self):
        mavlink.udp_address(self.endpoint)


class MavlinkTelemetryNode(Shell):
    """Subscribes state/odometry, battery, race/status, betaflight/link and /diagnostics; sends MAVLink messages."""

    def __init__(self):
        super().__init__("mavlink_telemetry", Settings)
        detach_clock(self)
        self._station = mavlink.Station(self.settings.endpoint, self.settings.system_id)
        self._state, self._battery = self._poll("state/odometry", 1), self._poll("battery", 1)
        self._link = self._poll("betaflight/link", 1)
        self._race, self._diagnostic_arrays = self._poll("race/status", 100), self._poll("/diagnostics", 100)
        self._armed = self._failsafe = False
        self._pack = None
        self._second, self._texts, self._sent_s = -1, 0, {}
        self.create_timer(1.0 / self.settings.rate_hz, self._send, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"telemetry is sent to {self.settings.endpoint}; no commands are received from there")

    def _poll(self, name: str, depth: int):
        """Return a polled subscription to a topic of the table, with a queue of `depth` messages."""
        topic = TOPICS[name]
        # Best effort: telemetry must not delay other nodes, and lost messages are acceptable.
        profile = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if topic.latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
        )
        return self.create_polled_subscription(message_type(topic.type), name, profile)

    def _send(self) -> None:
        """Send the newest messages; called periodically."""
        for message, _ in take_all(self._state):
            state = from_odometry(message)
            self._station.send([mavlink.attitude(state), mavlink.local_position(state)])
        for message, _ in take_all(self._link):
            self._armed, self._failsafe = message.armed, message.failsafe
        for message, _ in take_all(self._battery):
            self._pack = mavlink.Battery(message.voltage, -message.current, message.percentage)
        for message, _ in take_all(self._race):
            self._send_text(mavlink.NOTICE, message.text or message.state)
        for message, _ in take_all(self._diagnostic_arrays):
            self._send_diagnostics(message.status)
        second = int(time.monotonic())
        if second != self._second:
            self._second = second
            self._station.send([mavlink.heartbeat(self._armed, self._failsafe)])
            self._station.send(mavlink.battery_messages(self._pack) if self._pack else [])

    def _send_diagnostics(self, statuses) -> None:
        """Send warnings and errors, each sentence at most once in SAME_TEXT_S."""
        now = time.monotonic()
        for status in statuses:
            text = f"{status.name}: {status.message}"
            sentence = without_numbers(text)
            if status.level in SEVERITIES and now - self._sent_s.get(sentence, -SAME_TEXT_S) >= SAME_TEXT_S:
                self._sent_s[sentence] = now
                self._send_text(SEVERITIES[status.level], text)

    def _send_text(self, severity: int, text: str) -> None:
        self._texts = self._texts % 65535 + 1
        self._station.send(mavlink.status_text(severity, text, self._texts))

    def close(self) -> None:
        """Close the connection."""
        self._station.close()


def main() -> None:
    """Run the node."""
    run(MavlinkTelemetryNode)
