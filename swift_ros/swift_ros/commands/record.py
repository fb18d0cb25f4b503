"""Record the running graph into a bag (rosbag2 MCAP), until Ctrl-C."""

import contextlib
import json
import sys
import time
from pathlib import Path

from swift_ros.graph.runner import chosen_domain
from swift_ros.graph.topic_table import VEHICLE_NAMESPACE
from swift_ros.text import align

TELL_EVERY_S = {True: 0.5, False: 5.0}  # on a terminal, and where lines stay


def command(subparsers) -> None:
    """Add the parser of `swiftros record`."""
    parser = subparsers.add_parser("record", help=__doc__, description=__doc__)
    parser.add_argument("--out", metavar="DIR", help="folder of the new bag (default: by the time, in recordings/)")
    parser.add_argument(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        default=["all"],
        help="such as state/odometry; all: those of the graph's table (default); others by full name",
    )
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--config", metavar="DIR", help="configuration folder, kept in the bag")
    parser.add_argument("--domain", type=int, help="ROS domain (default: ROS_DOMAIN_ID, else a running race's)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Record. Returns 0 when anything was recorded, 1 when not. Raises UsageError when DIR cannot be written."""
    from swift_ros.nodes.ear import Ear
    from swift_ros.nodes.recorder import RecorderNode
    from swift_ros.nodes.shell import spin, started, stop_requests

    domain = chosen_domain(arguments.domain)
    with Ear(domain) as ear:
        lockstep = "/clock" in ear.live()
    out = Path(arguments.out or time.strftime("recordings/%Y-%m-%d_%H-%M-%S"))
    words = ["--ros-args", *node_arguments(arguments, out, lockstep)]
    with started(RecorderNode, words, domain) as node:
        print(f"recording to {out}, ROS domain {domain}{', on simulated time' if lockstep else ''}; Ctrl-C ends it")
        with contextlib.suppress(KeyboardInterrupt):
            spin(node, stop_requests(), Progress(node, arguments.seconds).is_over)
    conclude(out, node)
    return 0 if any(node.counts.values()) else 1


def node_arguments(arguments, out: Path, lockstep: bool) -> list[str]:
    """Return the ROS arguments of the recorder's node."""
    values = {"folder": str(out), "topics": ",".join(arguments.topics), "use_sim_time": lockstep}
    if arguments.config:
        values["config"] = arguments.config
    parameters = [word for name, value in values.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
    return ["-r", f"__ns:=/{VEHICLE_NAMESPACE}", *parameters]


class Progress:
    """Tells how far a recorder is, which records for so many seconds from now on."""

    def __init__(self, node, seconds: float):
        self._node, self._seconds = node, seconds
        self._begun_s = self._told_s = time.monotonic()

    def is_over(self) -> bool:
        """Return whether the time is over; say once in a while what was recorded until now."""
        now_s, terminal = time.monotonic(), sys.stdout.isatty()
        if now_s - self._told_s >= TELL_EVERY_S[terminal]:
            self._told_s = now_s
            heard = [count for count in self._node.counts.values() if count]
            line = f"{now_s - self._begun_s:7.1f} s  {sum(heard)} messages of {len(heard)} topics"
            print(f"\r{line}" if terminal else line, end="" if terminal else "\n", flush=True)
        return now_s - self._begun_s >= self._seconds


def conclude(out: Path, node) -> None:
    """Tell what was recorded, and write it to `result.json`."""
    rows = [("topic", "messages"), *((name, str(count)) for name, count in node.counts.items() if count)]
    print("\n" + (align(rows) if len(rows) > 1 else "nobody spoke; nothing was recorded"))
    content = {"bag": str(out), "messages": node.counts, "fault": node.fault}
    (out / "result.json").write_text(json.dumps(content, indent=1) + "\n")
