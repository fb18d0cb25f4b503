"""Air that moves, which has no footprint of its own: draughts have a place, gusts come by chance. By the wind's."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import gauss_newton_fit, selection_problem_at, with_effects
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import gust_correlation, local_wind_search, stepwise
from swift_sim_bridge.gap.inference.sensitivity import Linearisation, linearise, perturbed_variants
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

WIND_STEP = 0.05  # m/s, the step of the wind's footprints
MOMENT_S = 0.2  # over which the scatter of twins is averaged


def local_sigma(lines: list[Linearisation], sigma, t) -> np.ndarray:
    """Return the deviation (n, c) of residuals at times t (n,): sigma (c,), and more by as much as the twin that
    scatters most about then does so more than at most times, as in its rotors' own wake."""
    moment = max(1, round(MOMENT_S / (t[1] - t[0])))
    squares = [np.stack([np.interp(t, line.t, column) for column in np.square(line.residual).T]) for line in lines]
    most = np.max([uniform_filter1d(one, moment, axis=1) for one in squares], axis=0).T
    return sigma * np.sqrt(np.maximum(most / np.maximum(np.median(most, axis=0), 1e-300), 1.0))


def reference_statistics(twin: ResidualModel, line, wind: slice, sigma, rough) -> tuple[float, float]:
    """Return by how much a draught anywhere lowers a twin's squares, and how far its winds agree; rough: see
    `scatter`."""
    columns = line.sensitivity[wind] / WIND_STEP
    place = local_wind_search.search(line, columns, twin.recording.p_world[twin.filter.rows], rough)
    return place.gain, gust_correlation.agreement(line, columns, sigma).deviations


def minimum_detectable(residual_model: ResidualModel, line: Linearisation, wind: slice, sigma, rough) -> dict:
    """Return the smallest draught and gusts that a recording can show, as `minimum_detectable` has it; rough: see
    `scatter`."""
    columns = line.sensitivity[wind] / WIND_STEP
    least = local_wind_search.detectable(
        line, columns, residual_model.recording.p_world[residual_model.filter.rows], rough, local_wind_search.LEAST_GAIN
    )
    seen = gust_correlation.agreement(line, columns, sigma)
    found = {"local_draught": {f"velocity[{i}]": least for i in range(3)}}
    if seen.pairs:
        found["gust"] = {
            "wind_20ft": gust_correlation.wind_of(gust_correlation.LEAST_DEVIATIONS * seen.by_chance, seen.pairs)[0]
        }
    return found


def with_draught(evidence: Evidence, vehicle: Vehicle, keys, values, tell):
    """Return the evidence with a draught among its effects, and the names with it, where one place's air explains what
    is left; else all three as they are."""
    if evidence.local_wind_gains is None or len(evidence.residual_models) > 1:
        return evidence, keys, values
    known, (residual_model,) = {one.key: one for one in evidence.effects}, evidence.residual_models
    line, wind = wind_left(evidence, with_effects(vehicle, [known[key] for key in keys], values))
    place = local_wind_search.search(
        line, wind, residual_model.recording.p_world[residual_model.filter.rows], evidence.local_sigma
    )
    if place.gain < max(
        local_wind_search.LEAST_GAIN, local_wind_search.REFERENCE_MARGIN * evidence.local_wind_gains.max()
    ):
        return evidence, keys, values
    effect = catalogue.draught(place.center, place.radius)
    tell(f"{effect.key}: around {np.round(place.center, 1)}")
    wider = evidence.widened(effect, evidence.local_wind_gains)
    known[effect.key] = effect
    begun = np.concatenate([place.velocity, file_values(effect, vehicle)[3:]])
    both = [*keys, effect.key]
    fitted, _ = gauss_newton_fit(wider, vehicle, [known[key] for key in both], {**values, effect.key: begun})
    if not model_comparison.possible(wider, effect, fitted):  # it ran away: something pushes there, but no such air
        return evidence, keys, values
    keys, values = both, fitted
    scene = selection_problem_at(wider, vehicle, known, keys, values)
    kept = stepwise.backward(scene, keys)
    values, _ = gauss_newton_fit(wider, vehicle, [known[key] for key in kept], {key: values[key] for key in kept})
    return wider, kept, values


def find_gusts(evidence: Evidence, vehicle: Vehicle, found: SearchResult) -> SelectedEffect | None:
    """Return the gusts that remain beside all that was found, if any do."""
    if not np.isfinite(evidence.reference_gust_significance) or len(evidence.residual_models) > 1:
        return None
    values = {one.effect.key: one.values for one in found.selected}
    line, wind = wind_left(evidence, with_effects(vehicle, [one.effect for one in found.selected], values))
    whole = gust_correlation.agreement(line, wind, evidence.sigmas[0]).deviations
    line = equation_search.without(
        found.evidence.library, 0, line, found.equation_terms, evidence.residual_models[0].channels
    )
    seen = gust_correlation.agreement(line, wind, evidence.sigmas[0])
    least = max(
        gust_correlation.LEAST_DEVIATIONS,
        gust_correlation.REFERENCE_MARGIN * evidence.reference_gust_significance,
        gust_correlation.KEPT * whole,
    )
    if seen.deviations < least:
        return None
    value, error = gust_correlation.wind_of(seen.product, seen.pairs)
    return SelectedEffect(catalogue.gusts(), np.array([value]), np.array([[error**2]]), seen.deviations)


def wind_left(evidence: Evidence, vehicle: Vehicle):
    """Return the residual of the first recording, and what a wind of 1 m/s does to it (3, m, c)."""
    wind = next(effect for effect in evidence.effects if effect.key == "wind")
    line = linearise(evidence.residual_models[0], perturbed_variants(vehicle, (wind,)))
    return line, line.sensitivity / WIND_STEP
