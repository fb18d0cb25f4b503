"""Numbers, units and symbols for a reader: digits that the interval supports, prefixes, and equations in HTML."""

import re
from collections.abc import Sequence
from html import escape

import numpy as np

PREFIXED = {"s": ("ms", 1e3), "m": ("mm", 1e3), "kg": ("g", 1e3), "ohm": ("mohm", 1e3)}  # small values are given in
MAX_PREFIXED = 0.1  # largest absolute value that gets a prefix
MAX_DIGITS = 6  # after the decimal point
PLAIN_RANGE = 1e-3, 1e6  # of the largest value that is written without a power of ten
SYMBOLS = {
    "alpha": "α",
    "domega": "dω",
    "dOmega": "dΩ",
    "omega": "ω",
    "Omega": "Ω",
    "psi": "ψ",
    "tau": "τ",
    "sqrt": "√",
    "ohm": "Ω",
    "mohm": "mΩ",
    "sum": "Σ",
    "integral": "∫",
}
WORDS = re.compile(rf"(?<![A-Za-z])({'|'.join(sorted(SYMBOLS, key=len, reverse=True))})(?![a-z])")
INDEX = re.compile(r"(?<=[A-Za-zα-ωΑ-Ω])_([A-Za-z0-9]+(?:,[a-z]{1,2}(?![a-z]))?)")
POWER = re.compile(r"\^(-?\d+)")


def scaled(values: Sequence[float | None], unit: str) -> tuple[list[float | None], str]:
    """Return values of one unit, all with the prefix that suits the largest of them, and the unit."""
    largest = max((abs(one) for one in values if one is not None), default=0.0)
    if unit not in PREFIXED or not 0.0 < largest < MAX_PREFIXED:
        return list(values), unit
    name, factor = PREFIXED[unit]
    return [None if one is None else one * factor for one in values], name


def rounded(values: Sequence[float | None], precision: float) -> list[str]:
    """Return values as texts with the digits that are needed to see a difference of `precision`; "" for None."""
    known = [abs(one) for one in values if one is not None and np.isfinite(one)]
    largest, smallest = max(known, default=0.0), abs(precision)
    power = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    if PLAIN_RANGE[0] <= largest < PLAIN_RANGE[1] or largest == 0.0:
        power = 0
    digits = 1 - int(np.floor(np.log10(smallest))) + power if smallest > 0.0 else 2
    digits = min(max(digits, 0), MAX_DIGITS)
    return ["" if one is None else _text(one * 10.0**-power, digits, power) for one in values]


def _text(value: float, digits: int, power: int) -> str:
    """Return a number with digits after the decimal point, times a power of ten; zero has no sign."""
    if value == 0.0:
        return "0"
    text = f"{value:.{digits}f}"
    if not text.strip("-0."):
        text = text.lstrip("-")
    return (text + (f"e{power}" if power else "")).replace("-", "\N{MINUS SIGN}")


def of_interval(was: float | None, value: float, interval, unit: str) -> tuple[str, str, str, str]:
    """Return as texts: the value before, the value, its interval, and their unit.

    Args:
        was: value before; None where there was none.
        value: the estimate.
        interval: its bounds (2,).
        unit: of all of these.
    """
    numbers, unit = scaled([was, value, *interval], unit)
    before, now, low, high = rounded(numbers, 0.5 * abs(numbers[3] - numbers[2]))
    return before, now, f"{low} … {high}" if low != high else "", unit


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits, without a power of ten where it is of ordinary size."""
    if not np.isfinite(value) or value == 0.0:
        return f"{value:g}"
    value = float(f"{value:.{digits - 1}e}")
    power = int(np.floor(np.log10(abs(value))))
    if not -4 <= power < 5:
        return f"{value:.{digits - 1}e}".replace("e-0", "e-").replace("e+0", "e")
    return f"{value:.{max(digits - 1 - power, 0)}f}"


def share(value: float) -> str:
    """Return a share, 0 to 1, as percent for a reader."""
    if value < 0.001:
        return "under 0.1 %"
    return f"{100.0 * value:.1f} %" if value < 0.0995 else f"{100.0 * value:.0f} %"


def html(text: str) -> str:
    """Return a text with units or an equation as HTML: Greek letters, indices, powers, dots between factors."""
    found = WORDS.sub(lambda match: SYMBOLS[match[1]], escape(text, quote=False))
    found = INDEX.sub(r"<sub>\1</sub>", found)
    found = POWER.sub(lambda match: f"<sup>{match[1].replace('-', chr(0x2212))}</sup>", found)
    found = re.sub(r"(\d(?:\.\d+)?)e(−?\d+)", r"\1 · 10<sup>\2</sup>", found)
    found = re.sub(r"(?<=[ωΩ])'", "′", found)
    return found.replace("&lt;=", "≤").replace(" - ", " − ").replace("= -", "= −")


def equation(text: str) -> str:
    """Return an equation as HTML, with a cross between the factors of a vector product."""
    return html(text).replace(" x ", " × ")


def plain(text: str) -> str:
    """Return a text for a terminal: a minus sign and dots that every terminal shows."""
    return text.replace("\N{MINUS SIGN}", "-").replace("…", "..")
