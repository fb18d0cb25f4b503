"""Subscriptions that nobody wakes for: a node that is in no hurry takes what has come when it suits it."""

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import SingleThreadedExecutor


class ByHand(CallbackGroup):
    """The group of such subscriptions: no executor takes their messages.

    The node's executor must be `EXECUTOR`: the EventsExecutor knows no groups and would take every message itself.
    """

    EXECUTOR = SingleThreadedExecutor

    def can_execute(self, entity) -> bool:
        return False

    def beginning_execution(self, entity) -> bool:
        return False

    def ending_execution(self, entity) -> None:
        pass


def take(subscription, raw: bool = False) -> list:
    """Return (message, info) of all that has come since the last time, oldest first; raw: bytes instead of messages."""
    taken = []
    with subscription.handle:
        while (message := subscription.handle.take_message(subscription.msg_type, raw)) is not None:
            taken.append(message)
    return taken


def never(message) -> None:
    """The callback of a subscription whose messages are taken by hand."""


def without_clock(node) -> None:
    """Stop hearing /clock, which would wake the node at every tick; its own clock stands still from then on."""
    node._time_source.detach_node()
