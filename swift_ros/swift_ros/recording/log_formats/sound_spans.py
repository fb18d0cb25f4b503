"""Finds the sound parts of a log of framed messages, and names what lies between them.

Neither ULog nor DataFlash has checksums. A message is taken to be sound when its head is possible and another possible
message follows it. After damage, reading resumes where a chain of messages follows each other.
"""

import warnings
from collections.abc import Callable
from typing import NamedTuple

from swift_ros.errors import DamagedRecording

MAX_NAMED = 8  # damaged parts that are named one by one; the others are named together


class Framed(NamedTuple):
    """A message in a log: the position behind it, and its time in microseconds, None where it has none."""

    end: int
    time_us: int | None


class Damage(NamedTuple):
    """A part of a log that cannot be read, with the times before and after it in microseconds, None without one."""

    first_byte: int
    end_byte: int
    before_us: int | None
    after_us: int | None


def sound_spans(
    begin: int, end: int, message_at: Callable[[int], Framed | None], candidate: Callable[[int], int], chain: int
) -> tuple[list[tuple[int, int]], list[Damage]]:
    """Return the byte ranges of sound messages, and the damaged parts between them.

    Args:
        begin: position of the first message.
        end: position behind the last one.
        message_at: returns the message at a position, None where none can be.
        candidate: returns the first position, from one on, at which a message may begin; `end` without one.
        chain: number of messages that must follow each other for reading to resume.
    """
    spans, damage = [], []
    at = first = last = begin
    time_us = before_us = None  # of the last message, and of those before it
    while at < end:
        found = message_at(at)
        if found:
            last, at, before_us = at, found.end, time_us
            time_us = time_us if found.time_us is None else found.time_us
            continue
        # the length of the message before may be wrong, except where the file was cut
        resumed = _resumed(last + 1 if last > first else at + 1, end, message_at, candidate, chain)
        broken = at if resumed == end or last == first else last
        if broken > first:
            spans.append((first, broken))
        time_us = before_us if broken == last else time_us
        damage.append(Damage(broken, resumed, time_us, _next_time(resumed, message_at)))
        at = first = last = resumed
    if at > first:
        spans.append((first, at))
    return spans, damage


def warn(path, damage: list[Damage], begin_us: int) -> None:
    """Warn of the damaged parts of a log; times are named from `begin_us` on."""
    for part in damage[:MAX_NAMED]:
        before, after = (None if t is None else (t - begin_us) * 1e-6 for t in (part.before_us, part.after_us))
        where = f"bytes {part.first_byte} to {part.end_byte}"
        _warn(f"{path}: {where} cannot be read: {_missing(before, after)}")
    if len(damage) > MAX_NAMED:
        size = sum(part.end_byte - part.first_byte for part in damage[MAX_NAMED:])
        _warn(f"{path}: {len(damage) - MAX_NAMED} further parts, {size} bytes in all, cannot be read")


def _warn(text: str) -> None:
    warnings.warn(text, DamagedRecording, stacklevel=4)


def _missing(before_s: float | None, after_s: float | None) -> str:
    if before_s is None:
        return "what was logged there is missing"
    if after_s is None:
        return f"the log ends there, {before_s:.3f} s after its first message"
    return f"messages between {before_s:.3f} s and {after_s:.3f} s may be missing"


def _resumed(at: int, end: int, message_at, candidate, chain: int) -> int:
    """Return the first position from `at` on at which a chain of messages begins; `end` without one."""
    at = candidate(at)
    while at < end:
        position, count = at, 0
        while count < chain and position < end and (found := message_at(position)):
            position, count = found.end, count + 1
        if count == chain or (count and position == end):
            return at
        at = candidate(at + 1)
    return end


def _next_time(at: int, message_at) -> int | None:
    """Return the time of the first message with one, from a position on; None without one."""
    while found := message_at(at):
        if found.time_us is not None:
            return found.time_us
        at = found.end
    return None
