"""A load fixed to the vehicle: heavier, turned harder, balanced elsewhere, all at once and by four numbers.

It has no footprint where there is none of it, as its place says nothing without its mass. So its parts are told first,
each by its own name; they give a start for the load, which takes their place where it leaves fewer squares than they.
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
from swift_sim_bridge.gap.attribution.model_comparison import PER_NAME, PER_PARAMETER, possible, squares
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps

PARTS = ("mass", "com_offset", "inertia")
STANDS_FOR = (*PARTS, "thrust_coefficient")  # weaker rotors lift as if it were heavier, and turn it as if inert
MADE_AT_MOST = 0.05  # of an inertia, that the pipeline may make by itself where a load is told
CLEARLY = 14.0  # squares by which one name must be better than those of its parts


def with_payload(evidence: Evidence, vehicle: Vehicle, keys: list[str], values: dict, tell):
    """Return the evidence with a load among its effects, and the names with it in the place of its parts, where it is
    worth more than they; else all three as they are. vehicle: with all effects' terms."""
    parts = [key for key in keys if key in STANDS_FOR]
    known = {one.key: one for one in evidence.effects}
    if not evidence.search_payload or len(parts) < 2 or not set(PARTS) <= set(known) or _loaded(vehicle):
        return evidence, keys, values
    if not _turned(evidence, with_effects(vehicle, [known[key] for key in keys], values), known["inertia"]):
        return evidence, keys, values
    others = [key for key in keys if key not in parts]
    begun = _start(evidence, vehicle, known, others, values)
    if begun is None:
        return evidence, keys, values
    effect = catalogue.payload(begun[1:])
    gains = sum(evidence.null_distribution.null_gains(key) for key in PARTS)
    wider = evidence.widened(effect, gains)
    both, names = [*(known[key] for key in others), effect], [*others, effect.key]
    fitted, _ = gauss_newton_fit(wider, vehicle, both, {**values, effect.key: begun})
    if not possible(wider, effect, fitted):
        return evidence, keys, values
    better = _worth(evidence, vehicle, [known[key] for key in keys], values) - _worth(wider, vehicle, both, fitted)
    if better < CLEARLY:
        return evidence, keys, values
    kept = stepwise.backward(selection_problem_at(wider, vehicle, {**known, effect.key: effect}, names, fitted), names)
    if effect.key not in kept:
        return evidence, keys, values
    tell(f"{effect.key} in the place of {', '.join(key for key in keys if key not in kept)}")
    left = [one for one in both if one.key in kept]
    return wider, kept, gauss_newton_fit(wider, vehicle, left, fitted)[0] if len(left) < len(both) else fitted


def _loaded(vehicle: Vehicle) -> bool:
    """Return whether the file has a load already: a second one beside it is told as its parts."""
    return bool(vehicle.terms.get("payload", {}).get("mass"))


def _turned(evidence: Evidence, vehicle: Vehicle, inertia: Effect) -> bool:
    """Return whether the flights tell how hard the vehicle is to turn, and so where a load is: in a hover the noise of
    the rotors' speeds alone looks like more inertia, the more so the less it turns. vehicle: with what was named, so
    that no balance that is off counts for motion."""
    rows, sums = (
        evidence.null_distribution.slices[inertia.key],
        normal_equations_at(evidence, vehicle, (inertia,), central=False),
    )
    told = np.maximum(np.einsum("spp->p", sums.matrix), 1e-300)
    made = (
        np.abs(evidence.null_distribution.bias[rows])
        * evidence.null_distribution.information[rows]
        / told
        * parameter_steps((inertia,))
    )
    return bool(np.all(made < MADE_AT_MOST * file_values(inertia, vehicle)))


def _start(
    evidence: Evidence, vehicle: Vehicle, known: dict[str, Effect], others: list[str], values: dict
) -> np.ndarray | None:
    """Return mass kg and place (3,) m of a load that weighs and leans as the flights do, None where they are lighter
    than the file."""
    heavier = [known[key] for key in (*others, "mass", "com_offset")]
    fitted, _ = gauss_newton_fit(evidence, vehicle, heavier, values)
    mass, leaning = float(fitted["mass"][0]), fitted["com_offset"] - file_values(known["com_offset"], vehicle)
    if mass <= vehicle.mass:
        return None
    load = mass - vehicle.mass
    return np.array([load, *np.clip(leaning * mass / load, -catalogue.REACH_M, catalogue.REACH_M)])


def _worth(evidence: Evidence, vehicle: Vehicle, named: list[Effect], values: dict) -> float:
    """Return the squares that names leave, and what they cost with all their numbers."""
    numbers = sum(len(effect.parameters) for effect in named)
    left = squares(evidence, residuals_at(evidence, with_effects(vehicle, named, values)))
    return left + PER_NAME * len(named) + PER_PARAMETER * numbers
