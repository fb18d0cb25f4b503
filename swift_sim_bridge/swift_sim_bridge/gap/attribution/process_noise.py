"""Process noise of a recording beyond that of its reference flights."""

from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.attribution.gauss_newton import residuals_at, with_effects
from swift_sim_bridge.gap.discovery import feature_library
from swift_sim_bridge.gap.inference import null_distribution
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.nominal import reference_flights
from swift_sim_bridge.gap.residuals.filters import apply
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

NEGLIGIBLE_SHARE = 0.02  # of a residual's variance, added to both variances of a ratio: bounds the ratio of tiny ones
MIN_EXCESS_SHARE = 0.3  # of the reference flights' variance; below, the excess may be that of the sensors
MIN_EXCESS_SHARE_OF_FORCES = 0.12  # the same, if forces or moments were found: the rate loop reacts to process noise
STEP_ERRORS = 2.0  # standard errors of a variance of steps within which it may be larger
SAMPLES = 16  # of unit process noise, whose mean window squares are known to 5 %
MIN_NOISE_RATIO = 1.05  # ratio of standard deviations from which on the noise of the recording replaces the references'


def excess_process_noise(evidence: Evidence, vehicle: Vehicle, min_share: float = MIN_EXCESS_SHARE) -> np.ndarray:
    """Return the process noise (6,), m/s^2 and rad/s^2, of a recording beyond that of its reference flights.

    Args:
        evidence: one recording.
        vehicle: the vehicle with all selected effects.
        min_share: share of the reference flights' variance below which an excess counts as zero. It is increased by the
            noise of rotors that turn faster than those of the reference flights, as with a load.
    """
    (line,), (residual_model,), found = residuals_at(evidence, vehicle), evidence.residual_models, np.zeros(6)
    noise = reference_flights.unit_process_noise((len(residual_model.recording.t),), residual_model.recording.dt, 0)
    unit_variance = np.var(np.diff(apply(residual_model.filter.smooth, noise)))
    variance, reference = null_distribution.difference_variance(line), evidence.reference_difference_variance[0]
    for begin, layer in ((0, "force"), (3, "moment")):
        rows = [i for i, channel in enumerate(residual_model.channels) if channel.layer == layer]
        excess = np.maximum(variance - reference, 0.0)[rows]
        allowed = (min_share + evidence.rotor_noise_ratio[0] - 1.0) * reference[rows]
        found[begin : begin + len(rows)] = np.where(excess > allowed, np.sqrt(excess / unit_variance), 0.0)
    return found


def window_squares_of_noise(residual_model: ResidualModel, line: Linearisation, reference: np.ndarray) -> np.ndarray:
    """Return the `null_distribution.window_squares` (c,) that process noise may add to those of the reference flights.

    Process noise that is too weak to be simulated is as slow as a manoeuvre, where the noise of sensors is fast, as in
    the derivative of a gyro. It may be as strong as the steps of the residuals allow. Other channels than forces and
    moments have none.

    Args:
        residual_model: of the recording.
        line: its residuals (m, c).
        reference: variance (c,) of the steps between neighbouring residuals of its reference flights.
    """
    steps = np.diff(line.residual[line.good], axis=0) ** 2
    whole = len(steps) // null_distribution.SAMPLES_PER_SECOND * null_distribution.SAMPLES_PER_SECOND
    seconds = steps[:whole].reshape(-1, null_distribution.SAMPLES_PER_SECOND, steps.shape[1]).mean(axis=1)
    error = seconds.std(axis=0) / np.sqrt(max(len(seconds), 1))
    excess = np.maximum(seconds.mean(axis=0) + STEP_ERRORS * error - reference, 0.0)
    recording = residual_model.recording
    noise = reference_flights.unit_process_noise((SAMPLES, len(recording.t)), recording.dt, 0).T
    filtered = apply(residual_model.filter.smooth, noise)
    unit = null_distribution.window_squares(replace(line, residual=filtered)).mean()
    physical = np.array([channel.layer in ("force", "moment") for channel in residual_model.channels])
    return physical * excess * unit / np.var(np.diff(filtered, axis=0))


def with_recorded_noise(evidence: Evidence, vehicle: Vehicle, keys, values) -> Evidence:
    """Return the evidence with the noise of the recordings, where it exceeds that of the reference flights.

    Air, rotors and sensors of a recording may be noisier than the reference flights'. If none is, the same object is
    returned.

    Args:
        evidence: the evidence.
        vehicle: the vehicle without effects.
        keys: the selected effects.
        values: their values, by key.
    """
    effects = {effect.key: effect for effect in evidence.effects}
    repaired = with_effects(vehicle, [effects[key] for key in keys], values)
    ratios = []
    for line, noise, reference in zip(
        residuals_at(evidence, repaired), evidence.noises, evidence.reference_difference_variance, strict=True
    ):
        floor = NEGLIGIBLE_SHARE * noise**2
        variance = null_distribution.difference_variance(line)
        ratios.append(np.sqrt(np.maximum((variance + floor) / np.maximum(reference + floor, 1e-300), 1.0)))
    if all(np.all(ratio < MIN_NOISE_RATIO) for ratio in ratios):
        return evidence
    return replace(
        evidence,
        sigmas=tuple(sigma * ratio for sigma, ratio in zip(evidence.sigmas, ratios, strict=True)),
        noise_ratios=tuple(known * ratio for known, ratio in zip(evidence.noise_ratios, ratios, strict=True)),
        null_distribution=null_distribution.with_noise_ratio(evidence.null_distribution, ratios),
        library=feature_library.with_noise_ratio(evidence.library, ratios),
    )
