"""Texts for the terminal: tables, and parts of a file in the sentence of an error."""

import difflib
import reprlib
from collections.abc import Iterable

MAX_EXCERPT = 80  # characters


class _Values(reprlib.Repr):
    """Shortened values in the words of YAML."""

    def repr_bool(self, value, level):
        return "true" if value else "false"

    def repr_NoneType(self, value, level):
        return "null"

    def repr_date(self, value, level):
        return value.isoformat()

    repr_datetime = repr_date


_short = _Values()
_short.maxstring = _short.maxlong = _short.maxother = MAX_EXCERPT


def excerpt(text: str) -> str:
    """Return a text of a file for the sentence of an error: one line, printable, at most MAX_EXCERPT characters."""
    line = "".join(letter if letter.isprintable() else "?" for letter in text[: MAX_EXCERPT + 1])
    return line if len(line) <= MAX_EXCERPT else line[: MAX_EXCERPT - 3] + "..."


def described(value) -> str:
    """Return a value of a file for the sentence of an error, in YAML's words and shortened."""
    try:
        return excerpt(_short.repr(value))
    except ValueError:  # Python limits the digits of a whole number that it prints
        return "a number of very many digits"


def nearest(name: str, missing: Iterable[str]) -> str | None:
    """Return the missing key or section that is spelt like an unknown one of a file; None without such a one."""
    return next(iter(difflib.get_close_matches(name, missing, n=1)), None)


def did_you_mean(meant: str | None, known: Iterable[str]) -> str:
    """Return the cure of an unknown name in a file: the one that was meant, else all that are known."""
    return f"did you mean '{meant}'?" if meant else f"known are {', '.join(known)}"


def align(rows) -> str:
    """Return rows of texts as left-aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    padded = ("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in padded)
