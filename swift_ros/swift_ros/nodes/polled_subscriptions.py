"""Polled subscriptions: a node takes their messages at its own rate, instead of one callback for each message."""

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import SingleThreadedExecutor


class PolledGroup(CallbackGroup):
    """Callback group of polled subscriptions: no executor takes their messages.

    The node's executor must be of class `EXECUTOR`: the EventsExecutor ignores callback groups and would take every
    message.
    """

    EXECUTOR = SingleThreadedExecutor

    def can_execute(self, entity) -> bool:
        return False

    def beginning_execution(self, entity) -> bool:
        return False

    def ending_execution(self, entity) -> None:
        pass


def take_all(subscription, raw: bool = False) -> list:
    """Return (message, info) of all messages received since the last call, oldest first.

    Args:
        subscription: of a PolledGroup.
        raw: return CDR bytes instead of messages.
    """
    taken = []
    with subscription.handle:
        while (message := subscription.handle.take_message(subscription.msg_type, raw)) is not None:
            taken.append(message)
    return taken


def unused_callback(message) -> None:
    """Callback of a polled subscription; never called."""


def detach_clock(node) -> None:
    """Remove a node's subscription to /clock, which would wake it at every tick. Its ROS clock then no longer moves."""
    node._time_source.detach_node()
