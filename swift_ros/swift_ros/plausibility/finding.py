"""What a check of a file finds."""

from dataclasses import dataclass

IMPOSSIBLE, ODD = "impossible", "odd"  # a file with an impossible value is refused, one with an odd value is flown


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes:
        level: IMPOSSIBLE or ODD.
        sentence: what is wrong, where, and the cure.
    """

    level: str
    sentence: str
