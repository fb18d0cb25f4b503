"""Sizes of effects together: Gauss and Newton's steps through `inject`, replay by replay."""

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference import null_distribution, stepwise
from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, accumulate, concatenate
from swift_sim_bridge.gap.inference.sensitivity import (
    Linearisation,
    linearise,
    parameter_slices,
    parameter_steps,
    perturbed_variants,
)

MADE_SHARE = 0.1  # of how far a parameter may be off, that the pipeline may make of it by itself
STEADY = 0.1  # of a standard error: the fit has settled
SETTLING = 12
DAMPED, LEAST_DAMPING = 10.0, 0.01  # times, after a step that overshot; share of what is known of each parameter


def normal_equations_at(
    evidence: Evidence, vehicle: Vehicle, effects: tuple[Effect, ...], share: float = 1.0, central: bool = True
) -> NormalEquations:
    """Return the sums of the whole seconds in the first `share` of all samples of each recording against a vehicle;
    central: see `variants_of`."""
    found = []
    lines = evidence.memory.lines(evidence.residual_models, vehicle, effects, central)
    for line, sigma in zip(lines, evidence.sigmas, strict=True):
        sums = accumulate(line, sigma)
        kept = np.searchsorted(np.cumsum(sums.samples), share * sums.samples.sum(), "right") if share < 1 else None
        found.append(NormalEquations(*(values[:kept] for values in vars(sums).values())))
    return concatenate(found)


def residuals_at(evidence: Evidence, vehicle: Vehicle) -> list[Linearisation]:
    """Return the recordings' residuals against a vehicle, without any footprint."""
    variants = perturbed_variants(vehicle, ())
    return [linearise(residual_model, variants) for residual_model in evidence.residual_models]


def gauss_newton_fit(evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict, share: float = 1.0):
    """Return values and covariances by key of these effects together, on the first `share` of each recording.

    A step that explains less than the one before is damped (Levenberg and Marquardt): what a flight hardly determines,
    as how wide a draught is through which it passes once, moves last.
    """
    own, size = parameter_slices(tuple(effects)), parameter_steps(tuple(effects))
    low, high = (
        np.array([getattr(p, side) for effect in effects for p in effect.parameters]) for side in ("low", "high")
    )

    def named(row) -> dict:
        return {effect.key: row[own[effect.key]] for effect in effects}

    begun = np.concatenate([file_values(effect, vehicle) for effect in effects])
    tried = np.concatenate([values.get(effect.key, file_values(effect, vehicle)) for effect in effects])
    least, damping = np.inf, 0.0
    for _ in range(SETTLING):
        sums = normal_equations_at(evidence, with_effects(vehicle, effects, named(tried)), tuple(effects), share)
        if sums.squares.sum() <= least:
            kept = _told(evidence, effects, sums, (low - begun) / size, (high - begun) / size)
            settled, known, least = tried, stepwise.restricted_to(sums, kept), sums.squares.sum()
            found, damping = stepwise.fit(known, np.arange(len(size))), damping / DAMPED
        else:
            damping = max(DAMPED * damping, LEAST_DAMPING)
        step = stepwise.step(known, damping, (low - settled) / size, (high - settled) / size)
        tried = settled + step * size
        if np.all(np.abs(step) <= STEADY * np.sqrt(np.diag(found.covariance))):
            settled = tried
            break
    covariance = within(found.covariance * np.outer(size, size), high - low)
    covariance[~kept, ~kept] = (high - low)[~kept] ** 2 / 12.0
    return named(settled), {effect.key: covariance[own[effect.key], own[effect.key]] for effect in effects}


def _told(evidence: Evidence, effects, sums: NormalEquations, low, high) -> np.ndarray:
    """Return of which parameters (p,) the recordings tell anything that the pipeline does not make of it by itself: in
    a hover a gyro's own noise goes by its rates as a scale would. low, high (p,): how far they may be off, in steps."""
    seconds, made = np.count_nonzero(sums.samples), np.zeros(len(low))
    for key, own in parameter_slices(tuple(effects)).items():
        if (
            key in evidence.null_distribution.slices
        ):  # what is sought at a place, or blows by chance, twins were not searched for
            made[own] = (
                np.abs(evidence.null_distribution.bias_gradient[evidence.null_distribution.slices[key]]) * seconds
            )
    reach = np.maximum(np.abs(low), np.abs(high))
    with np.errstate(invalid="ignore"):
        own_making = made > MADE_SHARE * reach * np.einsum("spp->p", sums.matrix)
    return stepwise.told(sums, low, high) & ~own_making


def within(covariance, reach) -> np.ndarray:
    """Return a covariance (p, p) with what is physical in it: a parameter lies somewhere in its reach (p,), infinite
    where nothing bounds it. A draught that is passed once may be near and weak or far and strong, not anything."""
    known = np.flatnonzero(np.isfinite(reach))
    both = covariance[np.ix_(known, known)] + np.diag(reach[known] ** 2 / 12.0)
    return covariance - covariance[:, known] @ np.linalg.solve(both, covariance[known])


def with_effects(vehicle: Vehicle, effects: list[Effect], values: dict) -> Vehicle:
    """Return the vehicle with these effects at their values."""
    for effect in effects:
        vehicle = inject(vehicle, effect, values[effect.key])
    return vehicle


def selection_problem_at(evidence: Evidence, vehicle: Vehicle, effects, keys, values) -> stepwise.SelectionProblem:
    """Return what the selection sees: footprints at the vehicle with what was taken in, and to first order what would
    be left without that."""
    flown = with_effects(vehicle, [effects[key] for key in keys], values)
    all_effects = tuple(effects.values())
    whole = normal_equations_at(
        evidence, flown, all_effects, central=False
    )  # as the twins' are: it helps choose, a fit measures
    own, size = parameter_slices(all_effects), parameter_steps(all_effects)
    for key in keys:
        rows = np.arange(own[key].start, own[key].stop)
        whole = stepwise.without(whole, rows, (values[key] - file_values(effects[key], vehicle)) / size[rows])
    begun = np.concatenate([file_values(one, vehicle) for one in all_effects])
    every = [p for one in all_effects for p in one.parameters]
    low = (np.array([p.first_order_low(at) for p, at in zip(every, begun, strict=True)]) - begun) / size
    high = (np.array([p.high for p in every]) - begun) / size
    kept = _told(evidence, all_effects, whole, low, high)
    whole, bare = (
        stepwise.restricted_to(one, kept)
        for one in (whole, null_distribution.subtract_bias(whole, evidence.null_distribution.bias_gradient))
    )
    return stepwise.SelectionProblem(bare, own, evidence.null_distribution, whole, low, high)
