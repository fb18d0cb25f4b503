"""What every node shell shares: its settings, publishers and subscriptions from the graph's table, and its main()."""

import contextlib
import gc
import os
import re
import signal
import sys
import time
from collections.abc import Callable

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from swift_ros import messages
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES, TOPICS
from swift_ros.nodes import parameters


def quality(topic, in_lockstep: bool) -> QoSProfile:
    """Return the QoS of a row of the table: images best effort and depth 1 in real time, else reliable.

    In lockstep everything is reliable and deep enough to lose nothing, and kept for who finds its speaker late: no two
    nodes need to have met before the clock starts. Images are not kept; the simulator waits for who hears them.
    """
    best_effort = topic.image and not in_lockstep
    kept = topic.latched or (in_lockstep and not topic.image)
    depth = 1000 if in_lockstep else 1 if topic.image else 10
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


SHUTDOWN_S = 0.2  # a shutdown is noticed within this time
LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


class Shell(Node):
    """A node that knows its settings and speaks topics by their name in the graph's table.

    self.settings: an instance of `settings_type`; self.folder: the configuration folder (a Path); self.lockstep: bool.
    executor_type: EventsExecutor runs callbacks as they come, at a third of the plain one's 0.3 ms a message.
    patient_threads: native identifiers of threads that may be late and get their row's `patient_priority`. Where others
    need the interpreter's lock this is still one of real time, lest its holder be kept from letting go of it.
    """

    executor_type = EventsExecutor
    patient_threads: frozenset[int] = frozenset()

    def __init__(self, name: str, settings_type):
        super().__init__(name)
        self.folder = parameters.folder(self)
        self.settings = parameters.read(self, name, settings_type)
        self.lockstep = parameters.lockstep(self)
        self._diagnostics = self.speak("/diagnostics")
        self._logged_at = {}

    def speak(self, topic_name: str):
        """Return a publisher of a topic of the table."""
        topic = TOPICS[topic_name]
        return self.create_publisher(messages.message_type(topic.type), topic_name, quality(topic, self.lockstep))

    def hear(self, topic_name: str, callback):
        """Subscribe `callback(message)` to a topic of the table and return the subscription."""
        topic = TOPICS[topic_name]
        kind = messages.message_type(topic.type)
        return self.create_subscription(kind, topic_name, callback, quality(topic, self.lockstep))

    def now_ns(self) -> int:
        """Return the time of the node's clock; in real time without its detour, which a node of 900 messages a second
        feels."""
        return self.get_clock().now().nanoseconds if self.lockstep else time.time_ns()

    def diagnose(self, level: str, text: str, **values) -> None:
        """Publish a sentence about this node on /diagnostics and log it. level: "ok", "warn" or "error"; values: what
        a reader may want to plot. The same sentence, numbers apart, is logged at most once a second."""
        status = DiagnosticStatus(level=LEVELS[level], name=self.get_name(), message=text)
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        now, sentence = time.monotonic(), re.sub(r"[-+.\d]+", "#", text)
        if now - self._logged_at.get(sentence, -1.0) >= 1.0:
            self._logged_at[sentence] = now
            self._log(level, text)

    def _log(self, level: str, text: str) -> None:
        # One line a severity: rclpy refuses two severities from the same place in the code.
        if level == "error":
            self.get_logger().error(text)
        elif level == "warn":
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)


def stop_requests() -> list[int]:
    """Return what will hold the signals, SIGINT or SIGTERM, that ask this process to end.

    The first one lets the callback that is under way finish, so that no answer is cut off; a second one does not. ROS
    must have been initialised without signal handlers of its own.
    """
    asked = []

    def ask(number, frame):
        asked.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, ask)
    return asked


def spin(node, asked: list[int], is_over: Callable[[], bool] = lambda: False) -> None:
    """Run a node's callbacks until a signal asks for the end (see `stop_requests`), it is over, or ROS is shut down."""
    executor = type(node).executor_type()  # EventsExecutor is a function, which an instance would bind
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        while not asked and not is_over() and rclpy.ok():
            executor.spin_once(timeout_sec=SHUTDOWN_S)


def hurry(node) -> None:
    """Give the threads of a node that flies in real time the priorities of its row in the table, where allowed."""
    row = NODES[node.get_name()]
    if node.lockstep or row.priority is None:
        return
    try:
        for thread in (int(name) for name in os.listdir("/proc/self/task")):
            level = row.patient_priority if thread in node.patient_threads else row.priority
            if level:
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(level))
    except PermissionError:
        node.diagnose("warn", "no real-time priority: allow it with 'rtprio 20' in /etc/security/limits.conf")


@contextlib.contextmanager
def started(node_type, words: list[str] | None = None, domain: int | None = None):
    """Start ROS and a node; leaving the context closes both.

    words: the command line (default: this process's own); domain: default ROS_DOMAIN_ID.
    """
    rclpy.init(args=words, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = None
    try:
        node = node_type()
        yield node
    finally:
        if node is not None:
            close = getattr(node, "close", None)
            if close:
                close()
            node.destroy_node()
        rclpy.try_shutdown()


def run(node_type) -> None:
    """Start ROS, make the node, spin until shut down. Bad input: its sentence on standard error and exit code 2."""
    try:
        with started(node_type) as node:
            asked = stop_requests()  # at once: from here on there is something to be closed in order
            gc.collect()
            gc.freeze()  # else the collector walks all imported modules in mid-flight, tens of milliseconds each time
            hurry(node)
            spin(node, asked)
    except UsageError as error:
        print(f"{node_type.__module__.rsplit('.', 1)[-1]}: {error}", file=sys.stderr, flush=True)
        sys.exit(2)
    except KeyboardInterrupt:
        pass
