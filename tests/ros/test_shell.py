"""What all nodes share: a loop that ends at a signal also under load, and subscriptions that a node polls."""

import threading
import time

import pytest
import rclpy
from patience import PATIENCE_S, wait_for
from std_msgs.msg import Header

from swift_ros.messages.stamps import from_time, to_time
from swift_ros.nodes.polled_subscriptions import PolledSubscriptions, PollingNode
from swift_ros.nodes.shell import spin


@pytest.fixture
def node():
    """Yield a node that can poll, in a ROS of its own."""
    rclpy.init()
    node = PollingNode("node")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_node_that_cannot_keep_up_with_its_messages_still_ends_at_a_signal(node):
    requests, ended, received = [], threading.Event(), []

    def slow(message):
        received.append(message)
        time.sleep(0.006)

    node.create_subscription(Header, "flood", slow, 10)
    publisher = node.create_publisher(Header, "flood", 10)

    def flood():
        end = time.monotonic() + PATIENCE_S
        while not ended.wait(0.002) and time.monotonic() < end:
            publisher.publish(Header())
            if len(received) > 50:
                requests.append("signal")

    thread = threading.Thread(target=flood)
    thread.start()
    spin(node, requests)
    floods_on = thread.is_alive()
    ended.set()
    thread.join()
    assert floods_on, "the loop ended with the messages, not with the signal"


def test_polled_messages_of_two_topics_come_in_the_order_of_reception_and_end_with_the_node(node):
    polled = PolledSubscriptions()
    for name in ("b", "a"):
        polled.add(name, node.create_polled_subscription(Header, name, 10))
    publishers = {name: node.create_publisher(Header, name, 10) for name in ("a", "b")}
    wait_for(lambda: all(publisher.get_subscription_count() for publisher in publishers.values()))
    assert node.count_subscribers("a") == 1 and not list(node.subscriptions)  # no executor takes its messages

    sent, taken = [("a", 1), ("b", 2), ("a", 3), ("a", 4), ("b", 5)], []
    for name, number in sent[:3]:
        publishers[name].publish(Header(stamp=to_time(number)))
        time.sleep(0.01)
    between_ns = time.time_ns()
    for name, number in sent[3:]:
        publishers[name].publish(Header(stamp=to_time(number)))
        time.sleep(0.01)
    wait_for(lambda: taken.extend(polled.take(until_ns=between_ns)) or len(taken) == 3)
    assert [(each.key, from_time(each.message.stamp)) for each in taken] == sent[:3]
    wait_for(lambda: taken.extend(polled.take()) or len(taken) == 5)
    assert [(each.key, from_time(each.message.stamp)) for each in taken] == sent

    other = rclpy.create_node("other")
    node.destroy_node()
    wait_for(lambda: other.count_subscribers("a") == 0)
    other.destroy_node()
