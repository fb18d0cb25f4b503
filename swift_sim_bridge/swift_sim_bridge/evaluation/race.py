"""Flies one race: fresh processes, the graph from podium to end, and the result read back from the recorded bag."""

import json
import math
import os
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from swift_ros import messages
from swift_ros.graph import NODES, TOPICS, VEHICLE_NAMESPACE
from swift_ros.nodes.race_monitor import RUNNER
from swift_ros.nodes.shell import quality
from swift_ros.race import ENDS, FINISHED, IDLE, LOST, RACING, RaceEvent
from swift_ros.race_result import BAG, FAULTS, REPORT
from swift_ros.runner import DISCOVERY, Runner, free_domain

RACERS = tuple(name for name in NODES if name != "camera")  # the simulator stands in for the camera
ARM_S, START_S = 1.0, 0.5
SPIN_S = 0.02
START_PATIENCE_S = 300.0  # wall: processes start, the simulator compiles
QUIET_PATIENCE_S = 90.0  # wall: between two words of the graph
SERVICE_PATIENCE_S = 5.0
AFTER_FINISH_S = 0.5  # of the race's clock: the race is over, the landing nobody's concern
AFTER_END_S = 4.0  # of the race's clock: by then the vehicle must be disarmed
AFTER_END_PATIENCE_S = 30.0  # wall


@dataclass(frozen=True)
class RaceOptions:
    """How to fly. config: folder; out: folder of this race; real_time: system clock instead of lockstep; discovery: how
    far the graph is heard, "local" or "subnet"; tell: is given each line to print; sitl: path of a Betaflight SITL
    binary that flies instead of the simulated flight controller, "" for none."""

    config: Path
    out: Path
    real_time: bool
    discovery: str
    tell: Callable[[str], None]
    sitl: str = ""


class Listener:
    """This process's own node in the graph: hears the race's course, and says when a node dies."""

    def __init__(self, domain: int, discovery: str, lockstep: bool, tell):
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = DISCOVERY[discovery]
        self.context = rclpy.Context()
        self.context.init(domain_id=domain)
        self._node = rclpy.create_node(RUNNER, context=self.context, namespace=VEHICLE_NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self._node)
        for name, callback in (("race/status", self._status), ("betaflight/link", self._link)):
            topic = TOPICS[name]
            kind = messages.message_type(topic.type)
            self._node.create_subscription(kind, name, callback, quality(topic, lockstep))
        diagnostics = quality(TOPICS["/diagnostics"], lockstep)
        self._voice = self._node.create_publisher(DiagnosticArray, "/diagnostics", diagnostics)
        self._tell = tell
        self.faults: list[str] = []
        self.begun_ns: int | None = None
        self.end: RaceEvent | None = None
        self.passages = 0
        self.armed = False
        self.link_ns = 0
        self.safe_ns: int | None = None  # stamp of the first word of the link, since the start, that a failsafe acts
        self.disarmed_ns: int | None = None
        self.heard_s = time.monotonic()

    def spin(self) -> None:
        """Hear what there is for a moment."""
        self._executor.spin_once(timeout_sec=SPIN_S)

    def say(self, fault: str) -> None:
        """Print, keep and tell the race monitor that a node is lost."""
        self._tell(f"  {fault}")
        self.faults.append(fault)
        status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name=RUNNER, message=fault)
        self._voice.publish(DiagnosticArray(status=[status]))

    def ends(self, topic: str) -> tuple[list[str], list[str]]:
        """Return the names of the nodes that speak on a topic of the table, and of those that hear it, now."""
        speakers = self._node.get_publishers_info_by_topic(topic)
        hearers = self._node.get_subscriptions_info_by_topic(topic)
        return tuple(sorted(end.node_name for end in ends) for ends in (speakers, hearers))

    def ask(self, service: str) -> str:
        """Call one of the race services; return why it was refused, "" when it was granted."""
        client = self._node.create_client(Trigger, service)
        answer = client.call_async(Trigger.Request())
        deadline_s = time.monotonic() + SERVICE_PATIENCE_S
        while not answer.done() and time.monotonic() < deadline_s:
            self.spin()
        self._node.destroy_client(client)
        if not answer.done():
            return f"{service} did not answer; see the log of race_monitor"
        return "" if answer.result().success else answer.result().message

    def lose(self, why: str) -> None:
        """End the race in the place of a race monitor that cannot."""
        self.end = RaceEvent(self.link_ns, LOST, text=why)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self.context.try_shutdown()

    def _link(self, message) -> None:
        self.armed, self.link_ns = message.armed, messages.stamp_ns(message.header.stamp)
        self.heard_s = time.monotonic()
        if self.begun_ns is not None and self.safe_ns is None and (message.failsafe or not message.armed):
            self.safe_ns = self.link_ns
        if self.begun_ns is not None and self.disarmed_ns is None and not message.armed:
            self.disarmed_ns = self.link_ns

    def _status(self, message) -> None:
        event = messages.from_race_status(message)
        self.heard_s = time.monotonic()
        if event.state == RACING and not event.is_passage:
            self.begun_ns = event.stamp_ns
        self.passages += event.is_passage
        if event.state != IDLE:
            self._tell(self._line(event))
        if event.state in ENDS:
            self.end = event

    def _line(self, event: RaceEvent) -> str:
        clock = f"{1e-9 * (event.stamp_ns - self.begun_ns):7.3f} s" if self.begun_ns is not None else " " * 9
        line = f"  {clock}  {event.text or event.state}"
        if event.is_passage:
            line += f", split {event.split_s:.3f} s"
        if not math.isnan(event.margin_m):
            line += f", margin {event.margin_m:.2f} m"
        return line if event.is_passage or event.state not in ENDS else f"{line} ({event.state})"


def free_port() -> int:
    """Return a TCP port of the loopback interface that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def node_parameters(seed: int, config: Path, out: Path, sitl: str = "") -> dict[str, dict]:
    """Return the ROS parameters of a race, by node; config: configuration folder, out: folder of this race."""
    port = free_port()
    watched = [name for name in RACERS if NODES[name].publishes]
    return {
        "*": {"config": str(config.resolve())},
        "bridge": {
            "seed": seed, "port": port, "report": str((out / REPORT).resolve()),
            "nodes": [name for name in RACERS if name != "bridge"], "sitl": sitl,
        },
        "betaflight": {"port": f"tcp://127.0.0.1:{port}", "connect_timeout_s": START_PATIENCE_S},
        "race_monitor": {"auto_arm_s": ARM_S, "auto_start_s": START_S, "nodes": watched},
        "recorder": {"folder": str((out / BAG).resolve())},
    }


class Flight:
    """One race in its own processes. Use as a context: leaving it ends them; the bag, the logs and the simulator's
    report stay in `options.out`.

    nodes: the Runner; listener: what is heard. Raises UsageError when a node refuses its input.
    """

    def __init__(self, seed: int, options: RaceOptions):
        self.options = options
        options.out.mkdir(parents=True, exist_ok=True)
        domain, self._reservation = free_domain()
        if options.discovery != "local":
            options.tell(f"  ROS domain {domain} is open to the subnet: anyone on it can publish commands")
        self.listener = Listener(domain, options.discovery, not options.real_time, options.tell)
        parameters = node_parameters(seed, options.config, options.out, options.sitl)
        how = {"lockstep": not options.real_time, "domain": domain, "discovery": options.discovery}
        self.nodes = Runner(RACERS, options.out / "logs", parameters, **how)

    def __enter__(self):
        self._begun_s = time.monotonic()
        self.nodes.__enter__()
        return self

    def __exit__(self, *exception):
        self.nodes.stop([name for name in RACERS if name not in ("bridge", "recorder")])
        self.nodes.stop(["recorder"])  # it hears the others out
        self.nodes.stop()
        self.listener.close()
        if self._reservation:
            self._reservation.close()
        (self.options.out / FAULTS).write_text(json.dumps(self.listener.faults, indent=1))

    def follow(self, until: Callable[[], bool] = lambda: False) -> None:
        """Listen until the race has ended, nothing more can come of it, or `until` holds."""
        listener = self.listener
        while listener.end is None and not until():
            listener.spin()
            for fault in self.nodes.faults():
                listener.say(fault)
                # nobody is left who could end the race, or it has not begun and never will
                if fault.startswith(("race_monitor", "bridge")) or not listener.link_ns:
                    listener.lose(fault)
            quiet_s, patience_s = time.monotonic() - self._begun_s, START_PATIENCE_S
            if listener.link_ns:
                quiet_s, patience_s = time.monotonic() - listener.heard_s, QUIET_PATIENCE_S
            if quiet_s > patience_s and listener.end is None:
                listener.say(f"the graph said nothing for {quiet_s:.0f} s; see {self.options.out / 'logs'}")
                listener.lose(listener.faults[-1])

    def play_out(self) -> None:
        """Let the end of the flight play out: until the vehicle is disarmed, or a while of the race's clock is over."""
        listener = self.listener
        mute = any(fault.startswith("betaflight") for fault in listener.faults)  # then time keeps to the wall
        deadline_s = time.monotonic() + (AFTER_END_S if mute else AFTER_END_PATIENCE_S)
        end_ns, wait_s = listener.end.stamp_ns, AFTER_FINISH_S if listener.end.state == FINISHED else AFTER_END_S
        while listener.armed and listener.link_ns - end_ns < 1e9 * wait_s and time.monotonic() < deadline_s:
            listener.spin()
            self.nodes.faults()
            if "bridge" not in self.nodes.running():
                return


def fly(seed: int, options: RaceOptions) -> None:
    """Fly one race. Raises UsageError when a node refuses its input."""
    with Flight(seed, options) as flight:
        flight.follow()
        flight.play_out()
