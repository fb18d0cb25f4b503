"""Messages of any type as CDR bytes, and back."""

import contextlib
import importlib
import re

from rclpy.serialization import deserialize_message, serialize_message

from swift_ros.text import excerpt

# Types that have one more sequence at their end since version 0.1.0; in older recordings it is empty.
EXTENDED = ("swift_msgs/msg/GateDetections", "swift_msgs/msg/GatePoses")
EMPTY_SEQUENCE = bytes(7)  # its length of zero in CDR: up to 3 bytes that align 4 bytes


def message_type(name: str):
    """Return the class of a type of messages or services, given as in `nav_msgs/msg/Odometry`.

    Raises LookupError when no installed package has it: the name may come from a file.
    """
    if found := re.fullmatch(r"([a-z]\w*)/(msg|srv)/([A-Z]\w*)", name, re.ASCII):
        package, kind, message = found.groups()
        with contextlib.suppress(ImportError, AttributeError):
            return getattr(importlib.import_module(f"{package}.{kind}"), message)
    raise LookupError(f"no installed package has the type {excerpt(name)}")


def deserialize(data: bytes, type_name: str):
    """Return the message in CDR bytes. Raises RuntimeError when they hold none, and LookupError like `message_type`."""
    kind = message_type(type_name)
    try:
        return deserialize_message(data, kind)
    except RuntimeError:
        if type_name not in EXTENDED:
            raise
        return deserialize_message(data + EMPTY_SEQUENCE, kind)


def serialize(message) -> bytes:
    """Return the CDR bytes of a message."""
    return serialize_message(message)
