"""Numbers of the vehicle file that are wrong by a large factor.

Far from the file's value, first-order sensitivities to a motor's lag point nowhere; and a vehicle with thirty times its
drag, lag or resistance cannot fly the recorded path as a reference. Before the search, each such number is therefore
tried on a log scale with the whole simulation of the recording. Where another value leaves far less of the residuals,
reference flights and search start there, with the effect selected; the search may withdraw it like any other.
"""

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference.sensitivity import CHANGES, with_effect_terms
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.variants import Variants

SCALED = {  # effects of which the first so many parameters may be wrong by a factor, all by the same
    "motor_time_constant": 1,
    "battery_sag": 1,
    "rotor_drag": 1,
    "linear_drag": 3,
    "body_drag": 3,
}
ABOVE_AND_BELOW = ("motor_time_constant",)  # the others act linearly: values too small are found without a start
FACTORS = np.geomspace(1.0, 50.0, 16)  # neighbours are a factor of 1.3 apart
MIN_FACTOR = 2.0  # closer to the file, the search finds the value by itself
MAX_RMS_SHARE = 0.6  # that a start may leave of the residuals it changes, as a geometric mean over their channels


def far_start(
    residual_models: list[ResidualModel], vehicle: Vehicle, effects: tuple[Effect, ...], progress
) -> dict[str, np.ndarray]:
    """Return the effects whose numbers are wrong by a large factor, with values near the true ones, by key.

    Args:
        residual_models: the recordings.
        vehicle: the vehicle as its file describes it.
        effects: effects of the search.
        progress: called with a line of text.
    """
    candidates, found = [effect for effect in effects if effect.id in SCALED], {}
    while candidates:
        tried = [(*_best_factor(residual_models, vehicle, effect), effect) for effect in candidates]
        share, factor, effect = min(tried, key=lambda one: one[0])
        if share > MAX_RMS_SHARE:
            break
        found[effect.key] = _scaled(effect, vehicle, factor)
        progress(f"{effect.key}: {factor:.2g} times the file's value leaves {share:.0%} of the residuals it changes")
        vehicle = inject(vehicle, effect, found[effect.key])
        candidates.remove(effect)
    return found


def _scaled(effect: Effect, vehicle: Vehicle, factor: float) -> np.ndarray:
    """Return the effect's values (k,) with those of SCALED multiplied by a factor."""
    values = file_values(effect, vehicle)
    values[: SCALED[effect.id]] *= factor
    return values


def _best_factor(residual_models: list[ResidualModel], vehicle: Vehicle, effect: Effect) -> tuple[float, float]:
    """Return the share of the residuals that the best factor leaves, and that factor; 1 and 1 without a far one."""
    if not np.any(file_values(effect, vehicle)[: SCALED[effect.id]]):
        return 1.0, 1.0
    factors = np.concatenate([1.0 / FACTORS, FACTORS[1:] if effect.id in ABOVE_AND_BELOW else []])
    vehicle = with_effect_terms(vehicle, (effect,))
    moved = tuple(inject(vehicle, effect, _scaled(effect, vehicle, factor)) for factor in factors)
    variants = Variants(moved, ("", *[CHANGES.get(effect.layer, "motion")] * (len(moved) - 1)))
    logs = sum(_log_rms(one, variants) for one in residual_models)
    factor = float(factors[np.argmin(logs)])
    if not MIN_FACTOR < max(factor, 1.0 / factor) < 0.99 * FACTORS[-1]:  # near the file, or beyond the scale
        return 1.0, 1.0
    return float(np.exp((logs.min() - logs[0]) / len(residual_models))), factor


def _log_rms(residual_model: ResidualModel, variants: Variants) -> np.ndarray:
    """Return the mean logarithm (b,) of the RMS of the residuals that the variants change."""
    residual = residual_model.residuals(variants)[:, residual_model.good]
    residual = residual[..., np.any(residual != residual[:1], axis=(0, 1))]
    if not residual.size:
        return np.zeros(len(residual))
    return np.log(np.sqrt(np.mean(np.square(residual), axis=1)) + 1e-12).mean(axis=-1)
