"""Node race_monitor: judge of the race, its services, and health of the graph.

It monitors rates, latencies, silent topics, and topics with more than one publisher.
"""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from swift_ros import configuration
from swift_ros.graph.topic_health import TopicMonitor
from swift_ros.graph.topic_table import TOPICS
from swift_ros.messages.motion import odometry_from_bytes
from swift_ros.messages.race import to_race_status, to_track_markers
from swift_ros.messages.serialization import deserialize
from swift_ros.messages.stamps import from_time, header_stamp_ns, to_time
from swift_ros.nodes.bound_subscription import publisher_names
from swift_ros.nodes.polled_subscriptions import PolledSubscriptions
from swift_ros.nodes.shell import LEVELS, Shell, run
from swift_ros.race.control import LinkStatus, RaceControl, RaceSettings, Refused
from swift_ros.race.judge import ARMED, RACING, Judge
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_ros.working_time import WorkingTime

RUNNER = "runner"  # name under which the process that starts the nodes reports on /diagnostics that one has died
LINK = "betaflight"  # node whose errors are the reasons of an end by the flight controller
REASON_LINKS = 5  # link messages with the failsafe for which its reason may arrive later, on another topic
OWN = tuple(topic.name for topic in TOPICS.values() if not topic.shared)  # topics with one publisher
CHECK_S = 0.02  # s; period of the check for silent topics, and in real time of the taking of messages
REPORT_S = 1.0  # s; period of the report on /diagnostics
MIN_MONITORED_HZ = 10  # Hz, lowest nominal rate of a monitored topic; in the table only /diagnostics is slower


class RaceMonitorNode(Shell):
    """Node around RaceControl (with its Judge) and TopicMonitor."""

    def __init__(self):
        super().__init__("race_monitor", RaceSettings)
        self.track = configuration.load(Track, self.folder / "track.yaml")
        vehicle = configuration.load(Vehicle, self.folder / "drone.yaml")
        self.judge = Judge(self.track, vehicle.hull_radius, vehicle.hull_height, contact=False)
        self.control = RaceControl(self.judge, self.settings, ahead=self.lockstep)
        self.topic_monitor = TopicMonitor(self.settings.nodes)
        self._status, self._progress = self.publisher("race/status"), self.publisher("race/judged")
        self._link_error, self._failsafe_links = "", 0
        # In lockstep the graph waits for a slow machine: only time in which the machine kept up is a silence.
        self._silence_clock_s = WorkingTime().now_s if self.lockstep else time.monotonic
        self._progress_ns, self._clock_ns, self._clock_moved_s = None, 0, self._silence_clock_s()
        self._markers = self.publisher("track/markers")
        self._markers.publish(to_track_markers(self.track))
        self._publish([self.control.idle()])
        self._polled, self._on_polled = PolledSubscriptions(), {}
        self._subscribe_all()
        for name in ("arm", "start", "stop"):
            self.create_service(
                Trigger, f"race/{name}", lambda request, response, name=name: self._call(name, response)
            )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(CHECK_S, self._check, clock=steady)
        self.create_timer(REPORT_S, self._report, clock=steady)

    def _subscribe_all(self) -> None:
        callbacks = {
            "ground_truth/odometry": self._truth,
            "state/odometry": self._state,
            "betaflight/link": self._link,
        }
        for topic in TOPICS.values():
            fast = (topic.rate_hz or 0) >= MIN_MONITORED_HZ and topic.name not in ("/clock", "race/judged")
            if topic.name in callbacks or fast:
                self._watch(topic, callbacks.get(topic.name))
        self.subscribe("/diagnostics", self._diagnostic)

    def _watch(self, topic, callback) -> None:
        """Monitor a topic; its messages are deserialized only where a callback needs them.

        Simulated time waits for each message to be judged. In real time they are taken together at every check, for
        1,000 callbacks a second would take a sixth of a core.
        """

        def on_data(data: bytes, received_ns: int):
            stamp_ns = header_stamp_ns(data)
            if topic.name == "betaflight/link":
                stamp_ns = callback(deserialize(data, topic.type))
            elif callback:
                callback(data)
            self.topic_monitor.record(topic.name, stamp_ns, received_ns, self._silence_clock_s())

        def on_data_in_lockstep(data: bytes):
            on_data(data, self.now_ns())
            self._publish_progress()

        if self.lockstep:
            self.subscribe(topic.name, on_data_in_lockstep, raw=True)
        else:
            subscription, check = self.polled(topic.name)
            self._polled.add(topic.name, subscription)
            self._on_polled[topic.name] = check, on_data

    def _take_polled(self) -> None:
        """In real time, process all messages that have been received."""
        for each in self._polled.take():
            check, on_data = self._on_polled[each.key]
            if check.accepts(each.message, each.info):
                on_data(each.message, each.received_ns)
        self._publish_progress()

    def _truth(self, data: bytes) -> None:
        self.judge.contact = True
        self._pose(data)

    def _state(self, data: bytes) -> None:
        if not self.judge.contact:
            self._pose(data)

    def _pose(self, data: bytes) -> None:
        self._publish(self.control.update_pose(odometry_from_bytes(data)))

    def _link(self, message) -> int:
        """Process betaflight/link; return the stamp (ns) of the command that it answers."""
        answered_ns = from_time(message.command_stamp)
        stamp_ns = answered_ns if self.lockstep else from_time(message.header.stamp)
        link = LinkStatus(
            stamp_ns,
            message.armed,
            tuple(message.arming_blocks),
            "ANGLE" in message.modes,
            message.failsafe,
            self._link_error,
        )
        events = self.control.update_link(link)
        self._failsafe_links = self._failsafe_links + 1 if link.failsafe else 0
        if link.failsafe and self.control.state == RACING:
            node = self.topic_monitor.node_at_fault(self.now_ns(), self._silence_clock_s())
            text = f"{node} is silent" if node else link.reason
            if text or self._failsafe_links > REASON_LINKS:
                events += self.control.abort(stamp_ns, text or "the failsafe of betaflight is active")
        self._publish(events)
        return answered_ns

    def _publish(self, events) -> None:
        for event in events:
            if event.state == ARMED:
                self._link_error = ""
            self._status.publish(to_race_status(event))
            self.get_logger().info(f"{event.state}: {event.text}")

    def _publish_progress(self) -> None:
        """Publish up to when the race is judged, if that has moved on."""
        progress_ns = self.control.judged_ns
        if progress_ns is not None and progress_ns != self._progress_ns:
            self._progress_ns = progress_ns
            self._progress.publish(Header(stamp=to_time(progress_ns), frame_id="map"))

    def _call(self, name: str, response):
        """Run one of the race services."""
        self._take_polled()  # what came before the call comes first
        try:
            if name == "arm":
                self.control.obstacles = self._missing_topics() + self._contested_topics()
            events = getattr(self.control, name)(self.now_ns())
            self._publish(events)
            response.success, response.message = True, events[-1].text
        except Refused as refusal:
            response.success, response.message = False, str(refusal)
        return response

    def _missing_topics(self) -> list[str]:
        """Return a sentence about the topics that have no message yet, if there are any."""
        missing = self.topic_monitor.topics_not_received()
        return [f"no message received on {', '.join(missing)}; start the nodes that publish there"] if missing else []

    def _contested_topics(self) -> list[str]:
        """Return a sentence for each topic of the table that has more publishers than its own."""
        counts = {name: self.count_publishers(name) for name in OWN}
        return [
            f"{name} has {count} publishers: {publisher_names(self, name)}; leave only one"
            for name, count in counts.items()
            if count > 1
        ]

    def _diagnostic(self, message) -> None:
        self._take_polled()
        for status in message.status:
            if status.level != DiagnosticStatus.ERROR:
                continue
            if status.name == RUNNER:
                self._publish(self.control.abort(self.now_ns(), status.message))
            elif status.name == LINK:
                self._link_error = status.message

    def _check(self) -> None:
        """Take messages; end the race when a topic is silent on both clocks, or the ROS clock has stopped."""
        self._take_polled()
        now_ns, steady_s = self.now_ns(), self._silence_clock_s()
        self.topic_monitor.count_check()
        if now_ns != self._clock_ns:
            self._clock_ns, self._clock_moved_s = now_ns, steady_s
        if self.control.state not in (ARMED, RACING) and not self.control.flies_on:
            return
        silent = self.topic_monitor.silent_topics(now_ns)
        stalled = steady_s - self._clock_moved_s > self.settings.stall_s
        if silent or stalled:
            node = self.topic_monitor.node_at_fault(now_ns, steady_s)
            waited = "the clock waits for it" if node else "the clock has stopped"
            reason = waited if stalled else f"no message on {silent[0]}"
            self._publish(self.control.abort(now_ns, f"{node or 'the simulator'} is silent: {reason}"))

    def _report(self) -> None:
        racing = self.control.state in (ARMED, RACING)
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        statuses = []
        for health in self.topic_monitor.health(self.now_ns(), racing):
            numbers = (("rate_hz", health.rate_hz), ("latency_p50_ms", health.latency_p50_ms))
            numbers += (("latency_p99_ms", health.latency_p99_ms), ("age_s", health.age_s))
            status = DiagnosticStatus(level=LEVELS[health.level], name=f"topic {health.topic}", message=health.text)
            status.values = [KeyValue(key=key, value=f"{value:.2f}") for key, value in numbers]
            statuses.append(status)
        array.status = statuses
        self.control.obstacles = self._contested_topics()
        for sentence in self.control.obstacles:
            self.diagnose("error", sentence)
        self._diagnostics.publish(array)


def main() -> None:
    """Run the node."""
    run(RaceMonitorNode)
