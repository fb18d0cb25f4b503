"""Library of the equation search: the features of all recordings, and their statistics on reference flights."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from swift_sim_bridge.gap.discovery import features
from swift_sim_bridge.gap.discovery.features import Features
from swift_sim_bridge.gap.inference import local_wind_search
from swift_sim_bridge.gap.inference.null_distribution import seconds_with_data
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel, Variants
from swift_sim_bridge.parallel import run_in_threads

# Gain, in squares of independent samples, that a term must have: that of the best of many features, with noise beyond
# that of the reference flights. With 30, null cases of the referee were taken for unknown physics.
MIN_GAIN = 80.0
MIN_STEADY_GAIN = 40.0  # the same of a term that every part of the flight shows; in a null case chance made one of 90
REFERENCE_MARGIN = 1.5  # factor over the largest gain of any reference flight; larger overlooks weaker terms
WORLD_AXES = ("east", "north", "up")  # prefixes of the features that are axes of the world in the body


@dataclass(frozen=True)
class FeatureLibrary:
    """Features of the channels of all recordings.

    Attributes:
        features: Features [recording][channel], with q features each.
        bias_gradients: [recording][channel] (q,) mean gradient per second in the reference flights.
        variance_inflation: [channel] (q,) factor by which gains exceed those of independent samples, at least 1.
        threshold: gain that a term must have, in independent samples.
        steady_threshold: gain that a term must have that every part of the flight shows, likewise.
        local_names: names of the features that act at one place alone.
        places: the places as quantities of an equation, see `physics.terms.quantities`.
    """

    features: tuple[list[Features], ...]
    bias_gradients: tuple[list[np.ndarray], ...]
    variance_inflation: list[np.ndarray]
    threshold: float
    steady_threshold: float
    local_names: frozenset[str] = frozenset()
    places: tuple[str, ...] = ()


def build_library(residual_models: tuple[ResidualModel, ...], references, variants: Variants, sigmas) -> FeatureLibrary:
    """Return the library of recordings.

    Args:
        residual_models: the recordings.
        references: of each recording, pairs of residual model and linearisation, one for each reference flight.
        variants: the vehicle, as first variant.
        sigmas: of each recording, (c,) standard deviation of its residuals.
    """
    recorded = tuple(features.build_features(one, variants) for one in residual_models)
    bias_gradients, gains = [], []
    for own, group, sigma in zip(recorded, references, sigmas, strict=True):
        statistics = run_in_threads(*(partial(_statistics, *one, variants, own, sigma) for one in group))
        gradients = [np.array([part[c][0] for part in statistics]) for c in range(len(own))]
        bias_gradients.append([gradient.mean(axis=0) for gradient in gradients])
        gains.append([_single_gains(gradients[c], [part[c][1:] for part in statistics]) for c in range(len(own))])
    inflation = [
        np.maximum(np.mean([part[c].mean(axis=0) for part in gains], axis=0), 1.0) for c in range(len(recorded[0]))
    ]
    largest = max(float(np.max(part[c] / inflation[c])) for part in gains for c in range(len(part)))
    thresholds = (max(least, REFERENCE_MARGIN * largest) for least in (MIN_GAIN, MIN_STEADY_GAIN))
    return FeatureLibrary(recorded, tuple(bias_gradients), inflation, *thresholds)


def with_vehicle(
    library: FeatureLibrary, residual_models: tuple[ResidualModel, ...], variants: Variants
) -> FeatureLibrary:
    """Return the library with the features that the recordings have by another vehicle.

    Args:
        library: the library, with the statistics of its reference flights.
        residual_models: the recordings.
        variants: the other vehicle, as first variant.
    """
    return replace(library, features=tuple(features.build_features(one, variants) for one in residual_models))


def with_noise_ratio(library: FeatureLibrary, ratios: list[np.ndarray]) -> FeatureLibrary:
    """Return the library with its bias gradients weighted by the noise of the recordings.

    Args:
        library: the library.
        ratios: of each recording, (c,) standard deviation of its residuals relative to its reference flights'.
    """
    bias_gradients = tuple(
        [gradient / ratio**2 for gradient, ratio in zip(own, own_ratios, strict=True)]
        for own, own_ratios in zip(library.bias_gradients, ratios, strict=True)
    )
    return replace(library, bias_gradients=bias_gradients)


def with_local_features(
    library: FeatureLibrary, residual_models: tuple[ResidualModel, ...], lines: list[Linearisation], sigmas
) -> FeatureLibrary:
    """Return the library with forces at one place, if a recording calls for them: thrust, and along the world's axes.

    Several recordings need not share a world: their library is returned as it is.

    Args:
        library: the library.
        residual_models: the recordings.
        lines: their residuals.
        sigmas: of each recording, (c,) standard deviation of its residuals.
    """
    (residual_model, *others), (line, *_), (sigma, *_) = residual_models, lines, sigmas
    force = [c for c, channel in enumerate(residual_model.channels) if channel.layer == "force"]
    if others or not force:
        return library
    axes = np.zeros((len(WORLD_AXES), *line.residual.shape))
    for c in force:
        own = library.features[0][c]
        for i, name in enumerate(WORLD_AXES):
            axes[i, :, c] = own.values[:, own.names.index(f"{name}_{residual_model.channels[c].axis}")]
    p_world = residual_model.recording.p_world[residual_model.filter.rows]
    place = local_wind_search.find_local_wind(line, axes, p_world, sigma)
    if place.gain < MIN_GAIN:
        return library
    place = local_wind_search.refined(place, line, axes, p_world, sigma)
    center = ", ".join(f"{x:.1f}" for x in place.center)
    weight = local_wind_search.local_weight(p_world, place.center, place.radius)
    recorded, gradients = list(library.features[0]), list(library.bias_gradients[0])
    inflation, local_names = list(library.variance_inflation), set()
    for c in force:
        own, axis = recorded[c], residual_model.channels[c].axis
        names, units, values = _components_of_force(own, axis, axes[:, :, c])
        names = tuple(f"{name} within {place.radius} m of ({center})" for name in names)
        local_names.update(names)
        values = np.concatenate([own.values, weight[:, None] * values], axis=1)
        recorded[c] = Features((*own.names, *names), (*own.units, *units), values)
        gradients[c] = np.append(gradients[c], np.zeros(len(names)))
        inflation[c] = np.append(inflation[c], np.ones(len(names)))
    near = f"near({','.join(f'{x:.3f}' for x in (*place.center, place.radius))})"
    return replace(
        library,
        features=(recorded,),
        bias_gradients=(gradients,),
        variance_inflation=inflation,
        local_names=frozenset(local_names),
        places=(near,),
    )


def _components_of_force(own: Features, axis: str, world) -> tuple[tuple[str, ...], tuple[str, ...], np.ndarray]:
    """Return names, units and values (m, k) of the forces along one axis of the body that may act at a place.

    Args:
        own: features of the force's channel.
        axis: of the channel.
        world: (3, m) components of the world's axes along it.
    """
    names, units = tuple(f"{name}_{axis}" for name in WORLD_AXES), ("",) * len(WORLD_AXES)
    if axis != "z":
        return names, units, world.T
    thrust = own.names.index("thrust")
    return (f"thrust_{axis}", *names), (own.units[thrust], *units), np.column_stack([own.values[:, thrust], world.T])


def _completed(reference: list[Features], own: list[Features], rows: int) -> list[Features]:
    """Return the features of a reference flight, with the recording's for channels that it lacks."""
    borrowed = [
        replace(one, values=np.pad(one.values, ((0, max(0, rows - len(one.values))), (0, 0)))[:rows])
        for one in own[len(reference) :]
    ]
    return [*reference, *borrowed]


def _statistics(flight: ResidualModel, line: Linearisation, variants: Variants, own: list[Features], sigma) -> list:
    """Return for each channel the gradient (q,) per second, the sum of squares (q,) of features, and the seconds.

    Args:
        flight: a reference flight.
        line: its linearisation.
        variants: the vehicle, as first variant.
        own: features of the recording.
        sigma: (c,) standard deviation of the residuals.
    """
    seconds, found = seconds_with_data(line), []
    for c, one in enumerate(_completed(features.build_features(flight, variants), own, len(line.t))):
        values = one.values[line.good] / sigma[c]
        gradient = values.T @ (line.residual[line.good, c] / sigma[c]) / seconds
        found.append((gradient, np.sum(values**2, axis=0), seconds))
    return found


def _single_gains(gradients, others) -> np.ndarray:
    """Return the gain (k, q) of each feature alone in each of k flights, less the mean gradient of the others."""
    count = len(gradients)
    means = (gradients.sum(axis=0) - gradients) / max(count - 1, 1)
    return np.array(
        [
            ((gradient - mean) * seconds) ** 2 / np.maximum(squares, 1e-300)
            for gradient, mean, (squares, seconds) in zip(gradients, means, others, strict=True)
        ]
    )
