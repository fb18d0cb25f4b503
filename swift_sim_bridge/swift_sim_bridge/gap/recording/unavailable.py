"""The reason why a recording lacks evidence that needs several channels together."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Unavailable:
    """Why the command link or the rate-loop log of a recording cannot be evaluated.

    Attributes:
        reason: a sentence part for a reader; empty where channels are missing.
        missing: names of the channels that the recording lacks.
    """

    reason: str = ""
    missing: tuple[str, ...] = ()
