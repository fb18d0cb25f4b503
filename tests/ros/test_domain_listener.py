"""A command that inspects the graph arrives a moment after the nodes: their topics are known, their names not yet."""

from types import SimpleNamespace

import rclpy
from std_msgs.msg import Empty

from swift_ros.nodes.domain_listener import UNNAMED, DomainListener


def test_topics_are_listed_when_the_names_of_their_nodes_have_arrived(domain, monkeypatch):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    publisher = rclpy.create_node("late", context=context)
    publisher.create_publisher(Empty, "/late/topic", 1)
    listener = DomainListener(domain)
    found, asked = listener.node.get_publishers_info_by_topic, 0

    def names_arrive_late(topic):
        nonlocal asked
        asked += 1
        return found(topic) if asked > 5 else [SimpleNamespace(node_name=UNNAMED)]

    monkeypatch.setattr(listener.node, "get_publishers_info_by_topic", names_arrive_late)
    with listener:
        assert [info.node_name for info in listener.node.get_publishers_info_by_topic("/late/topic")] == ["late"]
    publisher.destroy_node()
    context.shutdown()
