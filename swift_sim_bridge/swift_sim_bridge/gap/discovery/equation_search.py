"""Physics that is in no catalogue: what is left beside all names, as a short equation in quantities with dimensions.

Every channel is searched by itself for the few features on which what is left depends. A name must be worth more than
such an equation: what a neighbour of the true cause explains by half, three features often explain in full.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from swift_sim_bridge.gap.discovery import features, units
from swift_sim_bridge.gap.inference import local_wind_search, stepwise
from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, accumulate, concatenate, fit_gain, solve
from swift_sim_bridge.gap.inference.null_distribution import seconds_with_data, subtract_bias
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.channels import ACCELEROMETER, ELECTRICAL_POWER, SPECIFIC_FORCE, Channel
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel, Variants

MOST_TERMS = 3  # in one channel
LEAST_GAIN = 80.0  # of a term, in independent samples' squares: the best of many features, over noise that no twin has
REFERENCE_MARGIN = 1.5  # times the largest that any twin shows anywhere
KIN = 20.0  # of a term, where another axis of its layer goes by the same: one of a few
LEAST_SHARE = 0.002  # of all that was explained: less may be the pipeline's own error beside strong effects
TIED, BY_CHANCE = 0.004, 9.0  # of the best one's gain, and squares, by which a simpler one may explain less
COLLINEAR = 1e-3  # share of a feature that must be new
WORLD = ("east", "north", "up")
DETECTED = "camera"  # a detector errs by what it sees: in one flight that goes by something, whatever it is
WANDERING, DOMINANT = "vio", 0.1  # odometry drifts on purpose: a term is none unless of such a share of its squares
TRACE, ECHO = 0.02, 2.0  # of what all terms explain, that the cause's layer has at least; times what only echoes it
SAME = 3.0  # standard errors by which two of one size may differ
ORDER = ("command", "motor", "imu", "vio", "camera", "force", "moment")  # no fault leaks into a layer before its own


@dataclass(frozen=True)
class EquationTerm:
    """A summand of one channel's residual. channel; name, per: of the feature, and its unit; value, error, unit: of its
    coefficient; low, high: where the feature was flown; gain: what it adds to those before it, without what the
    pipeline makes of it by itself; lowers: by how much it lowers the squares, which what the pipeline makes may lessen
    but not add to: noise in a modelled moment goes by that moment."""

    channel: Channel
    name: str
    per: str
    value: float
    error: float
    unit: str
    low: float
    high: float
    gain: float
    lowers: float


@dataclass(frozen=True)
class FeatureLibrary:
    """Features by which the residuals may go, [recording][channel]; what twins show of them: artefacts [recording]
    [channel] (q,), mean product a second; copies [channel] (q,), how many times larger gains are than
    by independent samples; threshold: the gain of a term that no twin shows anywhere; bound: features of one place."""

    features: tuple[list[features.Features], ...]
    bias_gradient_by_channel: tuple[list[np.ndarray], ...]
    copies: list[np.ndarray]
    threshold: float
    bound: frozenset[str] = frozenset()


def build_library(residual_models: tuple[ResidualModel, ...], twins, variants: Variants, sigmas) -> FeatureLibrary:
    """Return the features of recordings, and what their twins, (replayer, linearisation) each, show of them."""
    recorded = tuple(features.build_features(one, variants) for one in residual_models)
    artefacts, gains = [], []
    for own, group, sigma in zip(recorded, twins, sigmas, strict=True):
        seen = [
            _seen(line, _completed(features.build_features(twin, variants), own, len(line.t)), sigma)
            for twin, line in group
        ]
        means = [np.array([part[c][0] for part in seen]) for c in range(len(own))]
        artefacts.append([mean.mean(axis=0) for mean in means])
        gains.append([_gains_alone(means[c], [part[c][1:] for part in seen]) for c in range(len(own))])
    copies = [
        np.maximum(np.mean([part[c].mean(axis=0) for part in gains], axis=0), 1.0) for c in range(len(recorded[0]))
    ]
    largest = max(float(np.max(part[c] / copies[c])) for part in gains for c in range(len(part)))
    return FeatureLibrary(recorded, tuple(artefacts), copies, max(LEAST_GAIN, REFERENCE_MARGIN * largest))


def with_noise_ratio(known: FeatureLibrary, times: list[np.ndarray]) -> FeatureLibrary:
    """Return the library with artefacts weighed as in recordings so many times (c,) as noisy as their twins."""
    artefacts = tuple(
        [one / ratio**2 for one, ratio in zip(own, ratios, strict=True)]
        for own, ratios in zip(known.bias_gradient_by_channel, times, strict=True)
    )
    return replace(known, bias_gradient_by_channel=artefacts)


def with_local_features(
    known: FeatureLibrary, residual_models: tuple[ResidualModel, ...], lines: list[Linearisation], sigmas
) -> FeatureLibrary:
    """Return the library with pushes along the world's axes at one place among its features of forces, if what is left
    of a single recording calls for that: air that moves there, or whatever it is."""
    (residual_model, *others), (line, *_), (sigma, *_) = residual_models, lines, sigmas
    force = [c for c, channel in enumerate(residual_model.channels) if channel.layer == "force"]
    if others or not force:
        return known
    axes = np.zeros((len(WORLD), *line.residual.shape))
    for c in force:
        own = known.features[0][c]
        for i, name in enumerate(WORLD):
            axes[i, :, c] = own.values[:, own.names.index(f"{name}_{residual_model.channels[c].axis}")]
    p_world = residual_model.recording.p_world[residual_model.filter.rows]
    place = local_wind_search.search(line, axes, p_world, sigma)
    if place.gain < LEAST_GAIN:
        return known
    at, share = (
        ", ".join(f"{x:.1f}" for x in place.center),
        local_wind_search.share(p_world, place.center, place.radius),
    )
    recorded, artefacts, copies, bound = (
        list(known.features[0]),
        list(known.bias_gradient_by_channel[0]),
        list(known.variance_inflation),
        set(),
    )
    for c in force:
        own, axis = recorded[c], residual_model.channels[c].axis
        names = tuple(f"{name}_{axis} within {place.radius} m of ({at})" for name in WORLD)
        bound.update(names)
        values = np.concatenate([own.values, share[:, None] * axes[:, :, c].T], axis=1)
        recorded[c] = features.Features((*own.names, *names), (*own.units, *[""] * len(WORLD)), values)
        artefacts[c] = np.append(artefacts[c], np.zeros(len(WORLD)))
        copies[c] = np.append(copies[c], np.ones(len(WORLD)))
    return FeatureLibrary((recorded,), (artefacts,), copies, known.threshold, frozenset(bound))


def _completed(twin: list[features.Features], own: list[features.Features], rows: int) -> list[features.Features]:
    """Return the twin's features, and the recording's where the twin lacks the channel."""
    borrowed = [
        replace(one, values=np.pad(one.values, ((0, max(0, rows - len(one.values))), (0, 0)))[:rows])
        for one in own[len(twin) :]
    ]
    return [*twin, *borrowed]


def _seen(line: Linearisation, own: list[features.Features], sigma) -> list[tuple]:
    """Return for each channel the mean product (q,) a second, its square sum (q,) and the seconds of a twin."""
    seconds, found = seconds_with_data(line), []
    for c, one in enumerate(own):
        values = one.values[line.good] / sigma[c]
        found.append(
            (values.T @ (line.residual[line.good, c] / sigma[c]) / seconds, np.sum(values**2, axis=0), seconds)
        )
    return found


def _gains_alone(means, rest) -> np.ndarray:
    """Return the gain (k, q) of each feature alone in each of k twins, without what the others show in the mean."""
    count = len(means)
    others = (means.sum(axis=0) - means) / max(count - 1, 1)
    return np.array(
        [
            ((mean - other) * seconds) ** 2 / np.maximum(squares, 1e-300)
            for mean, other, (squares, seconds) in zip(means, others, rest, strict=True)
        ]
    )


def search(
    known: FeatureLibrary,
    residual_models: tuple[ResidualModel, ...],
    lines: list[Linearisation],
    sigmas,
    explained: float = 0.0,
) -> tuple[EquationTerm, ...]:
    """Return the terms that what is left, the residual of `lines`, calls for; explained: by how much names lowered the
    squares before.

    The channel in which most is left speaks first: where others are of two minds they go by the same as it does.
    """
    channels, found = residual_models[0].channels, []
    searched = {c: _left(known, lines, sigmas, c) for c, channel in enumerate(channels) if channel.layer != DETECTED}
    for c in sorted(searched, key=lambda c: -np.abs(_gains(searched[c][0], [])).max()):
        (sums, whole), channel, names = searched[c], channels[c], known.features[0][c].names
        once = {i for i, name in enumerate(names) if name in known.bound}
        alike = {axis_free_name(term) for term in found if term.channel.layer == channel.layer}
        liked = {i for i, name in enumerate(names) if _along(name, channel) in alike}
        least = np.where(np.isin(np.arange(len(names)), list(liked)), KIN, known.threshold)
        least = np.maximum(least, LEAST_SHARE * explained / known.variance_inflation[c].min())
        if channel.layer == WANDERING:
            least = np.maximum(least, DOMINANT * float(whole.squares.sum()))
        chosen = _chosen(sums, whole, known.variance_inflation[c], least, once, liked)
        if chosen:
            values = np.concatenate([one[c].values[line.good] for one, line in zip(known.features, lines, strict=True)])
            found += _terms(channel, known.features[0][c], sums, whole, chosen, values)
    return tuple(sorted(found, key=lambda term: channels.index(term.channel)))


def _left(known: FeatureLibrary, lines: list[Linearisation], sigmas, c: int) -> tuple[NormalEquations, NormalEquations]:
    """Return the sums of features and what is left of one channel, without and with what the pipeline makes."""
    parts = [_sums(line, own[c], sigma[c], c) for line, own, sigma in zip(lines, known.features, sigmas, strict=True)]
    bare = [
        subtract_bias(part, artefact[c]) for part, artefact in zip(parts, known.bias_gradient_by_channel, strict=True)
    ]
    return concatenate(bare), concatenate(parts)


def _sums(line: Linearisation, own: features.Features, sigma: float, c: int) -> NormalEquations:
    columns = np.where(line.good[:, None], own.values, 0.0).T[:, :, None]
    return accumulate(replace(line, residual=line.residual[:, c : c + 1], columns=columns), np.array([sigma]))


def _chosen(sums: NormalEquations, whole: NormalEquations, copies, least, once: set[int], liked: set[int]) -> list[int]:
    """Return the features of one channel that lower its squares most, one after the other, as long as each does so on
    parts of the flight that the fit has not seen.

    whole: the sums with what the pipeline makes: what only that calls for, or only the lack of it, is none, nor is what
    both call for with opposite signs; least (q,): gain that each must have; once: features that may show in a single
    part: a place may be passed but once; liked: those that stand first among equals.
    """
    slices = {str(i): slice(i, i + 1) for i in range(sums.products.shape[1])}
    scene, chosen = stepwise.SelectionProblem(sums, slices, None), []
    while len(chosen) < MOST_TERMS:
        bare, full = _gains(sums, chosen), _gains(whole, chosen)
        gains = np.where(bare * full > 0, np.minimum(np.abs(bare), np.abs(full)), 0.0)
        gains = np.where(gains < least * copies, 0.0, gains)  # beyond chance they are rivals for one residual
        equals = np.flatnonzero(gains >= gains.max() - max(TIED * gains.max(), BY_CHANCE))  # simple ones stand first
        best = int(min(equals, key=lambda i: i not in liked))
        if gains[best] == 0.0:
            break
        if best not in once and not stepwise.passes_cross_validation(scene, [str(i) for i in chosen], str(best)):
            break
        chosen.append(best)
    return _needed(sums, chosen, copies, least)


def _gains(sums: NormalEquations, chosen: list[int]) -> np.ndarray:
    """Return by how much each feature (q,) lowers the squares beside those chosen, with the sign of its coefficient;
    zero where it is nothing new."""
    matrix, products = sums.matrix.sum(axis=0), sums.products.sum(axis=0)
    rest, left = np.diag(matrix).copy(), products.copy()
    if chosen:
        weights = solve(matrix[np.ix_(chosen, chosen)], matrix[chosen])
        rest, left = rest - np.einsum("ij,ij->j", matrix[chosen], weights), left - products[chosen] @ weights
    new = rest > COLLINEAR * np.diag(matrix)
    return np.where(new, left * np.abs(left) / np.where(new, rest, 1.0), 0.0)


def _needed(sums: NormalEquations, chosen: list[int], copies, least) -> list[int]:
    """Return those of the features that the later ones do not make superfluous, the strongest first."""
    while len(chosen) > 1:
        whole = fit_gain(sums, chosen)
        alone = {i: (whole - fit_gain(sums, [j for j in chosen if j != i])) / copies[i] for i in chosen}
        weakest = min(chosen, key=lambda i: alone[i] - least[i])
        if alone[weakest] >= least[weakest]:
            return sorted(chosen, key=alone.get, reverse=True)
        chosen = [i for i in chosen if i != weakest]
    return chosen


def _terms(
    channel: Channel, own: features.Features, sums: NormalEquations, whole: NormalEquations, chosen: list[int], values
) -> list[EquationTerm]:
    fit, found = stepwise.fit(sums, np.array(chosen)), []
    errors = np.sqrt(np.diag(fit.covariance))
    for i, (feature, size, error) in enumerate(zip(chosen, -fit.sizes, errors, strict=True)):
        low, high = np.quantile(values[:, feature], (0.02, 0.98))
        gain, made = (
            fit_gain(one, chosen[: i + 1]) - (fit_gain(one, chosen[:i]) if i else 0.0) for one in (sums, whole)
        )
        unit, lowers = units.ratio(channel.unit, own.units[feature]), min(gain, made)
        found.append(
            EquationTerm(
                channel,
                own.names[feature],
                own.units[feature],
                float(size),
                float(error),
                unit,
                float(low),
                float(high),
                gain,
                lowers,
            )
        )
    return found


def without(
    known: FeatureLibrary, recording: int, line: Linearisation, terms: tuple[EquationTerm, ...], channels
) -> Linearisation:
    """Return a residual without what terms explain of it; channels: of the recording, in their order."""
    residual = line.residual.copy()
    for term in terms:
        c = channels.index(term.channel)
        own = known.features[recording][c]
        residual[:, c] -= np.where(line.good, term.value * own.values[:, own.names.index(term.name)], 0.0)
    return replace(line, residual=residual)


def axis_free_name(term: EquationTerm) -> str:
    """Return the name of a term's quantity with * for the axis of its channel: what goes by the speed along each axis
    goes by one quantity."""
    return _along(term.name, term.channel)


def _along(name: str, channel: Channel) -> str:
    return re.sub(rf"(?<=[_ ]){channel.axis}(?![a-z])", "*", name) if channel.axis else name


def _layer(term: EquationTerm) -> str:
    """Return the layer of a term's channel; of power that of the rotors' torque, which draws it."""
    return "moment" if term.channel.quantity == ELECTRICAL_POWER else term.channel.layer


def cause_layer(terms: tuple[EquationTerm, ...], doubtful: Iterable[str] = ()) -> str:
    """Return the layer where the cause must lie: the first that measured inputs reach, and that holds more than a trace
    of it; doubtful: layers of names that may have taken a part of it."""
    whole, held = sum(term.lowers for term in terms), {}
    for term in terms:
        layer = "force" if _echo(term, terms) else _layer(term)
        held[layer] = held.get(layer, 0.0) + term.lowers
    return min({layer for layer, part in held.items() if part >= TRACE * whole}.union(doubtful), key=ORDER.index)


def _echo(term: EquationTerm, terms: tuple[EquationTerm, ...]) -> bool:
    """Return whether the accelerometer differs from the pose by something that the force has much more of: no error of
    its own, which is as large in both, but a push too short for both to follow it alike."""
    return any(abs(push.value) > ECHO * abs(term.value) for push in _pushes(term, terms))


def is_mirrored(term: EquationTerm, terms: tuple[EquationTerm, ...]) -> bool:
    """Return whether a term is the accelerometer's own error, which another has as a force: the same number twice."""
    return any(abs(push.value + term.value) < SAME * np.hypot(push.error, term.error) for push in _pushes(term, terms))


def _pushes(term: EquationTerm, terms: tuple[EquationTerm, ...]) -> list[EquationTerm]:
    """Return the terms of the force that go by the same along the same axis, if the term is the accelerometer's."""
    if term.channel.quantity != ACCELEROMETER:
        return []
    force = SPECIFIC_FORCE, term.channel.axis, term.name
    return [one for one in terms if (one.channel.quantity, one.channel.axis, one.name) == force]
