"""Units as powers of basic ones: "N s^2/rad^2" is {N: 1, s: 2, rad: -2}. Pure."""

from collections import Counter


def powers(unit: str) -> Counter:
    """Return the powers of a unit as text: factors side by side, at most one stroke."""
    above, _, below = unit.partition("/")
    found = Counter()
    for text, sign in ((above, 1), (below, -1)):
        for factor in text.strip("() ").split():
            name, _, power = factor.partition("^")
            found[name] += sign * int(power or 1)
    return found


def text(unit: Counter) -> str:
    """Return the powers as text, the inverse of `powers`; empty for a plain number."""
    above, below = (
        [f"{name}^{abs(power)}" if abs(power) > 1 else name for name, power in unit.items() if power * sign > 0]
        for sign in (1, -1)
    )
    lower = f"({' '.join(below)})" if len(below) > 1 else "".join(below)
    return " ".join(above or ["1"] if below else above) + ("/" + lower if below else "")


def product(*units: str) -> str:
    """Return the unit of a product."""
    total = Counter()
    for unit in units:
        total.update(powers(unit))
    return text(total)


def ratio(unit: str, by: str) -> str:
    """Return the unit of a quotient."""
    found = powers(unit)
    found.subtract(powers(by))
    return text(found)
