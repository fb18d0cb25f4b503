"""Errors in ROS messages of any type: wrong numbers, wrong stamps, and messages made up of nothing."""

import array
import math

import numpy as np

from swift_ros.messages.stamps import to_time
from swift_ros.race.judge import ARMED, CRASHED, FINISHED, IDLE, LOST, RACING, STOPPED

STATES = (IDLE, ARMED, RACING, FINISHED, CRASHED, STOPPED, LOST)
NOT_NUMBERS = (math.nan, math.inf, -math.inf)
MAX_FLOAT32 = 3e38  # larger numbers do not fit a field of 32 bits


def spoil(message, rng, size: float | None) -> None:
    """Replace one number of a message, chosen at random.

    Args:
        message: changed in place.
        rng: numpy generator.
        size: the number is multiplied by it, or replaced where it is zero; None: it becomes NaN or infinite.
    """
    places = _numbers(message)
    if not places:
        return
    owner, key, largest = places[rng.integers(len(places))]
    value = owner[key] if isinstance(key, int) else getattr(owner, key)
    wrong = float(rng.choice(NOT_NUMBERS)) if size is None else float(np.clip((value or 1.0) * size, -largest, largest))
    _set(owner, key, wrong)


def make_up(message, rng, now_ns: int) -> None:
    """Fill a new message with random values and, in every second one, a valid stamp.

    Args:
        message: changed in place.
        rng: numpy generator.
        now_ns: the stamp.
    """
    for owner, key, _ in _numbers(message):
        _set(owner, key, float(rng.normal(scale=10.0)))
    if hasattr(message, "state"):
        message.state = str(rng.choice(STATES))
    if rng.random() < 0.5:
        set_stamp(message, now_ns)


def set_stamp(message, stamp_ns: int) -> None:
    """Set the stamp of a message that has one."""
    owner = getattr(message, "header", message)
    if hasattr(owner, "stamp"):
        owner.stamp = to_time(max(stamp_ns, 0))


def _numbers(message) -> list[tuple]:
    """Return (owner, attribute or index, largest value) of every floating-point number of a message."""
    found = []
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        base = kind.removeprefix("sequence<").split("[")[0].split(",")[0].rstrip(">")
        largest = {"float": MAX_FLOAT32, "double": math.inf}.get(base)
        if largest is not None:
            numbers = isinstance(value, (array.array, np.ndarray, list))
            found += [(value, index, largest) for index in range(len(value))] if numbers else [(message, name, largest)]
        elif isinstance(value, list):
            found += [place for one in value if hasattr(one, "get_fields_and_field_types") for place in _numbers(one)]
        elif hasattr(value, "get_fields_and_field_types"):
            found += _numbers(value)
    return found


def _set(owner, key, value: float) -> None:
    if isinstance(key, int):
        owner[key] = value
    else:
        setattr(owner, key, value)
