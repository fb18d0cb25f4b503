"""Node of a soak: watches the age of the commands, and flies the simulator by topics where a soak asks for it."""

from swift_ros.messages.control import to_command
from swift_ros.messages.motion import from_odometry
from swift_ros.messages.stamps import from_time, message_stamp_ns
from swift_ros.nodes.guest import Guest
from swift_sim_bridge.soak.hover import hover_command
from swift_sim_bridge.soak.late_commands import LATE_S, LateCommand, Stalls

TRUTH, COMMAND, LINK = "ground_truth/odometry", "command/body_rate_thrust", "betaflight/link"
SPIN_S = 0.02  # s; also the period of the readings of the stalls


class Watcher:
    """Receives betaflight/link of a graph in real time.

    Attributes:
        late: commands that were late since they were last taken from this list.
        commands: number of commands that were answered by a frame.
    """

    def __init__(self, domain: int, flies: bool):
        """Join the graph.

        Args:
            domain: ROS domain.
            flies: publish the commands of a hovering pilot.
        """
        self._guest = Guest("soak", domain, lockstep=False)
        self._stalls, self._place = Stalls(), None
        self.late: list[LateCommand] = []
        self.commands, self._answered_ns = 0, 0
        self._guest.subscribe(LINK, self._on_link, counts=True)
        if flies:
            self._command = self._guest.publisher(COMMAND)
            self._guest.subscribe(TRUTH, self._on_truth)

    def spin(self) -> None:
        """Process the messages of SPIN_S."""
        self._stalls.take()
        self._guest.spin(SPIN_S)

    def _on_link(self, message) -> None:
        answered_ns, written_ns = from_time(message.command_stamp), message_stamp_ns(message)
        if not message.armed or answered_ns <= self._answered_ns:
            return
        self._answered_ns, self.commands = answered_ns, self.commands + 1
        late_s = 1e-9 * (written_ns - answered_ns)
        if late_s > LATE_S:
            waited_s = self._stalls.between(1e-9 * answered_ns, 1e-9 * written_ns)
            self.late.append(LateCommand(answered_ns, late_s, waited_s))

    def _on_truth(self, message) -> None:
        state = from_odometry(message)
        if self._place is None:
            self._place = state.p_world[:2]
        self._command.publish(to_command(hover_command(state, self._place)))

    def close(self) -> None:
        """Leave the graph."""
        self._guest.close()
