"""Equations of the equation search as text, with their units."""

from swift_sim_bridge.gap.discovery.equation_search import EquationTerm


def equation(terms: tuple[EquationTerm, ...]) -> str:
    """Return the difference of measurement and simulation as a sum of terms, one equation for each channel."""
    lines = []
    for channel in dict.fromkeys(term.channel for term in terms):
        parts = [_term(term) for term in terms if term.channel == channel]
        lines.append(f"{channel.name}: measured - simulated = {' + '.join(parts)}")
    return "; ".join(lines)


def _term(term: EquationTerm) -> str:
    """Return a term as text, without a unit where it is a ratio, and without the factor 1."""
    value = f"({term.value:.3g} {term.unit})" if term.unit else f"{term.value:.3g}"
    return value if term.name == "1" else f"{value} {term.name}"


def domain(terms: tuple[EquationTerm, ...]) -> str:
    """Return the range of each feature in the recordings, in which the equation holds."""
    ranges = {
        term.name: f"{term.name} from {term.low:.3g} to {term.high:.3g} {term.feature_unit}".strip()
        for term in terms
        if term.name != "1"
    }
    return ", ".join(ranges.values())
