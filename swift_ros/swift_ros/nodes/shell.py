"""Base class of all nodes: settings, publishers and subscriptions from the graph's table, and the function `main`."""

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
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from swift_ros.errors import UsageError
from swift_ros.graph.discovery import confine
from swift_ros.graph.qos import DEEP, DEPTH, publisher_profile, qos_profile
from swift_ros.graph.topic_table import NODES, TOPICS
from swift_ros.messages.serialization import message_type
from swift_ros.nodes import parameters
from swift_ros.nodes.bound_subscription import PublisherCheck, Subscriber
from swift_ros.nodes.latched_publisher import LatchedPublisher
from swift_ros.nodes.polled_subscriptions import PollingNode, take_all

SHUTDOWN_POLL_S = 0.2  # s; longest time until a requested shutdown is noticed
LONGEST_SPIN_S = 60.0  # s
LOG_INTERVAL_S = 1.0  # s; a sentence is logged at most once in this time
LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


def without_numbers(text: str) -> str:
    """Return a sentence with "#" for each number: sentences that differ in numbers alone count as one."""
    return re.sub(r"[-+.\d]+", "#", text)


class Shell(PollingNode):
    """A node with settings, and with publishers and subscriptions by their topic's name in the graph's table.

    Attributes:
        settings: an instance of `settings_type`.
        folder: the configuration folder, a Path.
        lockstep: whether the node runs on simulated time.
        background_threads: native identifiers of threads that may be late; they get the `background_priority` of the
            node's row. Where other threads need Python's global interpreter lock that priority is a real-time priority
            too: a background thread that is not scheduled could not release the lock.
    """

    background_threads: frozenset[int] = frozenset()

    def __init__(self, name: str, settings_type):
        super().__init__(name)
        self.folder = parameters.folder(self)
        self.settings = parameters.read(self, name, settings_type)
        self.lockstep = parameters.lockstep(self)
        self._diagnostics = self.publisher("/diagnostics")
        self._subscriber = Subscriber(self, self.lockstep, self.now_ns, lambda text: self.diagnose("warn", text))
        self._logged_at = {}

    def publisher(self, topic_name: str):
        """Return a publisher for a topic of the table."""
        topic = TOPICS[topic_name]
        kind, profile = message_type(topic.type), publisher_profile(topic, self.lockstep)
        publisher = self.create_publisher(kind, topic_name, profile)
        return LatchedPublisher(publisher) if topic.latched and not self.lockstep else publisher

    def subscribe(self, topic_name: str, callback, raw: bool = False):
        """Subscribe `callback(message)` to one publisher of a topic of the table and return the subscription.

        Args:
            topic_name: its name in the table.
            callback: called with each message.
            raw: hand over CDR bytes instead of messages.
        """
        return self._subscriber.subscribe(TOPICS[topic_name], callback, raw)

    def polled(self, topic_name: str):
        """Return a polled subscription to a topic of one publisher, for CDR bytes, and the check of its messages.

        Its queue lasts for seconds, but for images: in real time the node may be late, and then needs all messages.
        """
        topic = TOPICS[topic_name]
        profile = qos_profile(topic, self.lockstep)
        profile.depth = max(profile.depth, DEPTH if topic.image else DEEP)
        subscription = self.create_polled_subscription(message_type(topic.type), topic_name, profile, raw=True)
        return subscription, PublisherCheck(self._subscriber, topic)

    def poll(self, topic_name: str) -> Callable[[], list[bytes]]:
        """Subscribe to a topic of one publisher without being woken by its messages.

        Returns:
            function that returns the CDR bytes of all messages received since its last call, oldest first.
        """
        subscription, check = self.polled(topic_name)
        return lambda: [data for data, info in take_all(subscription) if check.accepts(data, info)]

    def now_ns(self) -> int:
        """Return the time of the node's clock, ns.

        In real time this reads the system clock directly: the ROS clock is too slow for nodes that receive 900 messages
        per second.
        """
        return self.get_clock().now().nanoseconds if self.lockstep else time.time_ns()

    def diagnose(self, level: str, text: str, **values) -> None:
        """Publish a sentence about this node on /diagnostics and log it.

        Sentences that differ only in their numbers are logged at most once per second.

        Args:
            level: "ok", "warn" or "error".
            text: the sentence.
            values: numbers for plots, by name.
        """
        status = DiagnosticStatus(level=LEVELS[level], name=self.get_name(), message=text)
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        now, sentence = time.monotonic(), without_numbers(text)
        if now - self._logged_at.get(sentence, -1.0) >= LOG_INTERVAL_S:
            self._logged_at[sentence] = now
            self._log(level, text)

    def _log(self, level: str, text: str) -> None:
        # One line for each severity: rclpy refuses two severities from the same line of code.
        if level == "error":
            self.get_logger().error(text)
        elif level == "warn":
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)


def stop_requests() -> list[int]:
    """Install signal handlers and return the list to which they append SIGINT and SIGTERM.

    The first signal lets the current callback finish, so that no answer is cut off; a second signal ends the process at
    once. ROS must have been initialised without signal handlers of its own.
    """
    requests = []

    def on_signal(number, frame):
        requests.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, on_signal)
    return requests


def spin(node, requests: list[int], is_over: Callable[[], bool] = lambda: False) -> None:
    """Run a node's callbacks until a signal is received, `is_over` returns True, or ROS is shut down.

    One call of the executor serves all callbacks: a call visits all timers and services of the node, which for each
    message would take as long as the message. The EventsExecutor costs a third of the default executor's 0.3 ms for
    each message.

    Args:
        node: the node.
        requests: the received signals, see `stop_requests`.
        is_over: condition that ends the loop, read every SHUTDOWN_POLL_S.
    """
    executor, ended = EventsExecutor(), Future()

    def look() -> None:
        if (requests or is_over() or not rclpy.ok()) and not ended.done():
            ended.set_result(None)

    # A timer has its turn among the messages also while they come faster than they are processed.
    timer = node.create_timer(SHUTDOWN_POLL_S, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        while not ended.done():  # without a limit of time, rclpy 7.1 neither serves timers nor waits
            executor.spin_until_future_complete(ended, timeout_sec=LONGEST_SPIN_S)
    node.destroy_timer(timer)


def set_thread_priorities(node) -> None:
    """Give the threads of a real-time node the priorities of its row in the table, where the system permits it."""
    row = NODES[node.get_name()]
    if node.lockstep or row.priority is None:
        return
    try:
        for thread in (int(name) for name in os.listdir("/proc/self/task")):
            priority = row.background_priority if thread in node.background_threads else row.priority
            if priority:
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        node.diagnose("warn", "no permission for real-time priorities; set 'rtprio 30' in /etc/security/limits.conf")


@contextlib.contextmanager
def running_node(node_type, arguments: list[str] | None = None, domain: int | None = None):
    """Start ROS and a node; leaving the context closes both.

    Args:
        node_type: class of the node.
        arguments: command line, by default this process's own.
        domain: ROS domain, by default ROS_DOMAIN_ID.
    """
    confine()
    rclpy.init(args=arguments, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
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
    """Start ROS and a node, and run it until shutdown. On a UsageError print its sentence and exit with code 2."""
    try:
        with running_node(node_type) as node:
            requests = stop_requests()  # before anything else: from here on the node must be closed in order
            gc.collect()
            gc.freeze()  # else a collection in flight visits all imported modules, which takes tens of milliseconds
            set_thread_priorities(node)
            spin(node, requests)
    except UsageError as error:
        print(f"{node_type.__module__.rsplit('.', 1)[-1]}: {error}", file=sys.stderr, flush=True)
        sys.exit(2)
    except KeyboardInterrupt:
        pass
