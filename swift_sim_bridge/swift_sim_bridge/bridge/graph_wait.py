"""Wait until the graph is complete: in lockstep the clock starts when every node has its publishers and subscribers."""

import time

from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES
from swift_ros.working_time import WorkingTime

CHECK_S = 0.1  # between two looks at the graph
SUBSCRIBES_TO_EVERYTHING = "recorder"  # its subscriptions are not listed in the table


def await_graph(node, names, own_publishers, timeout_s: float) -> None:
    """Return when the named nodes are in the graph with all their publishers and subscriptions.

    Args:
        node: rclpy node that looks at the graph.
        names: nodes of the graph's table to wait for.
        own_publishers: publishers of the caller by topic; each needs the subscriptions that the table lists.
        timeout_s: s of working time to wait at most.

    Raises:
        UsageError: a node or topic is still missing after the timeout.
    """
    clock = WorkingTime()
    while missing := _missing(node, names, own_publishers):
        if clock.now_s() > timeout_s:
            waited = f"after {timeout_s:.0f} s"
            raise UsageError(f"the graph is not complete {waited}, missing: {', '.join(missing)}; see their logs")
        time.sleep(CHECK_S)


def _missing(node, names, own_publishers) -> list[str]:
    """Return the missing nodes by name and the missing publishers and subscriptions as 'node on topic'."""
    present = set(node.get_node_names())
    missing = [name for name in names if name not in present]
    for name in set(names) - set(missing):
        row = NODES[name]
        unpublished = [t for t in row.publishes if not _is_among(name, node.get_publishers_info_by_topic(t))]
        unsubscribed = [t for t in row.subscribes if not _is_among(name, node.get_subscriptions_info_by_topic(t))]
        missing += [f"{name} on {topic}" for topic in dict.fromkeys(unpublished + unsubscribed)]
    for topic, publisher in own_publishers.items():
        subscribers = [n for n in names if topic in NODES[n].subscribes or n == SUBSCRIBES_TO_EVERYTHING]
        if publisher.get_subscription_count() < len(subscribers):
            missing.append(f"{' or '.join(subscribers)} on {topic}")
    return sorted(missing)


def _is_among(name: str, endpoints) -> bool:
    return any(endpoint.node_name == name for endpoint in endpoints)
