"""Is a name worth more than an equation? What was taken in against what any few features would explain.

Neighbours of a cause that the catalogue lacks can absorb it, alone or several together. So each name is dropped for a
trial: where names and terms together then explain the flights better, it was no cause.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution import gauss_newton
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps

PER_NAME, PER_PARAMETER = 7.0, 8.0  # by which a name, one of some forty, must lower the squares, and what it changes
PER_TERM = 21.0  # and a term, one of some thousand features
CHANGED = 3.0  # standard errors
MARGIN, SHARE = 30.0, 0.004  # and how much better, of itself and of all that is explained, an account without a name is
RETIMED = 0.003  # share of what is left, by which a pose that was shifted between its samples may be rougher
NEARLY = 0.05  # of all that is explained, which names may explain beyond an equation no longer than what they need
MIN_UNCERTAIN_COUNT = 3  # names at once: several neighbours together may stand for one cause that has none
AT_BOUND = 0.01  # of a step, that is none
PLACED = ("local_draught", "payload")  # whose place must be known, not only bounded
APART, AS_WELL = 12.0, 6.0  # squares by which an equation is other than a name's, and by which it may explain less
BETTER = 14.0  # and more, beyond what the best of many features explains by chance in the place of a name that is true


@dataclass(frozen=True)
class Explanation:
    """Names with their values, and terms for what they leave; loss: squares left, and what both cost; cost: of it;
    numbers: how many both change; by_pipeline: squares that these names can explain because the pipeline makes
    something of the like by itself; rest (m, c): of each recording, what both leave, in standard deviations; doubtful:
    names without which the loss would be less, though not by enough to say so, or as whose equation another does."""

    keys: tuple[str, ...]
    values: dict
    terms: tuple[equation_search.EquationTerm, ...]
    loss: float
    cost: float
    numbers: int
    by_pipeline: float
    rest: list[np.ndarray]
    doubtful: frozenset[str] = frozenset()

    @property
    def left(self) -> float:
        """Squares left."""
        return self.loss - self.cost

    @property
    def in_truth(self) -> float:
        """Squares that both leave of the flights, whatever made them."""
        return sum(float(np.sum(one**2)) for one in self.rest)

    @property
    def least(self) -> float:
        """Squares left, where what the pipeline makes counts no more against terms than against names."""
        return self.left - sum(term.gain - term.lowers for term in self.terms)


def best_explanation(evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, tell) -> Explanation:
    """Return the names that are worth more than an equation, and the equation of what they leave.

    Names that need an equation beside them are a cocktail where one no longer explains nearly as much by itself.
    """
    nothing = squares(evidence, gauss_newton.residuals_at(evidence, vehicle))
    keys = [effect.key for effect in evidence.effects if effect.key in keys and possible(evidence, effect, values)]
    now, bare = explain(evidence, vehicle, keys, values, nothing), explain(evidence, vehicle, (), values, nothing)
    sure = [
        effect.key for effect in evidence.effects if effect.key in now.keys and possible(evidence, effect, now.values)
    ]
    if len(sure) < len(now.keys):  # what ran away when it was fitted beside the others
        now = explain(evidence, vehicle, sure, now.values, nothing)
    inexact = SHARE * (nothing - now.loss)
    if any(effect.retimes for effect in evidence.effects if effect.key in now.keys):
        inexact += RETIMED * now.left
    while now.keys:
        others = [
            explain(evidence, vehicle, [one for one in now.keys if one != key], now.values, nothing) for key in now.keys
        ]
        best = min(others, key=lambda one: one.loss)
        if not _clearly(best, now, inexact):
            if _cocktail(now, bare, inexact):
                tell(f"{', '.join(now.keys)}: an equation alone explains more")
                return bare
            if now.terms and len(bare.terms) <= len(now.terms) and bare.loss - now.loss < NEARLY * (nothing - now.loss):
                tell(f"{', '.join(now.keys)}: an equation alone explains nearly as much")
                return bare
            worse = zip(now.keys, others, strict=True)
            return replace(now, doubtful=frozenset(key for key, other in worse if _open(now, other, inexact)))
        tell(f"{', '.join(set(now.keys) - set(best.keys))}: an equation explains more")
        now = best
    return now


def _clearly(other: Explanation, now: Explanation, inexact: float) -> bool:
    """Return whether an account without a name is better beyond doubt: by what it costs, or as a shorter equation by
    what it explains."""
    if _leaves_more(other, now, inexact):
        return False
    shorter = other.numbers <= now.numbers and other.left + BETTER + inexact < now.left
    return shorter or other.loss + MARGIN + inexact < now.loss


def _leaves_more(other: Explanation, now: Explanation, inexact: float) -> bool:
    """Return whether an account without a name in truth leaves clearly more of the flights than with it: what the
    pipeline makes counts against a strong name more than against its own equation."""
    return other.in_truth > now.in_truth + now.by_pipeline + MARGIN + inexact


def _cocktail(now: Explanation, bare: Explanation, inexact: float) -> bool:
    """Return whether several names are neighbours of one cause that has none: each hides what the others get wrong, so
    that none of them can be missed, but an equation alone is clearly better, or shorter and worth more."""
    shorter = bare.numbers < now.numbers and bare.loss + MARGIN < now.loss
    return len(now.keys) > 1 and (shorter or _clearly(bare, now, inexact))


def _open(now: Explanation, other: Explanation, inexact: float) -> bool:
    """Return whether what an account without a name has in its place may as well be true: it costs less, or is an
    equation as short that explains as much and says something else, as a drag by another power of the speed: another
    thing than the name by more than a simulator may be off."""
    if other.loss < now.loss and not _leaves_more(other, now, inexact):
        return True
    as_much = other.least < now.least + AS_WELL + inexact and other.numbers <= now.numbers
    apart = sum(np.sum((one - two) ** 2) for one, two in zip(now.rest, other.rest, strict=True))
    return bool(as_much and apart > APART + inexact)


def possible(evidence: Evidence, effect: Effect, values: dict) -> bool:
    """Return whether an effect's values can be true: inside what is physical, a delay of a whole pass at least, and a
    draught of one place near which the flight came, not of the whole air.

    Of a vector some may stand at their bound, as a drag does on an axis that has none.
    """
    found = values[effect.key]
    inside = [
        p.low + AT_BOUND * p.step < value < p.high - AT_BOUND * p.step
        for p, value in zip(effect.parameters, found, strict=True)
    ]
    if effect.id == "command_latency":
        return bool(found[0] > 0.5 * evidence.residual_models[0].recording.command_link.passes.step_s)
    return all(inside) if effect.id in PLACED else any(inside)


def explain(evidence: Evidence, vehicle: Vehicle, keys, values: dict, nothing: float) -> Explanation:
    """Return what some names and the terms beside them are worth; nothing: the squares without any."""
    effects = [effect for effect in evidence.effects if effect.key in keys]
    values = {key: values[key] for key in keys}
    cost, made, by_pipeline, changed = 0.0, 0.0, 0.0, 0
    if effects:
        values, covariance = gauss_newton.gauss_newton_fit(evidence, vehicle, effects, values)
        changed = sum(_changed(effect, vehicle, values, covariance) for effect in effects)
        cost = PER_NAME * len(effects) + PER_PARAMETER * changed
        made, by_pipeline = _made(evidence, vehicle, effects, values)
    lines = gauss_newton.residuals_at(evidence, gauss_newton.with_effects(vehicle, effects, values))
    left = squares(evidence, lines)
    terms = equation_search.search(evidence.library, evidence.residual_models, lines, evidence.sigmas, nothing - left)
    own = [term for term in terms if not equation_search.is_mirrored(term, terms)]
    kinds = {
        (term.channel.layer, equation_search.axis_free_name(term)) for term in own
    }  # rotors are alike, and a drag's axes
    cost += PER_TERM * len(kinds) + PER_PARAMETER * (len(own) - len(kinds))
    loss = left + made - sum(term.lowers for term in terms) + cost
    rest = [
        equation_search.without(evidence.library, i, line, terms, evidence.residual_models[i].channels).residual / sigma
        for i, (line, sigma) in enumerate(zip(lines, evidence.sigmas, strict=True))
    ]
    return Explanation(tuple(keys), values, terms, loss, cost, changed + len(own), by_pipeline, rest)


def _changed(effect: Effect, vehicle: Vehicle, values: dict, covariance: dict) -> int:
    """Return how many of an effect's numbers it changes."""
    apart = np.abs(values[effect.key] - file_values(effect, vehicle))
    return int(np.count_nonzero(apart > CHANGED * np.sqrt(np.diag(covariance[effect.key]))))


def _made(evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict) -> tuple[float, float]:
    """Return by how much effects lower the squares because the pipeline makes something of the like by itself, which is
    no merit of theirs; less than nothing where they raise them for it, which is no fault; and by how much that alone
    can lower them."""
    sums = gauss_newton.normal_equations_at(
        evidence, gauss_newton.with_effects(vehicle, effects, values), tuple(effects)
    )
    rows = np.concatenate(
        [np.arange(own.start, own.stop) for own in (evidence.null_distribution.slices[e.key] for e in effects)]
    )
    artefact = evidence.null_distribution.bias_gradient[rows] * np.count_nonzero(sums.samples)
    moved = np.concatenate([values[effect.key] - file_values(effect, vehicle) for effect in effects]) / parameter_steps(
        tuple(effects)
    )
    alone = artefact @ solve(sums.matrix.sum(axis=0), artefact)
    return float(np.sign(-moved @ artefact) * max(abs(2.0 * moved @ artefact) - alone, 0.0)), float(alone)


def squares(evidence: Evidence, lines) -> float:
    """Return the sum of squares of residuals, in independent samples."""
    return float(sum(np.sum((line.residual / sigma) ** 2) for line, sigma in zip(lines, evidence.sigmas, strict=True)))
