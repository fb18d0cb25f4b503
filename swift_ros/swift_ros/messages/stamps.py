"""Stamps of messages as integer nanoseconds, and back."""

import struct

from builtin_interfaces.msg import Time

from swift_ros.messages.serialization import message_type

NANOSECONDS = 1_000_000_000  # in a second


def to_time(nanoseconds: int) -> Time:
    """Return the ROS time stamp of integer nanoseconds."""
    seconds, remainder = divmod(int(nanoseconds), NANOSECONDS)
    return Time(sec=seconds, nanosec=remainder)


def from_time(time: Time) -> int:
    """Return the integer nanoseconds of a ROS time stamp."""
    return time.sec * NANOSECONDS + time.nanosec


def message_stamp_ns(message) -> int:
    """Return the stamp (ns) of a message, or of its CDR bytes, that begins with a header or a time; 0 without one."""
    if isinstance(message, bytes):
        return header_stamp_ns(message)
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    return from_time(stamp) if stamp else 0


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp (ns) of a serialized message that `begins_with_stamp`, in CDR of either byte order."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return seconds * NANOSECONDS + nanoseconds


def set_header_stamp(data: bytearray, stamp_ns: int) -> None:
    """Set the stamp (ns) of a message serialized by this machine that `begins_with_stamp`."""
    struct.pack_into("=iI", data, 4, *divmod(int(stamp_ns), NANOSECONDS))


def begins_with_stamp(type_name: str) -> bool:
    """Return whether messages of a type begin with a header or a time, which `header_stamp_ns` can read."""
    first = next(iter(message_type(type_name).get_fields_and_field_types().values()), "")
    return first in ("std_msgs/Header", "builtin_interfaces/Time")
