"""The choice of a few products for a left side, by what they remove of one half of the flight with the other's fit."""

import numpy as np

from swift_sim_bridge.gap.discovery.half_regression import HalfRegression
from swift_sim_bridge.physics.terms import quantities

MAX_SUMMANDS = 4  # of one left side; more remove little and are harder to read
# Speeds are measured so well that one more shows; powers of the current are so similar that two cancel each other.
MAX_SUMMANDS_OF = {"rotor_speed": 5, "voltage": 1}
MIN_REMOVED_SHARE = 0.02  # of the error of a left side beyond its noise, that a summand must remove
MIN_EXCESS_SHARE = 0.05  # of the squares of a left side's noise, which its error beyond the noise is taken to be
MIN_GAIN = 20.0  # squares of independent samples that a summand must remove; noise gives 10 to the best of 100
# Of what is left of that error: what coefficients of each rotor's own must remove, and a further summand of the motors,
# whose speeds are measured so well that 2 % of the squares, a seventh of the error, is much.
MIN_SHARE_OF_LEFT = 0.2
# A product is tied with the best one that removes this share of the error less: where the simplest of these removes too
# little, the best one is a chance resemblance. Of those within the noise, in independent squares, the simplest joins.
TIE_SHARE, TIE_GAIN = 0.02, 10.0
MAX_EXCHANGES = 12  # of chosen products for others, after each addition; each removes more
MAX_TRIED = 8  # products in the place of a chosen one: those of the largest gain over the whole flight


def chosen_products(problem: HalfRegression, known: list[int], offered: set[int]) -> dict[int, float]:
    """Return the products that join those that are known already, with what each removes beside those before it.

    After each addition, chosen products are exchanged for others that remove clearly more in their place (sequential
    replacement, Miller 2002): of similar products the best one alone need not be the best beside the next one.

    Args:
        problem: the regression of one left side.
        known: indices of products that are chosen already.
        offered: indices of the products that may join.
    """
    candidates = {j for j in offered if not _is_alone(problem.products[j])}
    excess = max(float(problem.squares.sum()) - problem.noise, MIN_EXCESS_SHARE * problem.noise)
    chosen: list[int] = []
    for _ in range(MAX_SUMMANDS_OF.get(problem.side, MAX_SUMMANDS) - len(known)):
        rows = [*known, *chosen]
        now = problem.lowered(rows)[0]
        scores = {j: problem.removed([*rows, j]) for j in problem.independent(rows) if j in candidates}
        least, tie = _least(problem, excess, now), TIE_SHARE * excess
        if problem.side == "rotor_speed":
            tie = min(tie, least)
        tied, best = (_simplest(problem, scores, within) for within in (tie, min(tie, TIE_GAIN)))
        if best is None or scores[tied] - now < least:
            break
        chosen = _with_each_rotor(problem, known, [*chosen, best], offered, excess)
        chosen = _exchanged(problem, known, chosen, offered, excess)
    return _shares(problem, known, chosen)


def _shares(problem: HalfRegression, before: list[int], chosen: list[int]) -> dict[int, float]:
    """Return what each chosen product removes beside those before it; of each rotor's own an equal part."""
    alone = [j for j in chosen if _is_alone(problem.products[j])]
    shares, known = {}, before
    for unit in [[j] for j in chosen if j not in alone] + ([alone] if alone else []):
        more = problem.lowered([*known, *unit])[0] - problem.lowered(known)[0]
        shares |= dict.fromkeys(unit, more / len(unit))
        known = [*known, *unit]
    return shares


def _least(problem: HalfRegression, excess: float, now: float) -> float:
    """Return what a further product must remove beside those that remove `now` of the excess."""
    least = MIN_REMOVED_SHARE * excess
    if problem.side == "rotor_speed":
        least = min(least, MIN_SHARE_OF_LEFT * (excess - now))
    return max(least, MIN_GAIN)


def _exchanged(
    problem: HalfRegression, before: list[int], chosen: list[int], offered: set[int], excess: float
) -> list[int]:
    """Return the chosen products, each in turn in exchange for one that removes as much more as a further one must.

    A product of one rotor alone is exchanged for another one of this rotor.
    """
    for _ in range(MAX_EXCHANGES):
        now, best = problem.lowered([*before, *chosen])[0], None
        needed = now + _least(problem, excess, now)
        for old in chosen:
            rows = [*before, *(j for j in chosen if j != old)]
            like = [j for j in offered.difference(rows) if _rotor(problem.products[j]) == _rotor(problem.products[old])]
            scores = {j: problem.removed([*rows, j]) for j in problem.strongest(rows, like, MAX_TRIED)}
            new = _simplest(problem, scores, TIE_GAIN)
            if new is not None and scores[new] > needed:
                needed, best = scores[new], [*(j for j in chosen if j != old), new]
        if best is None:
            break
        chosen = best
    return chosen


def _with_each_rotor(
    problem: HalfRegression, before: list[int], chosen: list[int], offered: set[int], excess: float
) -> list[int]:
    """Return the chosen products, with one for each rotor alone in place of the last if rotors differ clearly.

    They start from the last product and are exchanged: each rotor may have its peak at another speed. Rotors differ in
    one product at most: a second one would have as many numbers again.
    """
    *others, j = chosen
    alone = [i for i, name in enumerate(problem.products) if _is_alone(name, problem.products[j])]
    rows = [*before, *chosen]
    if not alone or not offered.issuperset(alone) or any(_is_alone(problem.products[i]) for i in rows):
        return chosen
    differing = _exchanged(problem, before, [*others, *alone], offered, excess)
    differing = sorted(differing, key=lambda i: _is_alone(problem.products[i]))
    now = problem.lowered(rows)[0]
    more = problem.removed([*before, *differing], len(alone)) - now
    left = float(problem.squares.sum()) - problem.noise - now
    return chosen if more < max(MIN_SHARE_OF_LEFT * left, MIN_GAIN * len(alone)) else differing


def _rotor(name: str) -> str:
    """Return the factor of a product that is 1 for one rotor alone; empty without one."""
    first = name.partition(" ")[0]
    return first if quantities.ROTOR_ALONE.fullmatch(first) else ""


def _is_alone(name: str, product: str = "") -> bool:
    """Return whether a name is that of a product, or of any, for one rotor alone."""
    return bool(_rotor(name)) and product in ("", name.partition(" ")[2])


def _simplest(problem: HalfRegression, scores: dict[int, float], tie: float) -> int | None:
    """Return the best product of the fewest factors among those whose score is the largest but for `tie`.

    A product that acts everywhere is simpler than one that acts from a bend on: the flight may hardly be below it.
    """
    largest = max(scores.values(), default=-np.inf)
    tied = [j for j, score in scores.items() if score > -np.inf and score >= largest - tie]
    return min(
        tied,
        key=lambda j: (
            sum(power for _, power in quantities.factors(problem.products[j])),
            "(" in problem.products[j],
            -scores[j],
        ),
        default=None,
    )
