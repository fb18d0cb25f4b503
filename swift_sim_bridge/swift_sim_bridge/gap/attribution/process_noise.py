"""Random forces and moments of a recording beyond those of its reference flights."""

from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.attribution.gauss_newton import residuals_at, with_effects
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.inference import null_distribution
from swift_sim_bridge.gap.nominal import reference_flights
from swift_sim_bridge.gap.residuals.filters import apply

FLOOR = 0.02  # of a residual's variance, that its steps may differ by
MIN_EXCESS_SHARE = 0.3  # of the twins' variance, beyond which a recording's is no longer of its instruments alone
MIN_EXCESS_SHARE_OF_FORCES = (
    0.12  # and beyond which it matters to what was found in forces and moments: rotors answer a push
)
ROUGHER = 1.05  # times the twins' noise, from which on the recording's own counts


def excess_process_noise(evidence: Evidence, vehicle: Vehicle, least: float = MIN_EXCESS_SHARE) -> np.ndarray:
    """Return by how much (6,) m/s^2 and rad/s^2 chance pushes and turns a vehicle beyond its twins; zero where by less
    than a share of theirs, and by what its rotors are louder, as of a vehicle that carries a load.

    vehicle: with all that was taken in.
    """
    (line,), (residual_model,), found = residuals_at(evidence, vehicle), evidence.residual_models, np.zeros(6)
    noise = reference_flights.unit_process_noise((len(residual_model.recording.t),), residual_model.recording.dt, 0)
    passed = np.var(np.diff(apply(residual_model.filter.smooth, noise)))
    moving = null_distribution.difference_variance(line)
    for place, layer in ((0, "force"), (3, "moment")):
        rows = [i for i, channel in enumerate(residual_model.channels) if channel.layer == layer]
        excess = np.maximum(moving - evidence.reference_difference_variance[0], 0.0)[rows]
        allowed = (least + evidence.rotor_noise_ratio[0] - 1.0) * evidence.reference_difference_variance[0][rows]
        found[place : place + len(rows)] = np.where(excess > allowed, np.sqrt(excess / passed), 0.0)
    return found


def with_recorded_noise(evidence: Evidence, vehicle: Vehicle, keys, values) -> Evidence:
    """Return the evidence with residuals that are as noisy as the recordings': the air, the rotors and the instruments
    may be rougher than those of the twins."""
    effects = {effect.key: effect for effect in evidence.effects}
    flown = with_effects(vehicle, [effects[key] for key in keys], values)
    lines, times = residuals_at(evidence, flown), []
    for line, noise, calm in zip(lines, evidence.noises, evidence.reference_difference_variance, strict=True):
        floor = FLOOR * noise**2
        times.append(
            np.sqrt(
                np.maximum(
                    (null_distribution.difference_variance(line) + floor) / np.maximum(calm + floor, 1e-300), 1.0
                )
            )
        )
    if all(np.all(one < ROUGHER) for one in times):
        return evidence
    sigmas = tuple(sigma * one for sigma, one in zip(evidence.sigmas, times, strict=True))
    return replace(
        evidence,
        sigmas=sigmas,
        null_distribution=null_distribution.with_noise_ratio(evidence.null_distribution, times),
        library=equation_search.with_noise_ratio(evidence.library, times),
    )
