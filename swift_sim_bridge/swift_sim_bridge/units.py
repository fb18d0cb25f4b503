"""Products and quotients of units, as powers of basic units: "N s^2/rad^2" is {N: 1, s: 2, rad: -2}."""

from collections import Counter


def powers(unit: str) -> Counter:
    """Return the power of each basic unit; in the text, factors are separated by spaces, with at most one slash."""
    above, _, below = unit.partition("/")
    found = Counter()
    for factors, sign in ((above, 1), (below, -1)):
        for factor in factors.strip("() ").split():
            name, _, power = factor.partition("^")
            found[name] += sign * int(power or 1)
    return found


def text(unit: Counter) -> str:
    """Return the text of a unit, the inverse of `powers`; empty for a dimensionless one."""
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


def ratio(unit: str, divisor: str) -> str:
    """Return the unit of a quotient."""
    found = powers(unit)
    found.subtract(powers(divisor))
    return text(found)
