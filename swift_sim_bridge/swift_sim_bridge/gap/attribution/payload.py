"""A load that is fixed to the vehicle: it changes mass, inertia and centre of mass together, with four parameters.

A load of zero mass has no sensitivity to its position. Its parts are therefore selected first, as effects of their own.
They give the initial values of the load, which replaces them if it explains the recordings better.
"""

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.attribution.gauss_newton import (
    gauss_newton_fit,
    normal_equations_at,
    residuals_at,
    selection_problem_at,
    with_effects,
)
from swift_sim_bridge.gap.attribution.model_comparison import (
    PARAMETER_PENALTY,
    channel_squares,
    is_physical,
    penalised_squares,
)
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps
from swift_sim_bridge.physics.terms.airframe import REACH_M

PARTS = ("mass", "com_offset", "inertia")  # effects that a load consists of
REPLACED = (*PARTS, "thrust_coefficient")  # effects that may stand for a load; less thrust is similar to more mass
REPLACED_WITHOUT_ROTOR_SPEEDS = (*REPLACED, "rotor_gain", "motor_map")  # slower rotors, too, lift less
SLOWER, WEIGHT = ("rotor_gain", "motor_map"), ("mass", "com_offset")  # the former may stand for the latter
MAX_MORE_SQUARES = 6.0  # that these may leave: nothing beyond the noise of a few samples
MIRRORED = np.array([1.0, 1.0, 1.0, -1.0])  # above for below: the inertia is nearly the same, and a fit may end there
MAX_INERTIA_BIAS_SHARE = 0.05  # of the inertia; a larger bias of the pipeline leaves the position of a load unknown
MIN_IMPROVEMENT = 14.0  # squares, penalties included, by which the load must be better; larger keeps its parts longer


def select_payload(
    evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, progress
) -> tuple[Evidence, list[str], dict]:
    """Replace parts of a load among the selected effects by the load, if it explains the recordings better.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        keys: the selected effects.
        values: their values, by key.
        progress: called with a line of text.

    Returns:
        The evidence with this effect, the selected effects and their values; the arguments if there is no load.
    """
    driven = all(one.recording.driven for one in evidence.residual_models)
    if driven:
        keys, values = _with_weight(evidence, vehicle, keys, values, progress)
    parts = [key for key in keys if key in (REPLACED_WITHOUT_ROTOR_SPEEDS if driven else REPLACED)]
    known = {effect.key: effect for effect in evidence.effects}
    if not evidence.search_payload or len(parts) < 2 or not set(PARTS) <= set(known) or _has_payload(vehicle):
        return evidence, keys, values
    if not _inertia_known(evidence, with_effects(vehicle, [known[key] for key in keys], values), known["inertia"]):
        return evidence, keys, values
    others = [key for key in keys if key not in parts]
    initial = _initial_load(evidence, vehicle, known, others, values)
    if initial is None:
        return evidence, keys, values
    effect = catalogue.payload(initial[1:])
    wider = evidence.with_effect(effect, sum(evidence.null_distribution.null_gains(key) for key in PARTS))
    effects, all_keys = [*(known[key] for key in others), effect], [*others, effect.key]
    starts = initial, initial * MIRRORED
    fits = [gauss_newton_fit(wider, vehicle, effects, {**values, effect.key: start})[0] for start in starts]
    after, fitted = min(
        ((penalised_squares(wider, vehicle, effects, fit), fit) for fit in fits), key=lambda pair: pair[0]
    )
    if not is_physical(wider, effect, fitted):
        return evidence, keys, values
    before = penalised_squares(evidence, vehicle, [known[key] for key in keys], values)
    if before - after < MIN_IMPROVEMENT:
        return evidence, keys, values
    problem = selection_problem_at(wider, vehicle, {**known, effect.key: effect}, all_keys, fitted)
    kept = stepwise.backward_elimination(problem, all_keys)
    if effect.key not in kept:
        return evidence, keys, values
    progress(f"{effect.key} replaces {', '.join(key for key in keys if key not in kept)}")
    remaining = [one for one in effects if one.key in kept]
    if len(remaining) < len(effects):
        fitted = gauss_newton_fit(wider, vehicle, remaining, fitted)[0]
    return wider, kept, fitted


def _with_weight(
    evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, progress
) -> tuple[list[str], dict]:
    """Return the effects with mass and centre of mass in place of slower rotors, where these explain as much.

    Where the rotors were not measured, four slower ones lift less, and unequally. So does a heavier vehicle with
    another centre of mass, and one cause is likelier than four. In a hover, another motor map does the same.

    Args:
        evidence: the evidence.
        vehicle: the vehicle with the terms of all effects.
        keys: the selected effects.
        values: their values, by key.
        progress: called with a line of text.
    """
    known = {effect.key: effect for effect in evidence.effects}
    slower = [key for key in keys if key in SLOWER]
    if not slower or not set(WEIGHT) <= set(known):
        return keys, values
    instead = [*(key for key in keys if key not in (*SLOWER, *WEIGHT)), *WEIGHT]
    before, after = ([known[key] for key in each] for each in (keys, instead))
    fitted, _ = gauss_newton_fit(evidence, vehicle, after, {key: values[key] for key in instead if key in values})
    vehicles = (with_effects(vehicle, *each) for each in ((before, values), (after, fitted)))
    left, now = (channel_squares(evidence, residuals_at(evidence, one)) for one in vehicles)
    samples = sum(np.sum(one.measured & one.good[:, None], axis=0) for one in evidence.residual_models)
    noise = np.maximum(left / np.maximum(samples, 1), 1.0)  # noise of commands is most of what some moments leave
    fewer = sum(len(one.parameters) for one in before) - sum(len(one.parameters) for one in after)
    more = np.sum((now - left) / noise) - PARAMETER_PENALTY * fewer
    if more > MAX_MORE_SQUARES or not all(is_physical(evidence, one, fitted) for one in after):
        return keys, values
    progress(f"{', '.join(WEIGHT)} in place of {', '.join(slower)}")
    return instead, fitted


def _has_payload(vehicle: Vehicle) -> bool:
    """Return whether the vehicle file has a load already; a second one is reported as its parts."""
    return bool(vehicle.terms.get("payload", {}).get("mass"))


def _inertia_known(evidence: Evidence, vehicle: Vehicle, inertia: Effect) -> bool:
    """Return whether the recordings determine the inertia, and with it the position of a load.

    In a hover the noise of the rotor speeds alone resembles a larger inertia, the more so the less the vehicle rotates.

    Args:
        evidence: the evidence.
        vehicle: with the selected effects, so that a wrong centre of mass does not count as motion.
        inertia: the effect of a wrong inertia.
    """
    null = evidence.null_distribution
    rows, equations = null.slices[inertia.key], normal_equations_at(evidence, vehicle, (inertia,), central=False)
    information = np.maximum(equations.parameter_information, 1e-300)
    bias = np.abs(null.bias[rows]) * null.information[rows] / information * parameter_steps((inertia,))
    return bool(np.all(bias < MAX_INERTIA_BIAS_SHARE * file_values(inertia, vehicle)))


def _initial_load(
    evidence: Evidence, vehicle: Vehicle, known: dict[str, Effect], others: list[str], values: dict
) -> np.ndarray | None:
    """Return mass kg and position (3,) m of the load that mass and centre of mass call for; None if none is added."""
    effects = [known[key] for key in (*others, "mass", "com_offset")]
    fitted, _ = gauss_newton_fit(evidence, vehicle, effects, values)
    mass, offset = float(fitted["mass"][0]), fitted["com_offset"] - file_values(known["com_offset"], vehicle)
    if mass <= vehicle.mass:
        return None
    load = mass - vehicle.mass
    return np.array([load, *np.clip(offset * mass / load, -REACH_M, REACH_M)])
