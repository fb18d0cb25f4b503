"""What a check of a file finds."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

TOO_LARGE = "its numbers are too large or too small to compute with; check their units"
IMPOSSIBLE, ODD = "impossible", "odd"  # a file with an impossible value is refused, one with an odd value is flown

Check = Callable[..., Iterator[str]]  # of a record: a sentence for each thing that is wrong


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes:
        level: IMPOSSIBLE or ODD.
        sentence: what is wrong, where, and the cure.
    """

    level: str
    sentence: str


def unless(check: Check, *causes: Check) -> Check:
    """Return a check that finds nothing where one of `causes` finds something, from which its own finding follows."""

    def checked(record) -> Iterator[str]:
        if not any(sentence for cause in causes for sentence in cause(record)):
            yield from check(record)

    return checked


def first_findings(record, stages: tuple[tuple[Check, ...], ...], odd: tuple[Check, ...]) -> list[Finding]:
    """Return what is impossible about a record, or else what is odd.

    A wrong unit contradicts many other values. Therefore the checks have stages: only the findings of the first stage
    that has some are returned, so that one cause gives one sentence.
    """
    try:
        with np.errstate(all="ignore"):
            for checks in stages:
                if found := [Finding(IMPOSSIBLE, sentence) for check in checks for sentence in check(record)]:
                    return found
            return [Finding(ODD, sentence) for check in odd for sentence in check(record)]
    except (ArithmeticError, ValueError):  # such as a power beyond the range of numbers, or an infinite matrix
        return [Finding(IMPOSSIBLE, TOO_LARGE)]
