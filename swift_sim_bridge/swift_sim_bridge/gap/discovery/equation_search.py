"""Equation search: sparse regression of what effects leave on quantities of physical dimension.

For each channel the few features are found on which its residual depends. An effect must explain more than such an
equation: it may be similar to a cause that the catalogue lacks and explain half of it, where three features explain it
in full.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from swift_sim_bridge import units
from swift_sim_bridge.gap.discovery.feature_library import FeatureLibrary
from swift_sim_bridge.gap.discovery.features import Features
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, accumulate, concatenate, fit_gain, solve
from swift_sim_bridge.gap.inference.null_distribution import subtract_bias
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.channels import ACCELEROMETER, ELECTRICAL_POWER, SPECIFIC_FORCE, Channel
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

# Gains are sums of squares in independent samples.
MAX_TERMS = 3  # of one channel; more terms would explain more and be harder to interpret
MIN_REPEATED_GAIN = 20.0  # gain of a feature that describes another axis of the layer: one of a few, not of thousands
MAX_CHANCE = 1e-6  # that scatter over the seconds makes a steady term: 1 in 1,000 for the best of a thousand features
MIN_EXPLAINED_SHARE = 0.002  # of what the effects explain; a smaller gain may be the error of strong effects
TIE_SHARE = 0.004  # of the largest gain; features that gain as much but for this are tied, and the first one is taken
TIE_GAIN = 9.0  # difference of two gains that arises by chance, three standard deviations; the same use
MIN_INDEPENDENT_SHARE = 1e-3  # of a feature's square that the chosen features do not contain
UNSEARCHED_LAYER = "camera"  # errors of a detector depend on the view, and so on any quantity of a single flight
DRIFTING_LAYER = "vio"  # the drift of odometry is random and may be correlated with any quantity of a single flight
MIN_DRIFT_SHARE = 0.1  # of that layer's squares, which a term must explain; smaller takes random drift for a cause
MIN_CAUSE_SHARE = 0.02  # of the gain of all terms that the layer of the cause has; less is leakage from other layers
ECHO_RATIO = 2.0  # ratio of force to accelerometer coefficients from which on the force is the cause
EQUALITY_ERRORS = 3.0  # standard errors by which two coefficients of one quantity may differ
SCALES_OF_RATES = {  # power and axis of terms that make a commanded rate larger or smaller, by channel and name
    (f"rate_command_{channel}", f"rate sent {letter}{suffix}"): (power, axis)
    for axis, (channel, letter) in enumerate((("roll", "x"), ("pitch", "y"), ("yaw", "z")))
    for power, suffix in ((1, ""), (3, "^3"))
}
LAYER_ORDER = ("command", "motor", "imu", "vio", "camera", "force", "moment")  # an error does not affect earlier layers


@dataclass(frozen=True)
class EquationTerm:
    """One term of an equation: a coefficient times a feature, as a part of one channel's residual.

    Attributes:
        channel: the channel.
        name: name of the feature.
        feature_unit: unit of the feature.
        value: coefficient.
        error: standard error of the coefficient.
        unit: unit of the coefficient.
        low: 2 % quantile of the feature in the recordings.
        high: 98 % quantile.
        gain: gain beside the terms before it, with the bias of the pipeline subtracted.
        net_gain: the smaller one of `gain` and the gain with the bias: bias may lower the gain of a term, not raise it.
    """

    channel: Channel
    name: str
    feature_unit: str
    value: float
    error: float
    unit: str
    low: float
    high: float
    gain: float
    net_gain: float


@dataclass(frozen=True)
class _ChannelProblem:
    """The regression of one channel on q features.

    Attributes:
        equations: normal equations, with the bias gradient subtracted.
        uncorrected: the same without this subtraction.
        variance_inflation: (q,) see `FeatureLibrary`.
        threshold: (q,) gain that each feature must have, in independent samples.
        local: features that act at one place and need not pass cross-validation: the place may be passed once alone.
        preferred: features that are chosen first among tied ones.
        steady: whether every part of the flight must show a term.
    """

    equations: NormalEquations
    uncorrected: NormalEquations
    variance_inflation: np.ndarray
    threshold: np.ndarray
    local: frozenset[int]
    preferred: frozenset[int]
    steady: bool


def search_equations(
    library: FeatureLibrary,
    residual_models: tuple[ResidualModel, ...],
    lines: list[Linearisation],
    sigmas,
    explained: float = 0.0,
    steady: bool = False,
) -> tuple[EquationTerm, ...]:
    """Return the terms that the residuals call for, in the order of the channels.

    Channels are processed by decreasing gain of their best feature. Where several features are tied, a channel takes
    those that other axes of its layer have.

    Args:
        library: the features.
        residual_models: the recordings.
        lines: their residuals.
        sigmas: of each recording, (c,) standard deviation of its residuals.
        explained: gain of the selected effects.
        steady: search for weaker terms that every part of the flights shows.
    """
    least = library.steady_threshold if steady else library.threshold
    channels, found = residual_models[0].channels, []
    searched = {c: _channel_equations(library, lines, sigmas, c) for c in searched_columns(residual_models)}
    for c in sorted(searched, key=lambda c: -np.abs(_signed_gains(searched[c][0], [])).max()):
        (equations, uncorrected), channel, names = searched[c], channels[c], library.features[0][c].names
        repeated = {axis_free_name(term) for term in found if term.channel.layer == channel.layer}
        preferred = {i for i, name in enumerate(names) if _axis_free(name, channel) in repeated}
        threshold = np.where(np.isin(np.arange(len(names)), list(preferred)), MIN_REPEATED_GAIN, least)
        threshold = np.maximum(threshold, MIN_EXPLAINED_SHARE * explained / library.variance_inflation[c].min())
        if channel.layer == DRIFTING_LAYER:
            threshold = np.maximum(threshold, MIN_DRIFT_SHARE * float(uncorrected.squares.sum()))
        local = frozenset(i for i, name in enumerate(names) if name in library.local_names)
        problem = _ChannelProblem(
            equations, uncorrected, library.variance_inflation[c], threshold, local, frozenset(preferred), steady
        )
        chosen = _choose(problem)
        if chosen:
            values = np.concatenate(
                [one[c].values[line.good] for one, line in zip(library.features, lines, strict=True)]
            )
            terms = _terms(channel, library.features[0][c], problem, chosen, values)
            found += [term for term in terms if not is_of_rows(term, residual_models)]
    return tuple(sorted(found, key=lambda term: channels.index(term.channel)))


def searched_columns(residual_models: tuple[ResidualModel, ...]) -> list[int]:
    """Return the channels that may show what no effect explains.

    Noise of motor commands that moves no motor hides a part of what the rotors did, which then depends on whatever the
    commands answer: channels of open size show no equation.
    """
    hidden = {c for one in residual_models for c in one.open_columns}
    return [
        c
        for c, channel in enumerate(residual_models[0].channels)
        if channel.layer != UNSEARCHED_LAYER and c not in hidden
    ]


def _channel_equations(
    library: FeatureLibrary, lines: list[Linearisation], sigmas, c: int
) -> tuple[NormalEquations, NormalEquations]:
    """Return the normal equations of one channel over all recordings, without and with the bias gradient."""
    parts = [
        _normal_equations(line, own[c], sigma[c], c)
        for line, own, sigma in zip(lines, library.features, sigmas, strict=True)
    ]
    corrected = [
        subtract_bias(part, gradients[c]) for part, gradients in zip(parts, library.bias_gradients, strict=True)
    ]
    return concatenate(corrected), concatenate(parts)


def _normal_equations(line: Linearisation, own: Features, sigma: float, c: int) -> NormalEquations:
    """Return the normal equations of one channel of a recording on its features."""
    sensitivity = np.where(line.good[:, None], own.values, 0.0).T[:, :, None]
    channel = replace(line, residual=line.residual[:, c : c + 1], sensitivity=sensitivity)
    return accumulate(channel, np.array([sigma]))


def _choose(problem: _ChannelProblem) -> list[int]:
    """Return the features of one channel with the largest gains, one after the other, by decreasing gain.

    Each must pass cross-validation. A feature counts with the smaller one of its gains with and without the bias of the
    pipeline, and not at all if the two have opposite signs.
    """
    slices = {str(i): slice(i, i + 1) for i in range(problem.equations.gradient.shape[1])}
    selection, chosen = stepwise.SelectionProblem(problem.equations, slices, None), []
    while len(chosen) < MAX_TERMS:
        corrected, uncorrected = _signed_gains(problem.equations, chosen), _signed_gains(problem.uncorrected, chosen)
        gains = np.where(corrected * uncorrected > 0, np.minimum(np.abs(corrected), np.abs(uncorrected)), 0.0)
        gains = np.where(gains < problem.threshold * problem.variance_inflation, 0.0, gains)
        tied = np.flatnonzero(gains >= gains.max() - max(TIE_SHARE * gains.max(), TIE_GAIN))
        best = int(min(tied, key=lambda i: i not in problem.preferred))  # else the first, which is the simplest
        if gains[best] == 0.0:
            break
        keys = [str(i) for i in chosen]
        if best not in problem.local and not stepwise.passes_cross_validation(selection, keys, str(best)):
            break
        if problem.steady and not _is_steady(problem, [*chosen, best]):
            break
        chosen.append(best)
    return _necessary(problem, chosen)


def _is_steady(problem: _ChannelProblem, chosen: list[int]) -> bool:
    """Return whether the last one of the chosen features is beyond what scatter over the seconds may make."""
    found = stepwise.fit(problem.equations, np.array(chosen), float(problem.variance_inflation[chosen[-1]]))
    return stepwise.chance(problem.equations, found, 1) < MAX_CHANCE


def _signed_gains(equations: NormalEquations, chosen: list[int]) -> np.ndarray:
    """Return the gain (q,) of each feature beside those chosen, with the sign of its coefficient; zero if collinear."""
    information, gradient = equations.total_information, equations.total_gradient
    remaining_information, remaining_gradient = np.diag(information).copy(), gradient.copy()
    if chosen:
        weights = solve(information[np.ix_(chosen, chosen)], information[chosen])
        remaining_information = remaining_information - np.einsum("ij,ij->j", information[chosen], weights)
        remaining_gradient = remaining_gradient - gradient[chosen] @ weights
    independent = remaining_information > MIN_INDEPENDENT_SHARE * np.diag(information)
    squares = remaining_gradient * np.abs(remaining_gradient)
    return np.where(independent, squares / np.where(independent, remaining_information, 1.0), 0.0)


def _necessary(problem: _ChannelProblem, chosen: list[int]) -> list[int]:
    """Return the features that later ones do not make superfluous, by decreasing gain."""
    while len(chosen) > 1:
        total = fit_gain(problem.equations, chosen)
        gains = {
            i: (total - fit_gain(problem.equations, [j for j in chosen if j != i])) / problem.variance_inflation[i]
            for i in chosen
        }
        weakest = min(chosen, key=lambda i: gains[i] - problem.threshold[i])
        if gains[weakest] >= problem.threshold[weakest]:
            return sorted(chosen, key=gains.get, reverse=True)
        chosen = [i for i in chosen if i != weakest]
    return chosen


def _terms(channel: Channel, own: Features, problem: _ChannelProblem, chosen: list[int], values) -> list[EquationTerm]:
    """Return the terms of the chosen features, with their ranges in the `values` (m, q) of all recordings."""
    fit, found = stepwise.fit(problem.equations, np.array(chosen)), []
    errors = np.sqrt(np.diag(fit.covariance))
    for i, (feature, value, error) in enumerate(zip(chosen, -fit.estimate, errors, strict=True)):
        low, high = np.quantile(values[:, feature], (0.02, 0.98))
        gain, uncorrected_gain = (
            fit_gain(equations, chosen[: i + 1]) - (fit_gain(equations, chosen[:i]) if i else 0.0)
            for equations in (problem.equations, problem.uncorrected)
        )
        found.append(
            EquationTerm(
                channel=channel,
                name=own.names[feature],
                feature_unit=own.units[feature],
                value=float(value),
                error=float(error),
                unit=units.ratio(channel.unit, own.units[feature]),
                low=float(low),
                high=float(high),
                gain=gain,
                net_gain=min(gain, uncorrected_gain),
            )
        )
    return found


def is_of_rows(term: EquationTerm, residual_models: tuple[ResidualModel, ...]) -> bool:
    """Return whether a term is a scale of a commanded rate that the time between two rows alone may make."""
    power, axis = SCALES_OF_RATES.get((term.channel.id, term.name), (0, 0))
    if not power:
        return False
    links = [one.recording.command_link for one in residual_models]
    peak = max(abs(term.low), abs(term.high))
    scale = abs(term.value) * peak ** (1.0 - 1.0 / power)
    return scale < max(link.scale_error()[axis] for link in links if link)


def subtract_terms(
    library: FeatureLibrary, recording: int, line: Linearisation, terms: tuple[EquationTerm, ...], channels
) -> Linearisation:
    """Return the residuals of a recording without what terms explain.

    Args:
        library: the features.
        recording: index of the recording.
        line: its residuals.
        terms: the terms.
        channels: the channels of the residuals, in their order.
    """
    residual = line.residual.copy()
    for term in terms:
        c = channels.index(term.channel)
        own = library.features[recording][c]
        residual[:, c] -= np.where(line.good, term.value * own.values[:, own.names.index(term.name)], 0.0)
    return replace(line, residual=residual)


def axis_free_name(term: EquationTerm) -> str:
    """Return the name of a term's feature with * for the axis of its channel: the same for all axes of a vector."""
    return _axis_free(term.name, term.channel)


def _axis_free(name: str, channel: Channel) -> str:
    return re.sub(rf"(?<=[_ ]){channel.axis}(?![a-z])", "*", name) if channel.axis else name


def cause_layer(terms: tuple[EquationTerm, ...], uncertain: Iterable[str] = ()) -> str:
    """Return the layer of the cause: the first in LAYER_ORDER with a part of the gain.

    Args:
        terms: the terms of an equation.
        uncertain: layers of selected effects that may have absorbed a part of the cause; they count as well.
    """
    total, gains = sum(term.net_gain for term in terms), {}
    for term in terms:
        layer = "force" if _is_echo(term, terms) else _layer(term)
        gains[layer] = gains.get(layer, 0.0) + term.net_gain
    layers = {layer for layer, gain in gains.items() if gain >= MIN_CAUSE_SHARE * total}
    return min(layers.union(uncertain), key=LAYER_ORDER.index)


def _layer(term: EquationTerm) -> str:
    """Return the layer of a term: that of its channel, but moment for the electrical power, drawn by the torque."""
    return "moment" if term.channel.quantity == ELECTRICAL_POWER else term.channel.layer


def _is_echo(term: EquationTerm, terms: tuple[EquationTerm, ...]) -> bool:
    """Return whether an accelerometer term is the consequence of a force that contains much more of the same quantity.

    An error of the accelerometer is as large in both. A short force differs between pose and accelerometer, as their
    filters differ.
    """
    return any(abs(force.value) > ECHO_RATIO * abs(term.value) for force in _force_terms(term, terms))


def is_mirrored(term: EquationTerm, terms: tuple[EquationTerm, ...]) -> bool:
    """Return whether an accelerometer term is repeated as a force term: the same coefficient with the opposite sign."""
    return any(
        abs(force.value + term.value) < EQUALITY_ERRORS * np.hypot(force.error, term.error)
        for force in _force_terms(term, terms)
    )


def _force_terms(term: EquationTerm, terms: tuple[EquationTerm, ...]) -> list[EquationTerm]:
    """Return the force terms of the same feature and axis as an accelerometer term; none for other terms."""
    if term.channel.quantity != ACCELEROMETER:
        return []
    force = SPECIFIC_FORCE, term.channel.axis, term.name
    return [one for one in terms if (one.channel.quantity, one.channel.axis, one.name) == force]
