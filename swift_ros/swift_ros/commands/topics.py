"""Inspect the running graph: list topics, measure rates and latencies, print messages."""

import contextlib
import json
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from swift_ros.commands import output
from swift_ros.errors import UsageError
from swift_ros.graph import latency
from swift_ros.graph.domain import chosen_domain
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.text import align

MAX_SHOWN_VALUES = 40  # of an array in a printed message; an image has many thousands


def command(subparsers) -> None:
    """Add the parser of `swiftros topics`."""
    parser = subparsers.add_parser("topics", help=__doc__, description=__doc__)
    actions = parser.add_subparsers(required=True, metavar="list|hz|echo|latency")
    for name, run, summary in (
        ("list", run_list, "every topic: type, nominal rate, publishers and number of subscribers"),
        ("hz", run_hz, "measured rates beside the nominal rates"),
        ("echo", run_echo, "print the messages of one topic"),
        ("latency", run_latency, "latency of each hop from image and odometry to the MSP frame"),
    ):
        action = actions.add_parser(name, help=summary, description=summary)
        action.add_argument("--domain", type=int, help="ROS domain (default: ROS_DOMAIN_ID, else a running race's)")
        action.set_defaults(run=run)
        if name == "echo":
            action.add_argument("topic", help="such as state/odometry or /clock")
            action.add_argument("--count", type=int, default=0, help="number of messages (default: until Ctrl-C)")
        elif name == "hz":
            action.add_argument("topic", nargs="*", help="such as state/odometry (default: all)")
        if name in ("hz", "latency"):
            action.add_argument(
                "--seconds", type=float, default=5.0, help="duration of the measurement, s (default %(default)s)"
            )
        if name == "latency":
            action.add_argument("--out", metavar="DIR", help="write result.json there")


def open_listener(domain: int | None):
    """Return a `DomainListener`, not yet entered, in the chosen domain."""
    from swift_ros.nodes.domain_listener import DomainListener  # imports ROS

    return DomainListener(chosen_domain(domain))


def run_list(arguments) -> int:
    """Print the topics of the table and all others; return 1 when no topic has a publisher."""
    with open_listener(arguments.domain) as listener:
        live = listener.published_topics()
        known = {full_name(topic.name): topic for topic in TOPICS.values()}
        rows = [("topic", "type", "Hz", "publishers", "subscribers")]
        for name in (*known, *sorted(set(live) - set(known) - {"/rosout", "/parameter_events"})):
            rate = known[name].rate_hz if name in known else None
            publishers = sorted({info.node_name for info in listener.node.get_publishers_info_by_topic(name)})
            kind = known[name].type if name in known else live[name]
            subscribers = str(listener.node.count_subscribers(name))
            rows.append((name, kind, f"{rate:g}" if rate else "-", ", ".join(publishers) or "-", subscribers))
    print(align(rows))
    return 0 if live else 1


def run_hz(arguments) -> int:
    """Print measured rates; return 1 when no message was received."""
    with open_listener(arguments.domain) as listener:
        live = listener.published_topics()
        wanted = [full_name(name) for name in arguments.topic] or sorted(set(live) - {"/rosout", "/parameter_events"})
        times = defaultdict(list)
        for name in wanted:
            received = times[name]
            listener.subscribe(
                name, _type_of(name, live), lambda *_, received=received: received.append(time.monotonic())
            )
        listener.spin(arguments.seconds)
    known = {full_name(topic.name): topic.rate_hz for topic in TOPICS.values()}
    rows = [("topic", "Hz", "nominal", "longest gap ms")]
    for name in wanted:
        gaps = np.diff(times[name])
        rate, longest = (f"{1 / gaps.mean():.1f}", f"{1e3 * gaps.max():.1f}") if len(gaps) else ("-", "-")
        rows.append((name, rate, f"{known.get(name) or '-'}", longest))
    print(align(rows))
    return 0 if any(times.values()) else 1


def run_echo(arguments) -> int:
    """Print the messages of a topic; return 1 when interrupted before the first one."""
    from swift_ros.messages.serialization import deserialize  # imports ROS

    printed = 0

    def show(data, info):
        nonlocal printed
        if not arguments.count or printed < arguments.count:
            print(as_text(deserialize(data, kind)) + "---", flush=True)
            printed += 1

    with open_listener(arguments.domain) as listener:
        name = full_name(arguments.topic)
        kind = _type_of(name, listener.published_topics())
        listener.subscribe(name, kind, show)
        with contextlib.suppress(KeyboardInterrupt):
            listener.spin(
                float("inf"),
                until=lambda: (arguments.count and printed >= arguments.count) or not output.is_read(),
            )
    return 0 if printed else 1


def run_latency(arguments) -> int:
    """Print the latency of each hop; return 1 when no message passed the whole chain."""
    with open_listener(arguments.domain) as listener:
        publications = collect_publications(listener)
        listener.spin(arguments.seconds)
    hops = publications.hops()
    print(latency.table(hops))
    if arguments.out:
        out = Path(arguments.out)
        out.mkdir(parents=True, exist_ok=True)
        (out / "result.json").write_text(json.dumps({"latency_ms": summary(hops)}, indent=1) + "\n")
    return 0 if any(len(values) for name, values in hops.items() if name.endswith(latency.FRAME)) else 1


def collect_publications(listener) -> latency.Publications:
    """Return the publication times of all messages of both chains, filled while the listener spins."""
    from swift_ros.messages.serialization import deserialize  # imports ROS
    from swift_ros.messages.stamps import from_time, header_stamp_ns  # imports ROS

    publications = latency.Publications()

    def subscribe(name, kind):
        def on_data(data, info):
            stamp_ns, published_ns = header_stamp_ns(data), info["source_timestamp"]
            if name == "betaflight/link":
                link = deserialize(data, kind)
                published_ns = latency.written_ns(stamp_ns, published_ns)
                stamp_ns = from_time(link.command_stamp)
            publications.record(name, stamp_ns, published_ns)

        listener.subscribe(full_name(name), kind, on_data)

    for name in latency.TOPICS:
        subscribe(name, TOPICS[name].type)
    return publications


def summary(hops: dict[str, np.ndarray]) -> dict:
    """Return count, p50, p99 and maximum (ms) of each hop that has values."""
    return {
        name: {
            "count": len(ms),
            "p50": float(np.percentile(ms, 50)),
            "p99": float(np.percentile(ms, 99)),
            "max": float(ms.max()),
        }
        for name, ms in hops.items()
        if len(ms)
    }


def _type_of(name: str, live: dict[str, str]) -> str:
    for topic in TOPICS.values():
        if full_name(topic.name) == name:
            return topic.type
    if name not in live:
        raise UsageError(f"{name} has no publisher; `swiftros topics list` prints all topics")
    return live[name]


def as_text(message, indent: str = "") -> str:
    """Return a message as indented lines; long arrays are truncated."""
    lines = []
    for field in message.get_fields_and_field_types():
        value = getattr(message, field)
        if hasattr(value, "get_fields_and_field_types"):
            lines.append(f"{indent}{field}:\n{as_text(value, indent + '  ')}")
        elif isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
            items = "".join(f"{indent}  -\n{as_text(item, indent + '    ')}" for item in value)
            lines.append(f"{indent}{field}:\n{items}")
        else:
            lines.append(f"{indent}{field}: {_scalar_text(value)}\n")
    return "".join(lines)


def _scalar_text(value) -> str:
    if isinstance(value, bytes):
        return str(value[0])
    if isinstance(value, str | bool | int | float):
        return str(value)
    items = list(value)
    text = ", ".join(str(item) for item in items[:MAX_SHOWN_VALUES])
    return f"[{text}, … {len(items)} values]" if len(items) > MAX_SHOWN_VALUES else f"[{text}]"
