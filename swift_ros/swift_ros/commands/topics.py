"""Look at the running graph: list its topics, measure their rates, show messages, measure latencies."""

import contextlib
import json
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.graph import latency
from swift_ros.graph.runner import chosen_domain
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.text import align


def command(subparsers) -> None:
    """Add the parser of `swiftros topics`."""
    parser = subparsers.add_parser("topics", help=__doc__, description=__doc__)
    actions = parser.add_subparsers(required=True, metavar="list|hz|echo|latency")
    for name, run, summary in (
        ("list", run_list, "every topic: type, rate it should have, who speaks and how many listen"),
        ("hz", run_hz, "rates as measured, beside those of the table"),
        ("echo", run_echo, "messages of one topic as text"),
        ("latency", run_latency, "hop by hop: image and odometry to the MSP frame that uses them"),
    ):
        action = actions.add_parser(name, help=summary, description=summary)
        action.add_argument("--domain", type=int, help="ROS domain (default: ROS_DOMAIN_ID, else a running race's)")
        action.set_defaults(run=run)
        if name == "echo":
            action.add_argument("topic", help="such as state/odometry or /clock")
            action.add_argument("--count", type=int, default=0, help="stop after so many (default: at Ctrl-C)")
        elif name == "hz":
            action.add_argument("topic", nargs="*", help="such as state/odometry (default: all)")
        if name in ("hz", "latency"):
            action.add_argument("--seconds", type=float, default=5.0, help="how long to listen (default %(default)s)")
        if name == "latency":
            action.add_argument("--out", metavar="DIR", help="write result.json there")


def listener(domain: int | None):
    """Return an `Ear`, not entered yet, in the chosen domain."""
    from swift_ros.nodes.ear import Ear

    return Ear(chosen_domain(domain))


def run_list(arguments) -> int:
    """Print the topics of the table and any others; 1 when nobody speaks at all."""
    with listener(arguments.domain) as ear:
        live = ear.live()
        known = {full_name(topic.name): topic for topic in TOPICS.values()}
        rows = [("topic", "type", "Hz", "speakers", "listeners")]
        for name in (*known, *sorted(set(live) - set(known) - {"/rosout", "/parameter_events"})):
            rate = known[name].rate_hz if name in known else None
            speakers = sorted({info.node_name for info in ear.node.get_publishers_info_by_topic(name)})
            kind = known[name].type if name in known else live[name]
            listeners = str(ear.node.count_subscribers(name))
            rows.append((name, kind, f"{rate:g}" if rate else "-", ", ".join(speakers) or "-", listeners))
    print(align(rows))
    return 0 if live else 1


def run_hz(arguments) -> int:
    """Print measured rates; 1 when nothing was heard."""
    with listener(arguments.domain) as ear:
        live = ear.live()
        wanted = [full_name(name) for name in arguments.topic] or sorted(set(live) - {"/rosout", "/parameter_events"})
        times = defaultdict(list)
        for name in wanted:
            ear.hear(name, _type_of(name, live), lambda data, info, name=name: times[name].append(time.monotonic()))
        ear.spin(arguments.seconds)
    known = {full_name(topic.name): topic.rate_hz for topic in TOPICS.values()}
    rows = [("topic", "Hz", "table", "longest gap ms")]
    for name in wanted:
        gaps = np.diff(times[name])
        rate, longest = (f"{1 / gaps.mean():.1f}", f"{1e3 * gaps.max():.1f}") if len(gaps) else ("-", "-")
        rows.append((name, rate, f"{known.get(name) or '-'}", longest))
    print(align(rows))
    return 0 if any(times.values()) else 1


def run_echo(arguments) -> int:
    """Print messages until there were enough; 1 when interrupted before the first."""
    from swift_ros import messages

    heard = 0

    def show(data, info):
        nonlocal heard
        if not arguments.count or heard < arguments.count:
            print(as_text(messages.deserialize(data, kind)) + "---", flush=True)
            heard += 1

    with listener(arguments.domain) as ear:
        name = full_name(arguments.topic)
        kind = _type_of(name, ear.live())
        ear.hear(name, kind, show)
        with contextlib.suppress(KeyboardInterrupt):
            ear.spin(float("inf"), until=lambda: arguments.count and heard >= arguments.count)
    return 0 if heard else 1


def run_latency(arguments) -> int:
    """Print latencies hop by hop; 1 when no way was whole."""
    with listener(arguments.domain) as ear:
        publications = listen(ear)
        ear.spin(arguments.seconds)
    hops = publications.hops()
    print(latency.table(hops))
    if arguments.out:
        out = Path(arguments.out)
        out.mkdir(parents=True, exist_ok=True)
        (out / "result.json").write_text(json.dumps({"latency_ms": summary(hops)}, indent=1) + "\n")
    return 0 if any(len(values) for name, values in hops.items() if name.endswith(latency.FRAME)) else 1


def listen(ear) -> latency.Publications:
    """Return what will hold, while `ear` spins, when each message of the flying chains was published."""
    from swift_ros import messages

    publications = latency.Publications()

    def hear(name, kind):
        def note(data, info):
            stamp_ns, published_ns = messages.header_stamp_ns(data), info["source_timestamp"]
            if name == "betaflight/link":
                link = messages.deserialize(data, kind)
                published_ns = latency.written_ns(stamp_ns, published_ns)
                stamp_ns = messages.stamp_ns(link.command_stamp)
            publications.note(name, stamp_ns, published_ns)

        ear.hear(full_name(name), kind, note)

    for name in latency.TOPICS:
        hear(name, TOPICS[name].type)
    return publications


def summary(hops: dict[str, np.ndarray]) -> dict:
    """Return count, p50, p99 and worst of each hop with values, ms."""
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
        raise UsageError(f"nobody speaks on {name}; `swiftros topics list` shows what there is")
    return live[name]


def as_text(message, indent: str = "") -> str:
    """Return a message as indented lines; long arrays are cut."""
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
    text = ", ".join(str(item) for item in items[:40])
    return f"[{text}, … {len(items)} in all]" if len(items) > 40 else f"[{text}]"
