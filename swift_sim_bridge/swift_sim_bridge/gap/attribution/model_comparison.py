"""Comparison of the selected effects with equations in measured quantities.

A cause that the catalogue lacks can be absorbed by similar effects, one or several. Each selected effect is therefore
left out once and the rest is explained by an equation (see `discovery.equation_search`). If that explains the
recordings better, the effect is rejected.
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

# Penalties and thresholds are sums of squares in independent samples, twice a log-likelihood.
EFFECT_PENALTY = 7.0  # of an effect, as one of about forty of the catalogue: 2 log 40
PARAMETER_PENALTY = 8.0  # of a changed parameter or coefficient; the Schwarz criterion is log n, 8 for 3,000 samples
TERM_PENALTY = 21.0  # of an equation term, as one of about a thousand features (2 log 1000), and its coefficient
MIN_CHANGE_ERRORS = 3.0  # standard errors by which a parameter must change to count as changed
# By which an explanation without an effect must be better, penalties included. Larger keeps more effects that are only
# similar to the cause, smaller rejects more that are the cause.
MIN_IMPROVEMENT = 30.0
SIMULATOR_ERROR_SHARE = 0.004  # of all that is explained: error of the simulation, which no comparison can resolve
RETIMING_ERROR_SHARE = 0.003  # of what remains: error of interpolating a pose that is shifted in time
NEARLY_EQUAL_SHARE = 0.05  # of all that is explained; an equation that lacks less than this explains nearly as much
MIN_UNCERTAIN_COUNT = 3  # selected effects; from three on they may be neighbours of one unknown cause
BOUND_TOLERANCE = 0.01  # steps; a value closer to its bound counts as at the bound
LOCATED_EFFECTS = ("local_draught", "payload")  # effects all of whose parameters must lie inside their bounds
MIN_DIFFERENCE = 12.0  # by which the residuals of an equation and an effect must differ to be two explanations
MAX_DEFICIT = 6.0  # by which such an equation may explain less than the effect: a likelihood ratio of 20
MIN_EQUATION_LEAD = 14.0  # by which a shorter equation must explain more: the best of 1,000 by chance, 2 log 1000


@dataclass(frozen=True)
class Explanation:
    """Effects with their values, and equation terms for what they leave.

    Attributes:
        keys: the effects.
        values: their values, by key.
        terms: the equation terms.
        loss: remaining squares plus `penalty`, without the gain that is bias of the pipeline.
        penalty: penalty of the effects, their changed parameters and the terms.
        parameter_count: number of changed parameters and coefficients.
        bias_gain: largest gain of these effects that may be bias of the pipeline.
        residuals: of each recording, (m, c) normalised residuals that remain.
        uncertain: effects that an equation could replace, though the evidence does not suffice to reject them.
    """

    keys: tuple[str, ...]
    values: dict
    terms: tuple[equation_search.EquationTerm, ...]
    loss: float
    penalty: float
    parameter_count: int
    bias_gain: float
    residuals: list[np.ndarray]
    uncertain: frozenset[str] = frozenset()

    @property
    def remaining(self) -> float:
        """The remaining squares, without the gain that is bias of the pipeline."""
        return self.loss - self.penalty

    @property
    def raw_remaining(self) -> float:
        """The remaining squares of the recordings, bias included."""
        return sum(float(np.sum(residual**2)) for residual in self.residuals)

    @property
    def comparable_remaining(self) -> float:
        """The remaining squares, with the bias counted no more against terms than against effects."""
        return self.remaining - sum(term.gain - term.net_gain for term in self.terms)

    @property
    def comparable_loss(self) -> float:
        """The same with the penalty."""
        return self.comparable_remaining + self.penalty


def best_explanation(evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, progress) -> Explanation:
    """Return the selected effects that explain more than equations would, and the equation of what they leave.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        keys: the selected effects.
        values: their values, by key.
        progress: called with a line of text.
    """
    initial = normalised_squares(evidence, gauss_newton.residuals_at(evidence, vehicle))
    if not keys:  # beside effects, whose errors may be steady, a term must be stronger
        return explain(evidence, vehicle, (), values, initial, steady=True)
    keys = physical_keys(evidence, keys, values)
    current = explain(evidence, vehicle, keys, values, initial)
    equation = explain(evidence, vehicle, (), values, initial)
    physical = physical_keys(evidence, current.keys, current.values)
    if len(physical) < len(current.keys):  # the joint fit moved an effect out of its bounds
        current = explain(evidence, vehicle, physical, current.values, initial)
    simulator_error = SIMULATOR_ERROR_SHARE * (initial - current.loss)
    if any(effect.retimes for effect in evidence.effects if effect.key in current.keys):
        simulator_error += RETIMING_ERROR_SHARE * current.remaining
    while current.keys:
        others = [
            explain(evidence, vehicle, [other for other in current.keys if other != key], current.values, initial)
            for key in current.keys
        ]
        best = min(others, key=lambda one: one.loss)
        if not _clearly_better(best, current, simulator_error):
            if _absorbs_unknown_cause(current, equation, simulator_error):
                progress(f"{', '.join(current.keys)}: an equation alone explains more")
                return equation
            if _equation_nearly_equal(current, equation, initial):
                progress(f"{', '.join(current.keys)}: an equation alone explains nearly as much")
                return equation
            pairs = zip(current.keys, others, strict=True)
            uncertain = frozenset(key for key, other in pairs if _equally_plausible(current, other, simulator_error))
            return replace(current, uncertain=uncertain)
        progress(f"{', '.join(set(current.keys) - set(best.keys))}: an equation explains more")
        current = best
    return current


def physical_keys(evidence: Evidence, keys, values: dict) -> list[str]:
    """Return the effects whose values are physical, in the order of the catalogue."""
    return [effect.key for effect in evidence.effects if effect.key in keys and is_physical(evidence, effect, values)]


def _clearly_better(other: Explanation, current: Explanation, simulator_error: float) -> bool:
    """Return whether an explanation without an effect is clearly better, with penalties or as a shorter equation."""
    if _explains_less(other, current, simulator_error):
        return False
    shorter = other.parameter_count <= current.parameter_count
    shorter = shorter and other.remaining + MIN_EQUATION_LEAD + simulator_error < current.remaining
    return shorter or other.loss + MIN_IMPROVEMENT + simulator_error < current.loss


def _explains_less(other: Explanation, current: Explanation, simulator_error: float) -> bool:
    """Return whether an explanation without an effect leaves clearly more of the recordings, bias included.

    The bias of the pipeline counts more against a strong effect than against the equation that replaces it.
    """
    return other.raw_remaining > current.raw_remaining + current.bias_gain + MIN_IMPROVEMENT + simulator_error


def _absorbs_unknown_cause(current: Explanation, equation: Explanation, simulator_error: float) -> bool:
    """Return whether several effects together have absorbed a cause that the catalogue lacks.

    Each of them compensates the errors of the others, so that none can be left out. The equation alone is clearly
    better. One term in place of three effects or more need only be better, whatever the bias: independent causes do
    not act together as one quantity does on one channel.
    """
    if len(equation.terms) == 1 and len(current.keys) >= MIN_UNCERTAIN_COUNT:
        better = equation.comparable_loss < current.comparable_loss
    else:
        better = equation.loss + MIN_IMPROVEMENT < current.loss
    shorter = equation.parameter_count < current.parameter_count
    return len(current.keys) > 1 and ((shorter and better) or _clearly_better(equation, current, simulator_error))


def _equation_nearly_equal(current: Explanation, equation: Explanation, initial: float) -> bool:
    """Return whether effects need an equation beside them, and one no longer explains nearly as much without them."""
    if not current.terms or len(equation.terms) > len(current.terms):
        return False
    return equation.loss - current.loss < NEARLY_EQUAL_SHARE * (initial - current.loss)


def _equally_plausible(current: Explanation, other: Explanation, simulator_error: float) -> bool:
    """Return whether an explanation without an effect may as well be true.

    It has a lower loss, or it is no longer, explains as much, and differs from the effect by more than the error of the
    simulator: a drag with another power of the speed, for example.
    """
    if other.loss < current.loss and not _explains_less(other, current, simulator_error):
        return True
    as_much = other.comparable_remaining < current.comparable_remaining + MAX_DEFICIT + simulator_error
    as_much = as_much and other.parameter_count <= current.parameter_count
    difference = sum(np.sum((one - two) ** 2) for one, two in zip(current.residuals, other.residuals, strict=True))
    return bool(as_much and difference > MIN_DIFFERENCE + simulator_error)


def is_physical(evidence: Evidence, effect: Effect, values: dict) -> bool:
    """Return whether an effect's values, by key, are physical.

    A latency must be at least half a pass of the rate loop. All parameters of a located effect must lie inside their
    bounds: a local wind that covers the whole path is none. Of other effects one inside is enough, as a drag may be
    zero along one axis.
    """
    found = values[effect.key]
    inside = [
        p.low + BOUND_TOLERANCE * p.step < value < p.high - BOUND_TOLERANCE * p.step
        for p, value in zip(effect.parameters, found, strict=True)
    ]
    if effect.id == "command_latency":
        return bool(found[0] > 0.5 * evidence.residual_models[0].recording.command_link.passes.step_s)
    return all(inside) if effect.id in LOCATED_EFFECTS else any(inside)


def places(effect: Effect) -> np.ndarray:
    """Return which parameters (k,) of an effect say where it acts, in m: the file's values for them are no place."""
    located = effect.id in LOCATED_EFFECTS
    return np.array([located and parameter.unit == "m" for parameter in effect.parameters])


def explain(
    evidence: Evidence, vehicle: Vehicle, keys, values: dict, initial: float, steady: bool = False
) -> Explanation:
    """Return effects, fitted jointly, with the equation of what they leave.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        keys: the effects.
        values: initial values, by key.
        initial: squares without any effect.
        steady: search for weaker terms too, if every part of the flights shows them.
    """
    effects = [effect for effect in evidence.effects if effect.key in keys]
    values = {key: values[key] for key in keys}
    penalty, bias, bias_gain, changed = 0.0, 0.0, 0.0, 0
    if effects:
        values, covariance = gauss_newton.gauss_newton_fit(evidence, vehicle, effects, values)
        changed = sum(changed_count(effect, vehicle, values, covariance) for effect in effects)
        penalty = EFFECT_PENALTY * len(effects) + PARAMETER_PENALTY * changed
        bias, bias_gain = _bias_gains(evidence, vehicle, effects, values)
    lines = gauss_newton.residuals_at(evidence, gauss_newton.with_effects(vehicle, effects, values))
    remaining = normalised_squares(evidence, lines)
    given = evidence.library, evidence.residual_models, lines, evidence.sigmas, initial - remaining
    terms = equation_search.search_equations(*given)
    if steady and not terms:
        terms = equation_search.search_equations(*given, steady=True)
    own = [term for term in terms if not equation_search.is_mirrored(term, terms)]
    kinds = {(term.channel.layer, equation_search.axis_free_name(term)) for term in own}  # all rotors and axes are one
    penalty += TERM_PENALTY * len(kinds) + PARAMETER_PENALTY * (len(own) - len(kinds))
    loss = remaining + bias - sum(term.net_gain for term in terms) + penalty
    residuals = [
        equation_search.subtract_terms(evidence.library, i, line, terms, evidence.residual_models[i].channels).residual
        / sigma
        for i, (line, sigma) in enumerate(zip(lines, evidence.sigmas, strict=True))
    ]
    return Explanation(
        keys=tuple(keys),
        values=values,
        terms=terms,
        loss=loss,
        penalty=penalty,
        parameter_count=changed + len(own),
        bias_gain=bias_gain,
        residuals=residuals,
    )


def changed_count(effect: Effect, vehicle: Vehicle, values: dict, covariance: dict) -> int:
    """Return the number of an effect's parameters that change significantly."""
    change = np.abs(values[effect.key] - file_values(effect, vehicle))
    return int(np.count_nonzero(change > MIN_CHANGE_ERRORS * np.sqrt(np.diag(covariance[effect.key]))))


def _bias_gains(evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict) -> tuple[float, float]:
    """Return the part of the effects' gain that is bias of the pipeline, and the largest gain that it can have.

    The part is negative where effects raise the squares because of the bias. Neither counts for or against them.
    """
    repaired = gauss_newton.with_effects(vehicle, effects, values)
    equations = gauss_newton.normal_equations_at(evidence, repaired, tuple(effects))
    slices = [evidence.null_distribution.slices[effect.key] for effect in effects]
    rows = np.concatenate([np.arange(own.start, own.stop) for own in slices])
    bias = evidence.null_distribution.bias_gradient[rows] * np.count_nonzero(equations.samples)
    change = np.concatenate([values[effect.key] - file_values(effect, vehicle) for effect in effects])
    change = change / parameter_steps(tuple(effects))
    alone = bias @ solve(equations.information.sum(axis=0), bias)
    return float(np.sign(-change @ bias) * max(abs(2.0 * change @ bias) - alone, 0.0)), float(alone)


def channel_squares(evidence: Evidence, lines) -> np.ndarray:
    """Return the sum of squares (c,) of the residuals of each channel, in independent samples."""
    return sum(np.sum((line.residual / sigma) ** 2, axis=0) for line, sigma in zip(lines, evidence.sigmas, strict=True))


def normalised_squares(evidence: Evidence, lines) -> float:
    """Return the same of all channels."""
    return float(np.sum(channel_squares(evidence, lines)))


def penalised_squares(evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict) -> float:
    """Return the squares that effects leave, plus the penalties of the effects and all their parameters."""
    count = sum(len(effect.parameters) for effect in effects)
    lines = gauss_newton.residuals_at(evidence, gauss_newton.with_effects(vehicle, effects, values))
    return normalised_squares(evidence, lines) + EFFECT_PENALTY * len(effects) + PARAMETER_PENALTY * count
