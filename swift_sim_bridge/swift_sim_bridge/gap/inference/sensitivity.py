"""Sensitivities: change of every residual per step of every effect's parameters, by numerical derivatives."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import file_values, idle_terms, inject
from swift_sim_bridge.gap.effects.patch import with_idle_terms
from swift_sim_bridge.gap.inference import nuisance
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.variants import Variants
from swift_sim_bridge.parallel import run_in_threads

# What a variant of the vehicle changes in the replay, by the effect's layer; "motion" for all others.
CHANGES = {"motor": "motor", "imu": "imu", "vio": "imu", "camera": "camera", "command": "command"}


@dataclass(frozen=True)
class Linearisation:
    """Residuals of one recording against one vehicle, to first order in the parameters of effects.

    Attributes:
        t: (m,) time, s.
        residual: (m, c) measured minus modelled value of each channel, zero where not `good`.
        sensitivity: (p, m, c) change of the residual per step of each parameter, in the order of the effects.
        good: (m,) whether the residuals at this time are based on measurements.
    """

    t: np.ndarray
    residual: np.ndarray
    sensitivity: np.ndarray
    good: np.ndarray


def with_effect_terms(vehicle: Vehicle, effects: tuple[Effect, ...]) -> Vehicle:
    """Return the vehicle with the terms of every effect; terms that it lacks are added with their idle values."""
    return with_idle_terms(vehicle, idle_terms(effects))


def parameter_steps(effects: tuple[Effect, ...]) -> np.ndarray:
    """Return the step (p,) of each parameter, in its unit."""
    return np.array([parameter.step for effect in effects for parameter in effect.parameters])


def parameter_slices(effects: tuple[Effect, ...]) -> dict[str, slice]:
    """Return the positions of each effect's parameters among the parameters of all effects, by the effect's key."""
    found, begin = {}, 0
    for effect in effects:
        found[effect.key] = slice(begin, begin + len(effect.parameters))
        begin += len(effect.parameters)
    return found


def perturbed_variants(vehicle: Vehicle, effects: tuple[Effect, ...], central: bool = True) -> Variants:
    """Return the vehicle, followed by one vehicle for each step of each parameter.

    Effects that shift measurements in time are always perturbed in both directions: interpolation between samples
    averages their noise, in either direction, and a one-sided difference would contain that change of the noise.

    Args:
        vehicle: the vehicle to linearise about.
        effects: effects whose parameters are perturbed.
        central: whether every parameter is moved up and down, for central differences; else up only.
    """
    vehicle = with_effect_terms(vehicle, effects)
    vehicles, changes, sides = [vehicle], [""], []
    for effect in effects:
        values = file_values(effect, vehicle)
        both = central or effect.retimes
        for i, parameter in enumerate(effect.parameters):
            sides.append((len(vehicles), len(vehicles) + 1 if both else 0))
            for sign in (1.0, -1.0) if both else (1.0,):
                moved = values.copy()
                moved[i] += sign * parameter.step
                vehicles.append(inject(vehicle, effect, moved))
                changes.append(CHANGES.get(effect.layer, "motion"))
    return Variants(tuple(vehicles), tuple(changes), tuple(sides))


def linearise(residual_model: ResidualModel, variants: Variants, marginal: bool = True) -> Linearisation:
    """Return the residuals of a recording against the first variant, and their sensitivities.

    Args:
        residual_model: of the recording.
        variants: the vehicle and its variants.
        marginal: whether to take out what the nuisance parameters of the recording may explain (see `nuisance`).
    """
    residual = residual_model.residuals(variants)
    good = residual_model.good
    residual[:, ~good] = 0.0
    first = residual[0].copy()
    for row, (above, below) in zip(residual, variants.sides, strict=False):  # overwrites rows that are not needed again
        np.subtract(residual[above], residual[below] if below else first, out=row)
        if below:
            row /= 2.0
    sensitivity = residual[: len(variants.sides)]
    if marginal:
        nuisances = residual_model.nuisance(variants.vehicles[0])
        first, sensitivity = (nuisance.without_nuisance(values, nuisances) for values in (first, sensitivity))
    return Linearisation(residual_model.t, first, sensitivity, good)


def linearise_all(residual_models: list[ResidualModel], variants: Variants) -> list[Linearisation]:
    """Return the linearisations of many recordings, computed in parallel."""
    first = linearise(residual_models[0], variants)  # computes what all share, before the threads start
    return [first, *run_in_threads(*(partial(linearise, one, variants) for one in residual_models[1:]))]


class LinearisationCache:
    """The latest linearisations of recordings: a search returns to vehicles that it has tried."""

    MAX_ENTRIES = 3  # bounds the memory; a search alternates between few vehicles

    def __init__(self):
        self._entries: list[tuple[tuple, tuple, list[Linearisation]]] = []

    def linearisations(
        self, residual_models: tuple[ResidualModel, ...], vehicle: Vehicle, effects: tuple[Effect, ...], central: bool
    ) -> list[Linearisation]:
        """Return the linearisation of each recording; for the arguments see `perturbed_variants`."""
        key = vehicle, effects, central
        found = next(
            (lines for models, known, lines in self._entries if models is residual_models and known == key), None
        )
        if found is None:
            variants = perturbed_variants(vehicle, effects, central)
            found = [linearise(one, variants) for one in residual_models]
        others = [entry for entry in self._entries if entry[2] is not found]
        self._entries = [(residual_models, key, found), *others][: self.MAX_ENTRIES]
        return found


def noise_floor(lines: list[Linearisation], channels) -> np.ndarray:
    """Return the lower bound (c,) of the noise of each channel, in its unit.

    It is the channel's negligible deviation. For gate corners, whose residual is zero in images without a gate, it is
    their root mean square in images with one.
    """
    floor = np.array([channel.negligible for channel in channels])
    for c in (c for c, channel in enumerate(channels) if channel.layer == "camera"):
        observed = np.concatenate([line.residual[:, c][line.residual[:, c] != 0] for line in lines])
        floor[c] = np.sqrt(np.mean(np.square(observed))) if len(observed) else 1.0
    return floor
