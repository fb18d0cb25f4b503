"""Local winds and gusts: effects without a sensitivity of their own, found by the sensitivity to a uniform wind."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import (
    gauss_newton_fit,
    residuals_at,
    selection_problem_at,
    with_effects,
)
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.discovery.polynomial_search import Found, equation_effects
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import gust_correlation, local_wind_search, stepwise
from swift_sim_bridge.gap.inference.sensitivity import Linearisation, linearise, perturbed_variants
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.physics.terms.equation import AT_ROTORS

WIND_STEP = 0.05  # m/s, step of the effect `wind`, to which the sensitivities refer
FEWER_NUMBERS = 2  # of a gain of thrust, which has one, than of a draught's velocity
AVERAGING_S = 0.2  # over which the scatter of reference flights is averaged; longer hides short passages of the wake


def local_sigma(lines: list[Linearisation], sigma, t) -> np.ndarray:
    """Return the standard deviation (n, c) of residuals at times t (n,) s.

    It is sigma (c,), increased where reference flights scatter more than usual, as in the wake of their own rotors: by
    the ratio of the largest mean square of any of them around that time to its median over time.
    """
    window = max(1, round(AVERAGING_S / (t[1] - t[0])))
    squares = [np.stack([np.interp(t, line.t, column) for column in np.square(line.residual).T]) for line in lines]
    largest = np.max([uniform_filter1d(one, window, axis=1) for one in squares], axis=0).T
    return sigma * np.sqrt(np.maximum(largest / np.maximum(np.median(largest, axis=0), 1e-300), 1.0))


def reference_statistics(
    residual_model: ResidualModel, line: Linearisation, wind: slice, sigma, local_sigma
) -> tuple[float, float]:
    """Return the gain of the best local wind and the significance of gusts in a reference flight.

    Args:
        residual_model: the reference flight.
        line: its linearisation.
        wind: positions of the parameters of the effect `wind`.
        sigma: (c,) standard deviation of the residuals.
        local_sigma: (m, c) the same over time.
    """
    per_m_s = line.sensitivity[wind] / WIND_STEP
    place = local_wind_search.find_local_wind(line, per_m_s, _positions(residual_model), local_sigma)
    return place.gain, gust_correlation.wind_correlation(line, per_m_s, sigma).significance


def minimum_detectable(
    residual_model: ResidualModel, line: Linearisation, wind: slice, sigma, local_sigma
) -> dict[str, dict[str, float]]:
    """Return the minimum detectable local wind and gusts, by effect id and parameter name.

    For the arguments see `reference_statistics`.
    """
    per_m_s = line.sensitivity[wind] / WIND_STEP
    local = local_wind_search.minimum_detectable_wind(
        line, per_m_s, _positions(residual_model), local_sigma, local_wind_search.MIN_GAIN
    )
    correlation = gust_correlation.wind_correlation(line, per_m_s, sigma)
    found = {"local_draught": {f"velocity[{i}]": local for i in range(3)}}
    if correlation.pairs:
        covariance = gust_correlation.MIN_SIGNIFICANCE * correlation.standard_error
        found["gust"] = {"wind_20ft": gust_correlation.gust_strength(covariance, correlation.pairs)[0]}
    return found


def select_local_wind(
    evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, progress
) -> tuple[Evidence, list[str], dict]:
    """Add a local wind to the selected effects if it explains what they leave.

    Args:
        evidence: the evidence.
        vehicle: the vehicle without effects.
        keys: the selected effects.
        values: their values, by key.
        progress: called with a line of text.

    Returns:
        The evidence with this effect, the selected effects and their values; the arguments if there is no local wind.
    """
    if evidence.local_wind_gains is None or len(evidence.residual_models) > 1:
        return evidence, keys, values
    known, (residual_model,) = {effect.key: effect for effect in evidence.effects}, evidence.residual_models
    line, per_m_s = _wind_sensitivity(evidence, with_effects(vehicle, [known[key] for key in keys], values))
    place = local_wind_search.find_local_wind(line, per_m_s, _positions(residual_model), evidence.local_sigma)
    if place.gain < max(
        local_wind_search.MIN_GAIN, local_wind_search.REFERENCE_MARGIN * evidence.local_wind_gains.max()
    ):
        return evidence, keys, values
    effect = catalogue.draught(place.center, place.radius)
    progress(f"{effect.key}: around {np.round(place.center, 1)}")
    wider = evidence.with_effect(effect, evidence.local_wind_gains)
    known[effect.key] = effect
    initial = np.concatenate([place.velocity, file_values(effect, vehicle)[3:]])
    all_keys = [*keys, effect.key]
    all_values, _ = gauss_newton_fit(wider, vehicle, [known[key] for key in all_keys], {**values, effect.key: initial})
    if not model_comparison.is_physical(wider, effect, all_values):  # the force there is not that of a local wind
        return evidence, keys, values
    kept = stepwise.backward_elimination(selection_problem_at(wider, vehicle, known, all_keys, all_values), all_keys)
    values, _ = gauss_newton_fit(wider, vehicle, [known[key] for key in kept], {key: all_values[key] for key in kept})
    return wider, kept, values


def find_gusts(evidence: Evidence, vehicle: Vehicle, found: SearchResult) -> SelectedEffect | None:
    """Return the gusts that remain beside the result of a search, None if there are none or wind is not testable."""
    if not np.isfinite(evidence.reference_gust_significance) or len(evidence.residual_models) > 1:
        return None
    values = {one.effect.key: one.values for one in found.selected}
    repaired = with_effects(vehicle, [one.effect for one in found.selected], values)
    line, per_m_s = _wind_sensitivity(evidence, repaired)
    total = gust_correlation.wind_correlation(line, per_m_s, evidence.sigmas[0]).significance
    line = equation_search.subtract_terms(
        found.evidence.library, 0, line, found.equation_terms, evidence.residual_models[0].channels
    )
    remaining = gust_correlation.wind_correlation(line, per_m_s, evidence.sigmas[0])
    threshold = max(
        gust_correlation.MIN_SIGNIFICANCE,
        gust_correlation.REFERENCE_MARGIN * evidence.reference_gust_significance,
        gust_correlation.MIN_REMAINING_SHARE * total,
    )
    if remaining.significance < threshold:
        return None
    value, error = gust_correlation.gust_strength(remaining.covariance, remaining.pairs)
    return SelectedEffect(catalogue.gusts(), np.array([value]), np.array([[error**2]]), remaining.significance)


def gusts_are_certain(gusts: SelectedEffect, found: SearchResult) -> bool:
    """Return whether nothing beside gusts can look like them: an unknown force, or the error of another effect."""
    if found.equation_terms or found.unexplained:
        return False
    return not found.selected or gusts.significance >= gust_correlation.CERTAIN_SIGNIFICANCE


def may_be_thrust(evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict) -> bool:
    """Return whether a gain of the rotors' thrust at the place of a local draught explains as much as the draught.

    So does the ground effect of a raised pad, which no effect names.

    Args:
        evidence: the evidence.
        vehicle: the vehicle without effects.
        effects: the selected effects, the draught one of them.
        values: their values, by key.
    """
    draught = next(one for one in effects if one.id == "local_draught")
    at = dict(zip((parameter.name for parameter in draught.parameters), values[draught.key], strict=True))
    place = ",".join(f"{at[name]:.3f}" for name in ("center[0]", "center[1]", "center[2]", "radius"))
    gain = Found(AT_ROTORS, f"near({place}) thrust", (0.0, vehicle.mass * GRAVITY), 0.0)
    rivals = [*(one for one in effects if one is not draught), *equation_effects(vehicle, [gain])]
    fitted, _ = gauss_newton_fit(evidence, vehicle, rivals, {one.key: values[one.key] for one in rivals[:-1]})
    left = [
        model_comparison.normalised_squares(evidence, residuals_at(evidence, with_effects(vehicle, *one)))
        for one in ((rivals, fitted), (effects, values))
    ]
    return left[0] < left[1] + FEWER_NUMBERS * model_comparison.PARAMETER_PENALTY + model_comparison.MAX_DEFICIT


def _wind_sensitivity(evidence: Evidence, vehicle: Vehicle) -> tuple[Linearisation, np.ndarray]:
    """Return the residuals of the first recording, and their change (3, m, c) per 1 m/s of wind."""
    wind = next(effect for effect in evidence.effects if effect.key == "wind")
    line = linearise(evidence.residual_models[0], perturbed_variants(vehicle, (wind,)))
    return line, line.sensitivity / WIND_STEP


def _positions(residual_model: ResidualModel) -> np.ndarray:
    """Return the positions (m, 3) m at the times of the residuals."""
    return residual_model.recording.p_world[residual_model.filter.rows]
