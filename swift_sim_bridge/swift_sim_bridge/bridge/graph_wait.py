"""Waiting until the graph is complete: in lockstep the clock starts when everybody can hear and be heard."""

import time

from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES

CHECK_S = 0.1
HEARS_EVERYTHING = "recorder"


def await_graph(node, names, own_publishers, timeout_s: float) -> None:
    """Return when the nodes `names` of the table are in the graph with all that they speak and hear, and hear each of
    `own_publishers` (by topic). node: rclpy's, to look through.

    Raises UsageError that names who stays away, or who is not in the table.
    """
    unknown = [name for name in names if name not in NODES]
    if unknown:
        raise UsageError(f"parameter 'nodes' of the bridge names '{unknown[0]}', which the graph's table lacks")
    deadline_s = time.monotonic() + timeout_s
    while missing := _missing(node, names, own_publishers):
        if time.monotonic() > deadline_s:
            waited = f"after {timeout_s:.0f} s"
            raise UsageError(f"the graph is not complete {waited}, missing: {', '.join(missing)}; see their logs")
        time.sleep(CHECK_S)


def _missing(node, names, own_publishers) -> list[str]:
    present = set(node.get_node_names())
    missing = [name for name in names if name not in present]
    for name in set(names) - set(missing):
        row = NODES[name]
        mute = [topic for topic in row.publishes if not _is_at(name, node.get_publishers_info_by_topic(topic))]
        deaf = [topic for topic in row.subscribes if not _is_at(name, node.get_subscriptions_info_by_topic(topic))]
        missing += [f"{name} on {topic}" for topic in dict.fromkeys(mute + deaf)]
    for topic, publisher in own_publishers.items():
        hearers = [name for name in names if topic in NODES[name].subscribes or name == HEARS_EVERYTHING]
        if publisher.get_subscription_count() < len(hearers):
            missing.append(f"{' or '.join(hearers)} on {topic}")
    return sorted(missing)


def _is_at(name: str, ends) -> bool:
    return any(end.node_name == name for end in ends)
