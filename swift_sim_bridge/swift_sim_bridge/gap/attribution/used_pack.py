"""What a pack that was not full at the first row changes in the estimates, where no voltage was measured.

Motors that the recorded commands drive are supplied by the vehicle's own battery, full at the first row. Most
recordings begin after the take-off. The charge that was drawn before looks like less thrust, and so like a mass.
"""

import numpy as np
from scipy.special import chdtrc

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, Parameter
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.attribution.gauss_newton import normal_equations_at, with_effects
from swift_sim_bridge.gap.inference.marginal import Rival
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.sensitivity import parameter_slices, parameter_steps

MIN_PROBABILITY = 0.003  # of a change that differs as much from what a used pack explains: three standard errors
SECONDS_BEFORE = 5.0  # of a hover before the first row: take-off and the way to the place where a recording begins
LOWER_PACK = Effect(
    id="lower_pack",
    layer="motor",
    parameters=(Parameter("open_circuit_full", "V", ("battery", "open_circuit_full"), 0.05),),
    equation="",
    sentence="",
    manoeuvre="",
    channels=(),
)


def used_pack(
    evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict, covariance: dict
) -> dict[str, tuple[Rival, ...]]:
    """Return by key the explanation in which the pack was used before the first row: as likely as a full one.

    Args:
        evidence: the recordings.
        vehicle: the vehicle with the terms of all effects.
        effects: the selected effects.
        values: their values, by key.
        covariance: their covariances from the fit, by key.
    """
    if not any(one.recording.driven and one.recording.driven.voltage is None for one in evidence.residual_models):
        return {effect.key: () for effect in effects}
    equations = normal_equations_at(evidence, with_effects(vehicle, effects, values), (*effects, LOWER_PACK))
    *own, last = range(equations.gradient.shape[1])
    information, steps = equations.total_information, parameter_steps((*effects, LOWER_PACK))
    slope = -solve(information[np.ix_(own, own)], information[own, last]) * steps[own] / steps[last]
    shift = -_volts_lost_before(vehicle) * slope
    errors = {effect.key: np.sqrt(np.diag(covariance[effect.key])) for effect in effects}
    return {key: (Rival(1.0, shift[rows], errors[key]),) for key, rows in parameter_slices(tuple(effects)).items()}


def is_of_used_pack(change: np.ndarray, covariance: np.ndarray, lower_pack: tuple[Rival, ...]) -> bool:
    """Return whether a pack that was used for at most SECONDS_BEFORE explains an effect, and so its confounders.

    Args:
        change: (k,) of its parameters from the file's values, under a full pack.
        covariance: (k, k) of the change.
        lower_pack: the explanation in which the pack was used, if there is one.
    """
    for pack in lower_pack:
        along = solve(covariance, pack.shift)
        share = -(change @ along) / max(pack.shift @ along, 1e-300)  # of the charge of SECONDS_BEFORE
        remainder = change + min(share, 1.0) * pack.shift
        if share > 0.0 and chdtrc(len(change), remainder @ solve(covariance, remainder)) > MIN_PROBABILITY:
            return True
    return False


def _volts_lost_before(vehicle: Vehicle) -> float:
    """Return by how much the open-circuit voltage falls in SECONDS_BEFORE of a hover, V."""
    pack = vehicle.battery
    mechanical_w = len(vehicle.rotors) * vehicle.torque_coefficient * vehicle.hover_speed**3
    current = (mechanical_w / pack.efficiency + pack.avionics_w) / pack.reference_voltage
    return pack.open_circuit_slope * current * SECONDS_BEFORE / pack.capacity
