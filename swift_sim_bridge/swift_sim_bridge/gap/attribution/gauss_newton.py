"""Joint estimation of effects: Gauss-Newton iterations through the simulator's own physics."""

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

MAX_BIAS_RANGE_SHARE = 0.1  # of a parameter's range; a larger bias of the pipeline makes the parameter unobservable
CONVERGED_ERRORS = 0.1  # standard errors; the iteration ends when every step is shorter
MAX_ITERATIONS = 12  # a fit that has not converged by then ends with the last accepted values
DAMPING_FACTOR = 10.0  # by which the damping grows after a step that raised the squares, and shrinks after a good one
MIN_DAMPING = 0.01  # first damping after a step that raised the squares, as share of each parameter's information


def normal_equations_at(
    evidence: Evidence, vehicle: Vehicle, effects: tuple[Effect, ...], share: float = 1.0, central: bool = True
) -> NormalEquations:
    """Return the normal equations of all recordings, linearised about a vehicle.

    Args:
        evidence: the recordings.
        vehicle: the vehicle to linearise about.
        effects: effects whose parameters are perturbed.
        share: share of each recording's samples that is used, in whole seconds from its start.
        central: whether to use central differences, see `sensitivity.perturbed_variants`.
    """
    found = []
    lines = evidence.cache.linearisations(evidence.residual_models, vehicle, effects, central)
    for line, sigma in zip(lines, evidence.sigmas, strict=True):
        equations, end = accumulate(line, sigma), None
        if share < 1:
            end = np.searchsorted(np.cumsum(equations.samples), share * equations.samples.sum(), "right")
        found.append(NormalEquations(*(values[:end] for values in vars(equations).values())))
    return concatenate(found)


def residuals_at(evidence: Evidence, vehicle: Vehicle) -> list[Linearisation]:
    """Return the residuals of each recording against a vehicle, without sensitivities."""
    variants = perturbed_variants(vehicle, ())
    return [linearise(residual_model, variants) for residual_model in evidence.residual_models]


def gauss_newton_fit(
    evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict, share: float = 1.0
) -> tuple[dict, dict]:
    """Return the joint estimate of effects.

    A step that raises the sum of squares is repeated with damping (Levenberg and Marquardt): parameters of little
    information, such as the radius of a local wind that is crossed once, then move least.

    Args:
        evidence: the recordings.
        vehicle: the vehicle without these effects.
        effects: the effects.
        values: initial values by key; effects without an entry start at the values of the vehicle.
        share: share of each recording that is used, from its start.

    Returns:
        Estimated values (k,) by key, and their covariances (k, k) by key.
    """
    slices, size = parameter_slices(tuple(effects)), parameter_steps(tuple(effects))
    low, high = (
        np.array([getattr(p, side) for effect in effects for p in effect.parameters]) for side in ("low", "high")
    )

    def by_key(vector) -> dict:
        return {effect.key: vector[slices[effect.key]] for effect in effects}

    nominal = np.concatenate([file_values(effect, vehicle) for effect in effects])
    candidate = np.concatenate([values.get(effect.key, file_values(effect, vehicle)) for effect in effects])
    smallest, damping = np.inf, 0.0
    for _ in range(MAX_ITERATIONS):
        equations = normal_equations_at(
            evidence, with_effects(vehicle, effects, by_key(candidate)), tuple(effects), share
        )
        if equations.squares.sum() <= smallest:
            kept = _identifiable(evidence, effects, equations, (low - nominal) / size, (high - nominal) / size)
            accepted, restricted = candidate, stepwise.restricted_to(equations, kept)
            smallest = equations.squares.sum()
            found, damping = stepwise.fit(restricted, np.arange(len(size))), damping / DAMPING_FACTOR
        else:
            damping = max(DAMPING_FACTOR * damping, MIN_DAMPING)
        step = stepwise.bounded_step(restricted, damping, (low - accepted) / size, (high - accepted) / size)
        candidate = accepted + step * size
        if np.all(np.abs(step) <= CONVERGED_ERRORS * np.sqrt(np.diag(found.covariance))):
            accepted = candidate
            break
    covariance = limited_to_range(found.covariance * np.outer(size, size), high - low)
    covariance[~kept, ~kept] = (high - low)[~kept] ** 2 / 12.0
    return by_key(accepted), {effect.key: covariance[slices[effect.key], slices[effect.key]] for effect in effects}


def _identifiable(evidence: Evidence, effects, equations: NormalEquations, low, high) -> np.ndarray:
    """Return which parameters (p,) are observable and not dominated by the bias of the pipeline.

    In a hover, for example, the noise of a gyro is correlated with the rates in the same way as a scale error.

    Args:
        evidence: the evidence.
        effects: the effects.
        equations: normal equations of their parameters.
        low, high: (p,) range of each parameter's change, in steps.
    """
    seconds, bias = np.count_nonzero(equations.samples), np.zeros(len(low))
    known = evidence.null_distribution
    for key, rows in parameter_slices(tuple(effects)).items():
        if key in known.slices:  # effects outside the linear search have no null distribution
            bias[rows] = np.abs(known.bias_gradient[known.slices[key]]) * seconds
    reach = np.maximum(np.abs(low), np.abs(high))
    with np.errstate(invalid="ignore"):
        biased = bias > MAX_BIAS_RANGE_SHARE * reach * equations.parameter_information
    return stepwise.observable(equations, low, high) & ~biased


def limited_to_range(covariance, reach) -> np.ndarray:
    """Return a covariance (p, p) combined with the prior that each parameter lies in its physical range.

    A local wind that is crossed once, for example, may be near and weak or far and strong, but not arbitrarily strong.

    Args:
        covariance: (p, p) of the parameters.
        reach: (p,) widths of the ranges, infinite for parameters without bounds.
    """
    known = np.flatnonzero(np.isfinite(reach))
    total = covariance[np.ix_(known, known)] + np.diag(reach[known] ** 2 / 12.0)
    return covariance - covariance[:, known] @ np.linalg.solve(total, covariance[known])


def with_effects(vehicle: Vehicle, effects: list[Effect], values: dict) -> Vehicle:
    """Return the vehicle with the effects at these values, by key."""
    for effect in effects:
        vehicle = inject(vehicle, effect, values[effect.key])
    return vehicle


def selection_problem_at(evidence: Evidence, vehicle: Vehicle, effects, keys, values) -> stepwise.SelectionProblem:
    """Return the selection problem, linearised about the vehicle with the effects that are selected so far.

    The selected effects are then removed again to first order, so that the selection can compare with and without them.
    One-sided differences are used, as for the reference flights: their error is then the same.

    Args:
        evidence: the recordings.
        vehicle: the vehicle without effects.
        effects: all effects, by key.
        keys: the selected effects.
        values: their values, by key.
    """
    repaired = with_effects(vehicle, [effects[key] for key in keys], values)
    all_effects = tuple(effects.values())
    equations = normal_equations_at(evidence, repaired, all_effects, central=False)
    slices, size = parameter_slices(all_effects), parameter_steps(all_effects)
    for key in keys:
        rows = np.arange(slices[key].start, slices[key].stop)
        change = (values[key] - file_values(effects[key], vehicle)) / size[rows]
        equations = stepwise.without_parameters(equations, rows, change)
    nominal = np.concatenate([file_values(effect, vehicle) for effect in all_effects])
    parameters = [p for effect in all_effects for p in effect.parameters]
    low = (np.array([p.first_order_low(value) for p, value in zip(parameters, nominal, strict=True)]) - nominal) / size
    high = (np.array([p.high for p in parameters]) - nominal) / size
    kept = _identifiable(evidence, all_effects, equations, low, high)
    corrected = null_distribution.subtract_bias(equations, evidence.null_distribution.bias_gradient)
    return stepwise.SelectionProblem(
        equations=stepwise.restricted_to(corrected, kept),
        slices=slices,
        null_distribution=evidence.null_distribution,
        uncorrected=stepwise.restricted_to(equations, kept),
        low=low,
        high=high,
    )
