"""How far recording and simulation are apart, second by second and layer by layer, before and after the repair."""

from dataclasses import dataclass

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.gauss_newton import with_effects
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.residuals.channels import ELECTRICAL_POWER, VOLTAGE, Channel
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

SMOOTH_S = 0.3  # over which the mismatch is averaged
LAYERS = {
    "command": "commands",
    "motor": "motors",
    "battery": "battery",
    "force": "forces",
    "moment": "moments",
    "imu": "instruments",
    "vio": "odometry",
    "camera": "camera",
}


@dataclass(frozen=True)
class Mismatch:
    """One recording: t (m,) s, p_world (m, 3) m or None; channels (c); noise (c,): what twins show of each; before and
    after (m, c): measured less simulated, NaN where it rests on no measurement. `after` is None without findings."""

    name: str
    t: np.ndarray
    p_world: np.ndarray | None
    channels: tuple[Channel, ...]
    noise: np.ndarray
    before: np.ndarray
    after: np.ndarray | None

    def layers(self, residual) -> dict[str, np.ndarray]:
        """Return by layer how many times (m,) the noise of its worst channel a residual (m, c) is around each time."""
        squares = _averaged(np.square(residual / self.noise), self.t)
        own = np.array([display_layer(channel) for channel in self.channels])
        return {layer: np.sqrt(_largest(squares[:, own == layer])) for layer in LAYERS if layer in own}

    def worst(self, residual) -> np.ndarray:
        """Return the same (m,) of the worst layer."""
        return _largest(np.stack(list(self.layers(residual).values()), axis=1))


def display_layer(channel: Channel) -> str:
    """Return the layer of a channel for a reader: the battery's stands apart from the motors'."""
    return "battery" if channel.quantity in (VOLTAGE, ELECTRICAL_POWER) else channel.layer


def mismatches_of(diagnosis, vehicle: Vehicle) -> tuple[Mismatch, ...]:
    """Return the mismatch of every recording. vehicle: as its file has it, before the repair."""
    effects = tuple(one.effect for one in diagnosis.selected)
    evidence, found = diagnosis.evidence, []
    owns = diagnosis.own_effects or ((),) * len(evidence.residual_models)
    for residual_model, noise, own in zip(evidence.residual_models, evidence.noises, owns, strict=True):
        repaired = _repaired(diagnosis, vehicle, own)
        vehicles = [vehicle, repaired] if effects else [vehicle]
        residuals = [_residual(residual_model, with_effect_terms(one, effects)) for one in vehicles]
        p_world = residual_model.recording.p_world
        found.append(
            Mismatch(
                residual_model.recording.name,
                residual_model.t,
                None if p_world is None else p_world[residual_model.filter.rows],
                residual_model.channels,
                noise,
                residuals[0],
                residuals[1] if effects else None,
            )
        )
    return tuple(found)


def _repaired(diagnosis, vehicle: Vehicle, own) -> Vehicle:
    """Return the vehicle as it was in one of several flights: with what all share, and what that one has to itself."""
    if not diagnosis.own_effects:
        return diagnosis.vehicle
    apart = {one.effect.key for owned in diagnosis.own_effects for one in owned}  # of which the diagnosis' vehicle has means
    there = [*(one for one in diagnosis.selected if one.effect.key not in apart), *own]
    return with_effects(vehicle, [one.effect for one in there], {one.effect.key: one.values for one in there})


def _residual(residual_model: ResidualModel, vehicle: Vehicle) -> np.ndarray:
    return np.where(residual_model.good[:, None] & residual_model.measured, residual_model.residual(vehicle), np.nan)


def _largest(values) -> np.ndarray:
    """Return the largest (m,) of values (m, c) that are there, NaN where none is."""
    filled = np.where(np.isfinite(values), values, -np.inf).max(axis=1)
    return np.where(np.isfinite(filled), filled, np.nan)


def _averaged(values, t) -> np.ndarray:
    """Return values (m, c) averaged over SMOOTH_S around each, without those that are not there."""
    half = max(1, round(0.5 * SMOOTH_S / (t[1] - t[0])))
    there = np.isfinite(values)
    sums = (
        np.cumsum(np.pad(part, ((half + 1, half), (0, 0))), axis=0) for part in (np.where(there, values, 0.0), there)
    )
    total, count = (part[2 * half + 1 :] - part[: -2 * half - 1] for part in sums)
    return np.where(there, total / np.maximum(count, 1), np.nan)
