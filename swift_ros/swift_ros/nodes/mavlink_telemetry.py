"""Node mavlink_telemetry: tells a ground station over UDP how the vehicle is. It takes no command: it never listens.

Nothing in the flight waits for it, so it looks at the graph only as often as it speaks, whatever the graph's pace.
"""

import re
import time
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from swift_ros import mavlink, messages
from swift_ros.configuration import setting
from swift_ros.graph.topic_table import TOPICS
from swift_ros.nodes.polled_subscriptions import PolledGroup, detach_clock, take_all, unused_callback
from swift_ros.nodes.shell import Shell, run

SAME_TEXT_S = 5.0  # a complaint that lasts is repeated no more often
SEVERITIES = {DiagnosticStatus.WARN: mavlink.WARNING, DiagnosticStatus.ERROR: mavlink.ERROR}


@dataclass(frozen=True)
class Settings:
    endpoint: str = setting("where the ground station listens: udpout:HOST:PORT")
    rate_hz: float = setting("attitude and position a second; the rest comes at 1 Hz", 1.0, 100.0)
    system_id: int = setting("MAVLink's number of this vehicle", 1, 255)


class MavlinkTelemetryNode(Shell):
    """state/odometry, battery, race/status, betaflight/link and /diagnostics in, MAVLink out."""

    executor_type = PolledGroup.EXECUTOR

    def __init__(self):
        super().__init__("mavlink_telemetry", Settings)
        detach_clock(self)
        self._station = mavlink.Station(self.settings.endpoint, self.settings.system_id)
        self._group = PolledGroup()
        self._state, self._battery = self._listen("state/odometry", 1), self._listen("battery", 1)
        self._link = self._listen("betaflight/link", 1)
        self._race, self._complaints = self._listen("race/status", 100), self._listen("/diagnostics", 100)
        self._armed = self._failsafe = False
        self._pack = None
        self._second, self._texts, self._said_s = -1, 0, {}
        self.create_timer(1.0 / self.settings.rate_hz, self._tell, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"telemetry goes to {self.settings.endpoint}; commands from there are not heard")

    def _listen(self, name: str, depth: int):
        topic = TOPICS[name]
        # what is missed is missed: telemetry must hold nobody up
        quality = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if topic.latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
        )
        kind = messages.message_type(topic.type)
        return self.create_subscription(kind, name, unused_callback, quality, callback_group=self._group)

    def _tell(self) -> None:
        for message, _ in take_all(self._state):
            state = messages.from_odometry(message)
            self._station.send([mavlink.attitude(state), mavlink.local_position(state)])
        for message, _ in take_all(self._link):
            self._armed, self._failsafe = message.armed, message.failsafe
        for message, _ in take_all(self._battery):
            self._pack = mavlink.Battery(message.voltage, -message.current, message.percentage)
        for message, _ in take_all(self._race):
            self._say(mavlink.NOTICE, message.text or message.state)
        for message, _ in take_all(self._complaints):
            self._pass_on(message.status)
        second = int(time.monotonic())
        if second != self._second:
            self._second = second
            self._station.send([mavlink.heartbeat(self._armed, self._failsafe)])
            self._station.send(mavlink.battery_messages(self._pack) if self._pack else [])

    def _pass_on(self, statuses) -> None:
        """Say what is wrong, each sentence once in a while."""
        now = time.monotonic()
        for status in statuses:
            text = f"{status.name}: {status.message}"
            sentence = re.sub(r"[-+.\d]+", "#", text)
            if status.level in SEVERITIES and now - self._said_s.get(sentence, -SAME_TEXT_S) >= SAME_TEXT_S:
                self._said_s[sentence] = now
                self._say(SEVERITIES[status.level], text)

    def _say(self, severity: int, text: str) -> None:
        self._texts = self._texts % 65535 + 1
        self._station.send(mavlink.status_text(severity, text, self._texts))

    def close(self) -> None:
        self._station.close()


def main() -> None:
    """Run the node."""
    run(MavlinkTelemetryNode)
