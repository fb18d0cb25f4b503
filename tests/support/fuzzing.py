"""Inputs of the fuzz tests: valid content that is damaged in drawn ways, the budget, and the check of a refusal."""

import os
import struct
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from hypothesis import settings
from hypothesis import strategies as st

from swift_ros.errors import UsageError

LARGEST_ERROR = 2000  # characters of an error's sentence; a longer one repeats the input
FRAMES_PER_INPUT = 100  # MSP frames for one input of another format: frames are short
# Numbers that lengths, counts and values should never have, as bytes.
ABSURD = (
    *(struct.pack("<q", value) for value in (-1, 1 << 60, 1 << 32, -(1 << 63), (1 << 63) - 1)),
    *(struct.pack("<i", value) for value in (-1, 1 << 30, -(1 << 31), (1 << 31) - 1)),
    *(struct.pack("<d", value) for value in (float("nan"), float("inf"), 1e308, -1e308)),
    b"\xff\xff",
    b"\xff" * 9 + b"\x7f",  # the longest number in groups of seven bits
)
KINDS = ("flip", "zero", "overwrite", "insert", "delete", "duplicate", "swap", "cut")


class Edit(NamedTuple):
    """One change of a content: its kind, its place (taken modulo the length), how many bytes, and new bytes."""

    kind: str
    place: int
    size: int
    data: bytes


class Tally(NamedTuple):
    """Number of inputs of each format since the start, and how many of them were valid."""

    inputs: Counter
    valid: Counter


TALLY = Tally(Counter(), Counter())


def budget(share: float, inputs_per_example: float = 1.0) -> settings:
    """Return the settings of a test that takes a share of the inputs of its format.

    Args:
        share: share of the format's inputs.
        inputs_per_example: inputs in one example.
    """
    return settings(max_examples=max(1, round(share * settings.default.max_examples / inputs_per_example)))


def count(name: str, inputs: int = 1, valid: int = 0) -> None:
    """Count inputs of a format, and how many of them were valid."""
    TALLY.inputs[name] += inputs
    TALLY.valid[name] += valid


def edits(most: int = 5) -> st.SearchStrategy[list[Edit]]:
    """Return a strategy for one to `most` edits."""
    size = st.one_of(st.integers(1, 16), st.integers(1, 4000))
    data = st.one_of(st.sampled_from(ABSURD), st.binary(min_size=1, max_size=12))
    return st.lists(
        st.builds(Edit, st.sampled_from(KINDS), st.integers(0, (1 << 20) - 1), size, data), min_size=1, max_size=most
    )


def edited(content: bytes, changes: list[Edit]) -> bytes:
    """Return a content with edits made one after another."""
    found = bytearray(content)
    for kind, place, size, data in changes:
        at = place % (len(found) + 1)
        end = min(at + size, len(found))
        if kind == "flip" and at < len(found):
            found[at] ^= 1 << size % 8
        elif kind == "zero":
            found[at:end] = bytes(end - at)
        elif kind == "overwrite":
            found[at : at + len(data)] = data
        elif kind == "insert":
            found[at:at] = data
        elif kind == "delete":
            del found[at:end]
        elif kind == "duplicate":
            found[end:end] = found[at:end]
        elif kind == "swap":
            found[at:end] = found[at:end][len(data) :] + found[at:end][: len(data)]
        elif kind == "cut":
            del found[at:]
    return bytes(found)


def result_or_refusal(function: Callable[[], Any]):
    """Return the result of a function, or the UsageError that it raised, whose text must be one short sentence."""
    try:
        return function()
    except UsageError as error:
        text = str(error)
        assert text and text.isprintable() and len(text) < LARGEST_ERROR, repr(text[:LARGEST_ERROR])
        return error


def large_inputs() -> int | None:
    """Return how many inputs of a format `make fuzz` wants, None for the small budget of `make test`."""
    text = os.environ.get("SWIFT_FUZZ_INPUTS")
    return int(text) if text else None
