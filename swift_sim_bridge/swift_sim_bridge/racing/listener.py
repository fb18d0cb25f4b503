"""Node runner: follows a race for the process that started its nodes; prints their warnings and how they end."""

import math

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import Trigger

from swift_ros.graph.discovery import choose
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.race import from_race_status
from swift_ros.messages.stamps import from_time
from swift_ros.nodes.bound_subscription import Subscriber
from swift_ros.nodes.guest import Guest
from swift_ros.nodes.node_warnings import NodeWarnings
from swift_ros.nodes.race_monitor import RUNNER
from swift_ros.race.judge import ENDS, IDLE, LOST, RACING, RaceEvent
from swift_ros.working_time import WorkingTime

SPIN_S = 0.02  # s; period of `spin`, after which its caller looks at the nodes
SERVICE_PATIENCE_S = 5.0  # working time: longest wait for the answer of a service


class Listener:
    """The node of this process in the graph: follows race status and link, and reports faults.

    Attributes:
        domain: ROS domain of the graph.
        faults: reported so far.
        start_ns: stamp of the start signal; None before it.
        end: the event that ended the race; None before it.
        passages: gates passed.
        armed: by the last link status.
        link_ns: stamp of the last link status; 0 before the first.
        safe_ns: stamp of the first link status after the start with an active failsafe or disarmed; None before it.
        disarmed_ns: stamp of the first link status after the start that is disarmed; None before it.
        working_time: clock for the patience with the graph.
        last_link_s: working time of the last link status.
        last_message_s: working time of the last message.
    """

    def __init__(self, domain: int, discovery: str, lockstep: bool, progress):
        """Join the graph.

        Args:
            domain: ROS domain.
            discovery: "local" or "subnet".
            lockstep: the graph runs in lockstep.
            progress: called with each line to print.
        """
        choose(discovery)
        self._guest = Guest(RUNNER, domain, lockstep)
        subscriber = Subscriber(self._guest.node, lockstep, lambda: self.link_ns, self.warn)
        for name, callback in (("race/status", self._status), ("betaflight/link", self._link)):
            subscriber.subscribe(TOPICS[name], callback)
        self._guest.subscribe("/diagnostics", self._diagnostic)
        self._warnings = NodeWarnings()
        self._diagnostics = self._guest.publisher("/diagnostics")
        self._progress = progress
        self.domain = domain
        self.faults: list[str] = []
        self.start_ns: int | None = None
        self.end: RaceEvent | None = None
        self.passages = 0
        self.armed = False
        self.link_ns = 0
        self.safe_ns: int | None = None
        self.disarmed_ns: int | None = None
        self.working_time = WorkingTime()
        self.last_message_s = self.last_link_s = self.working_time.now_s()

    def spin(self) -> None:
        """Process the messages of SPIN_S."""
        self._guest.spin(SPIN_S)

    def report_fault(self, fault: str) -> None:
        """Print and store a fault, and publish it to the race monitor, which ends the race."""
        self._report(fault, DiagnosticStatus.ERROR)

    def warn(self, fault: str) -> None:
        """Print, store and publish a fault with which the race goes on."""
        self._report(fault, DiagnosticStatus.WARN)

    def _report(self, fault: str, level: bytes) -> None:
        self._progress(f"  {fault}")
        self.faults.append(fault)
        status = DiagnosticStatus(level=level, name=RUNNER, message=fault)
        self._diagnostics.publish(DiagnosticArray(status=[status]))

    def endpoints(self, topic: str) -> tuple[list[str], list[str]]:
        """Return the names of the nodes that publish a topic now, and of those that subscribe to it."""
        publishers = self._guest.node.get_publishers_info_by_topic(topic)
        subscribers = self._guest.node.get_subscriptions_info_by_topic(topic)
        return tuple(sorted(info.node_name for info in infos) for infos in (publishers, subscribers))

    def call(self, service: str) -> str:
        """Call a race service; return the reason of a refusal, "" if it was granted."""
        client = self._guest.node.create_client(Trigger, service)
        answer = client.call_async(Trigger.Request())
        deadline_s = self.working_time.now_s() + SERVICE_PATIENCE_S
        while not answer.done() and self.working_time.now_s() < deadline_s:
            self.spin()
        self._guest.node.destroy_client(client)
        if not answer.done():
            return f"{service} did not answer; see the log of race_monitor"
        return "" if answer.result().success else answer.result().message

    def abort(self, reason: str) -> None:
        """End the race as lost, for a race monitor that cannot."""
        self.end = RaceEvent(self.link_ns, LOST, text=reason)

    def close(self) -> None:
        """Leave the graph."""
        self._guest.close()

    def _link(self, message) -> None:
        self.armed, self.link_ns = message.armed, from_time(message.header.stamp)
        self.last_message_s = self.last_link_s = self.working_time.now_s()
        if self.start_ns is not None and self.safe_ns is None and (message.failsafe or not message.armed):
            self.safe_ns = self.link_ns
        if self.start_ns is not None and self.disarmed_ns is None and not message.armed:
            self.disarmed_ns = self.link_ns

    def _status(self, message) -> None:
        event = from_race_status(message)
        self.last_message_s = self.working_time.now_s()
        if event.state == RACING and not event.is_passage:
            self.start_ns = event.stamp_ns
        self.passages += event.is_passage
        if event.state != IDLE:
            self._progress(self._line(event))
        if event.state in ENDS:
            self.end = self.end or event  # after the finish a race may be stopped, too

    def _diagnostic(self, message) -> None:
        for line in self._warnings.new(message):
            self._progress(f"  {line}")

    def _line(self, event: RaceEvent) -> str:
        """Return an event as a line to print."""
        clock = f"{1e-9 * (event.stamp_ns - self.start_ns):7.3f} s" if self.start_ns is not None else " " * 9
        line = f"  {clock}  {event.text or event.state}"
        if event.is_passage:
            line += f", split {event.split_s:.3f} s"
        if not math.isnan(event.margin_m):
            line += f", margin {event.margin_m:.2f} m"
        return line if event.is_passage or event.state not in ENDS else f"{line} ({event.state})"
