"""Record the running graph into a bag (rosbag2 MCAP), until Ctrl-C."""

import contextlib
import json
import sys
import time
from pathlib import Path

from swift_ros.graph.domain import chosen_domain
from swift_ros.graph.topic_table import VEHICLE_NAMESPACE
from swift_ros.text import align

# s; period of the progress line: on a terminal, where it is overwritten, and in a file, where every line stays
PROGRESS_EVERY_S = {True: 0.5, False: 5.0}


def command(subparsers) -> None:
    """Add the parser of `swiftros record`."""
    parser = subparsers.add_parser("record", help=__doc__, description=__doc__)
    parser.add_argument("--out", metavar="DIR", help="folder of the new bag (default: recordings/DATE_TIME)")
    parser.add_argument(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        default=["all"],
        help="such as state/odometry; all: every topic of the graph's table (default); other topics by full name",
    )
    parser.add_argument("--seconds", type=float, default=float("inf"), help="duration of the recording, s")
    parser.add_argument("--config", metavar="DIR", help="configuration folder, stored in the bag")
    parser.add_argument("--domain", type=int, help="ROS domain (default: ROS_DOMAIN_ID, else a running race's)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Record. Return 0 when a message was recorded, else 1. Raises UsageError when DIR cannot be written."""
    from swift_ros.nodes.domain_listener import DomainListener  # imports ROS
    from swift_ros.nodes.recorder import RecorderNode
    from swift_ros.nodes.shell import running_node, spin, stop_requests

    domain = chosen_domain(arguments.domain)
    with DomainListener(domain) as listener:
        lockstep = "/clock" in listener.published_topics()
    out = Path(arguments.out or time.strftime("recordings/%Y-%m-%d_%H-%M-%S"))
    ros_arguments = ["--ros-args", *node_arguments(arguments, out, lockstep)]
    with running_node(RecorderNode, ros_arguments, domain) as node:
        print(f"recording to {out}, ROS domain {domain}{', on simulated time' if lockstep else ''}; Ctrl-C ends it")
        with contextlib.suppress(KeyboardInterrupt):
            spin(node, stop_requests(), Progress(node, arguments.seconds).is_over)
    conclude(out, node)
    return 0 if any(node.counts.values()) else 1


def node_arguments(arguments, out: Path, lockstep: bool) -> list[str]:
    """Return the ROS arguments of the node recorder."""
    values = {"folder": str(out), "topics": ",".join(arguments.topics), "use_sim_time": lockstep}
    if arguments.config:
        values["config"] = arguments.config
    parameters = [word for name, value in values.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
    return ["-r", f"__ns:=/{VEHICLE_NAMESPACE}", *parameters]


class Progress:
    """Prints the progress of a recording of `seconds` s that starts now."""

    def __init__(self, node, seconds: float):
        self._node, self._seconds = node, seconds
        self._begun_s = self._printed_s = time.monotonic()

    def is_over(self) -> bool:
        """Return whether the recording is complete; print a progress line periodically."""
        now_s, terminal = time.monotonic(), sys.stdout.isatty()
        if now_s - self._printed_s >= PROGRESS_EVERY_S[terminal]:
            self._printed_s = now_s
            counts = [count for count in self._node.counts.values() if count]
            line = f"{now_s - self._begun_s:7.1f} s  {sum(counts)} messages of {len(counts)} topics"
            print(f"\r{line}" if terminal else line, end="" if terminal else "\n", flush=True)
        return now_s - self._begun_s >= self._seconds


def conclude(out: Path, node) -> None:
    """Print the number of messages by topic and write `result.json`."""
    rows = [("topic", "messages"), *((name, str(count)) for name, count in node.counts.items() if count)]
    print("\n" + (align(rows) if len(rows) > 1 else "no message was received; the bag is empty"))
    content = {"bag": str(out), "messages": node.counts, "fault": node.fault}
    (out / "result.json").write_text(json.dumps(content, indent=1) + "\n")
