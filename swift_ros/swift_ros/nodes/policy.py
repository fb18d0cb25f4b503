"""Node policy: publishes for every state the command of the pilot's network, with its observation and action."""

from dataclasses import dataclass

from swift_ros import configuration
from swift_ros.configuration import setting
from swift_ros.messages.control import to_command, to_policy_step
from swift_ros.messages.motion import odometry_from_bytes
from swift_ros.messages.stamps import from_time
from swift_ros.nodes.shell import Shell, run
from swift_ros.policy.actor import Actor
from swift_ros.policy.pilot import Pilot
from swift_ros.track import Track
from swift_ros.trained_for.pilot import pilot_warnings
from swift_ros.vehicle import Vehicle


@dataclass(frozen=True)
class Settings:
    """Settings of the node policy."""

    model: str = setting("ONNX file, relative to the configuration folder")


class PolicyNode(Shell):
    """Subscribes state/odometry and race/status, publishes policy/step and command/body_rate_thrust."""

    def __init__(self):
        super().__init__("policy", Settings)
        track = configuration.load(Track, self.folder / "track.yaml")
        vehicle = configuration.load(Vehicle, self.folder / "drone.yaml")
        model = self.folder / self.settings.model
        self._pilot = Pilot(Actor(model), track, vehicle)
        for sentence in pilot_warnings(model, track, vehicle):
            self.get_logger().warning(sentence)
        self._step = self.publisher("policy/step")
        self._command = self.publisher("command/body_rate_thrust")
        self.subscribe("race/status", self._on_status)
        self.subscribe("state/odometry", self._on_state, raw=True)

    def _on_status(self, message):
        self._pilot.announce(from_time(message.header.stamp), message.state)

    def _on_state(self, data: bytes):
        try:
            step = self._pilot.update(odometry_from_bytes(data))
        except ValueError as error:
            # Without an answer the last command becomes stale and the failsafe of the node betaflight takes over.
            self.diagnose("error", f"state/odometry: {error}")
            return
        self._command.publish(to_command(step.command))
        stamp_ns = step.command.stamp_ns
        self._step.publish(to_policy_step(stamp_ns, step.observation, step.action, step.next_gate, step.lap))


def main():
    """Run the node."""
    run(PolicyNode)
