"""Mismatch of recording and simulation over time, by layer, before and after the repair."""

from dataclasses import dataclass

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.gauss_newton import with_effects
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.residuals.channels import ELECTRICAL_POWER, VOLTAGE, Channel
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

AVERAGING_S = 0.3  # over which squares are averaged; longer gives smoother figures that locate less exactly
LAYERS = {
    "command": "commands",
    "motor": "motors",
    "battery": "battery",
    "force": "forces",
    "moment": "moments",
    "imu": "instruments",
    "vio": "odometry",
    "camera": "camera",
}  # labels by layer, in the order of the figures


@dataclass(frozen=True)
class Mismatch:
    """The mismatch of one recording.

    Attributes:
        name: name of the recording.
        t: (m,) time, s.
        p_world: (m, 3) position, m; None without a pose.
        channels: the c channels.
        noise: (c,) noise of each channel in the reference flights.
        before: (m, c) measured minus simulated value before the repair, NaN where nothing was measured.
        after: (m, c) the same after the repair; None without findings.
    """

    name: str
    t: np.ndarray
    p_world: np.ndarray | None
    channels: tuple[Channel, ...]
    noise: np.ndarray
    before: np.ndarray
    after: np.ndarray | None

    def layers(self, residual) -> dict[str, np.ndarray]:
        """Return by layer the root mean square (m,) of its worst channel over time, in multiples of its noise.

        Args:
            residual: (m, c), `before` or `after`.
        """
        squares = _averaged(np.square(residual / self.noise), self.t)
        own = np.array([display_layer(channel) for channel in self.channels])
        return {layer: np.sqrt(_largest(squares[:, own == layer])) for layer in LAYERS if layer in own}

    def worst(self, residual) -> np.ndarray:
        """Return the same (m,) of the worst layer."""
        return _largest(np.stack(list(self.layers(residual).values()), axis=1))


def display_layer(channel: Channel) -> str:
    """Return the layer of a channel as figures show it: the battery is separate from the motors."""
    return "battery" if channel.quantity in (VOLTAGE, ELECTRICAL_POWER) else channel.layer


def mismatches_of(diagnosis, vehicle: Vehicle) -> tuple[Mismatch, ...]:
    """Return the mismatch of each recording of a diagnosis.

    Args:
        diagnosis: the diagnosis.
        vehicle: the vehicle before the repair.
    """
    effects = tuple(one.effect for one in diagnosis.selected)
    evidence, found = diagnosis.evidence, []
    own_effects = diagnosis.own_effects or ((),) * len(evidence.residual_models)
    for residual_model, noise, own in zip(evidence.residual_models, evidence.noises, own_effects, strict=True):
        repaired = repaired_for(diagnosis, vehicle, own)
        vehicles = [vehicle, repaired] if effects else [vehicle]
        residuals = [_residual(residual_model, with_effect_terms(one, effects)) for one in vehicles]
        p_world = residual_model.recording.p_world
        found.append(
            Mismatch(
                name=residual_model.recording.name,
                t=residual_model.t,
                p_world=None if p_world is None else p_world[residual_model.filter.rows],
                channels=residual_model.channels,
                noise=noise,
                before=residuals[0],
                after=residuals[1] if effects else None,
            )
        )
    return tuple(found)


def repaired_for(diagnosis, vehicle: Vehicle, own) -> Vehicle:
    """Return the vehicle of one recording: with the effects of all recordings and those of this one.

    The vehicle of a diagnosis of several recordings has the mean of effects that differ between them.
    """
    if not diagnosis.own_effects:
        return diagnosis.vehicle
    per_flight = {one.effect.key for effects in diagnosis.own_effects for one in effects}
    selected = [*(one for one in diagnosis.selected if one.effect.key not in per_flight), *own]
    return with_effects(vehicle, [one.effect for one in selected], {one.effect.key: one.values for one in selected})


def _residual(residual_model: ResidualModel, vehicle: Vehicle) -> np.ndarray:
    """Return the residuals (m, c), NaN where nothing was measured or the data are rejected."""
    return np.where(residual_model.good[:, None] & residual_model.measured, residual_model.residual(vehicle), np.nan)


def _largest(values) -> np.ndarray:
    """Return the largest finite value (m,) of each row of values (m, c), NaN if there is none."""
    filled = np.where(np.isfinite(values), values, -np.inf).max(axis=1)
    return np.where(np.isfinite(filled), filled, np.nan)


def _averaged(values, t) -> np.ndarray:
    """Return values (m, c) averaged over AVERAGING_S around each time, without those that are not finite."""
    half = max(1, round(0.5 * AVERAGING_S / (t[1] - t[0])))
    finite = np.isfinite(values)
    sums = (
        np.cumsum(np.pad(part, ((half + 1, half), (0, 0))), axis=0) for part in (np.where(finite, values, 0.0), finite)
    )
    total, count = (part[2 * half + 1 :] - part[: -2 * half - 1] for part in sums)
    return np.where(finite, total / np.maximum(count, 1), np.nan)
