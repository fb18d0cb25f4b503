"""Preparation of the evidence: recordings on their grids, and reference flights put through the same pipeline."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution import wind
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.attribution.far_start import far_start
from swift_sim_bridge.gap.attribution.gauss_newton import with_effects
from swift_sim_bridge.gap.discovery import feature_library, features
from swift_sim_bridge.gap.inference import null_distribution
from swift_sim_bridge.gap.inference.null_distribution import NullDistribution
from swift_sim_bridge.gap.inference.row_sampling import (
    row_bounds,
    with_fitted_rows,
    with_rotor_spread,
    with_row_bounds,
)
from swift_sim_bridge.gap.inference.sensitivity import Linearisation, LinearisationCache, linearise, noise_floor
from swift_sim_bridge.gap.nominal import (
    phase_surrogates,
    reference_flights,
    rotor_speed_model,
)
from swift_sim_bridge.gap.nominal.noise_sheet import estimate_noise_sheet
from swift_sim_bridge.gap.nominal.recorded_flight import RecordedFlight
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.pipeline.hypotheses import Hypotheses, hypotheses_of
from swift_sim_bridge.gap.pipeline.references import ReferenceFlights
from swift_sim_bridge.gap.recording.rate_pid import RatePid
from swift_sim_bridge.gap.recording.recording import read_recording, with_command_rows
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.parallel import run_in_threads

COMPARABLE_CHANNELS = (
    "a pose (px .. qw) with a gyro (wx wy wz), rotor speeds (rotor_1 ..) or motor commands (u_1 ..), or rotor speeds "
    "with motor commands or the pack's voltage (vbat)"
)  # what a recording needs, so that a residual can be computed; part of error messages


@dataclass(frozen=True)
class Prior:
    """What is known of the recordings before the search.

    Attributes:
        own_effects: for each recording the effects, with their values, that it alone has (see `ResidualModel`); empty
            if none.
        process_noise: standard deviations (6,) of the random force, m/s^2, and moment, rad/s^2, that act on the
            reference flights (see `reference_flights.fly`), or (n, 6) of those of each recording.
        firmware: rate loop that flew, if it is not the vehicle file's (see `recording.read_recording`).
        per_flight: ids of effects that are searched for in each recording alone.
    """

    own_effects: tuple = ()
    process_noise: np.ndarray = field(default_factory=lambda: reference_flights.NO_PROCESS_NOISE)
    firmware: RatePid | None = None
    per_flight: tuple[str, ...] = ()


@dataclass(frozen=True)
class PreparedRecording:
    """What one recording contributes to the evidence.

    Attributes:
        null_distribution: statistics of its reference flights.
        seconds: number of seconds in which the recording has residuals.
        noise_steps: variance (c,) of the steps between neighbouring residuals of its reference flights.
        squares: (c,) largest squares of a reference flight, in units of its sigma.
        window_squares: (c,) the same of `null_distribution.window_squares`.
        rotor_noise_ratio: factor by which its rotors' noise has more variance than that of its reference flights.
        reference_lines: its reference flights, each with its linearisation without sensitivities.
        local_air: for each reference flight the gain of a local draught and the agreement of gusts (see
            `wind.reference_statistics`); empty without a wind effect.
        scatter: deviation (m, c) of its residuals over time (see `wind.local_sigma`), None without a wind effect.
        detectable: minimum detectable magnitudes of effects that are not part of the search, by id and parameter.
    """

    null_distribution: NullDistribution
    seconds: int
    noise_steps: np.ndarray
    squares: np.ndarray
    window_squares: np.ndarray
    rotor_noise_ratio: float
    reference_lines: list[tuple[ResidualModel, Linearisation]]
    local_air: list[tuple[float, float]]
    scatter: np.ndarray | None
    detectable: dict


def prepare_evidence(
    recordings: list[FlightTable], vehicle: Vehicle, options: Options, prior: Prior | None = None
) -> Evidence:
    """Return the evidence that the search works on: replayed recordings and the null distribution of reference flights.

    Args:
        recordings: recordings of one vehicle.
        vehicle: the vehicle that they are compared with.
        options: options of the diagnosis; of knocked-out effects only the minimum detectable magnitude is computed.
        prior: what is known of the recordings already; nothing if None.

    Raises:
        UsageError: no residual can be computed, or none that all recordings have.
    """
    prior = prior or Prior()
    residual_models = _residual_models(recordings, vehicle, options, prior)
    hypotheses = _hypotheses(residual_models, vehicle, options, prior)
    if start := far_start(residual_models, vehicle, hypotheses.effects, options.progress):
        vehicle = with_effects(vehicle, [one for one in hypotheses.effects if one.key in start], start)
        hypotheses = _hypotheses(residual_models, vehicle, options, prior)
    residual_models = [
        with_rows(one, table, vehicle, hypotheses.effects, prior.firmware, options.progress)
        for one, table in zip(residual_models, recordings, strict=True)
    ]
    process_noise = np.broadcast_to(prior.process_noise, (len(recordings), len(reference_flights.NO_PROCESS_NOISE)))
    prepared = []
    for table, residual_model, noise in zip(recordings, residual_models, process_noise, strict=True):
        options.progress(f"{table.name}: flying {references.REFERENCE_FLIGHTS} reference flights")
        prepared.append(prepare_recording(table, residual_model, vehicle, hypotheses, options.seed, noise))
    return replace(evidence_of(residual_models, hypotheses, prepared), start=start)


def prepare_again(
    evidence: Evidence, recordings: list[FlightTable], vehicle: Vehicle, options: Options, prior: Prior
) -> Evidence:
    """Return the evidence of the same recordings against another vehicle, such as the repaired one.

    The reference flights are those of `evidence`, which flew the same path with the same noise: in ten recordings
    those of the repaired vehicle led to the same findings. Where the other vehicle has other effects to search for,
    they are flown anew.

    Args:
        evidence: evidence of the recordings, before a search.
        recordings: the recordings.
        vehicle: the other vehicle.
        options: options of the diagnosis.
        prior: what was known when `evidence` was prepared.
    """
    residual_models = _residual_models(recordings, vehicle, options, prior)
    hypotheses = _hypotheses(residual_models, vehicle, options, prior)
    known = [(one.key, len(one.parameters)) for one in evidence.effects]
    if [(one.key, len(one.parameters)) for one in hypotheses.effects] != known:
        return prepare_evidence(recordings, vehicle, options, prior)
    residual_models = tuple(
        with_rows(
            replace(one, rotor_spread=before.rotor_spread),  # as in the reference flights
            table,
            vehicle,
            hypotheses.effects,
            prior.firmware,
            options.progress,
        )
        for one, before, table in zip(residual_models, evidence.residual_models, recordings, strict=True)
    )
    return replace(
        evidence,
        residual_models=residual_models,
        effects=hypotheses.effects,
        library=feature_library.with_vehicle(evidence.library, residual_models, hypotheses.variants),
        start={},
        cache=LinearisationCache(),
    )


def _residual_models(
    recordings: list[FlightTable], vehicle: Vehicle, options: Options, prior: Prior
) -> list[ResidualModel]:
    """Return the residual models of recordings, with the residuals that all of them have (see `in_common`)."""
    read = [
        read_recording(rotor_speed_model.with_modelled_rotor_speeds(table, vehicle), vehicle, prior.firmware)
        for table in recordings
    ]
    own_effects = prior.own_effects or [()] * len(read)
    found = in_common([ResidualModel(one, own) for one, own in zip(read, own_effects, strict=True)], options.progress)
    return [with_rotor_spread(one, vehicle, options.progress) for one in found]


def _hypotheses(residual_models: list[ResidualModel], vehicle: Vehicle, options: Options, prior: Prior) -> Hypotheses:
    """Return the effects to search for in recordings."""
    recordings = [one.recording for one in residual_models]
    return hypotheses_of(vehicle, recordings, options.knocked_out, prior.per_flight)


def with_rows(
    residual_model: ResidualModel,
    table: FlightTable,
    vehicle: Vehicle,
    effects: tuple[Effect, ...],
    firmware: RatePid | None,
    progress: Callable[[str], None],
) -> ResidualModel:
    """Return the residual model with what its motor commands did between the rows, as the recording shows it.

    Args:
        residual_model: of the recording.
        table: the flight that it was read from.
        vehicle: the vehicle that it is compared with.
        effects: what else may explain the rotor speeds.
        firmware: see `read_recording`.
        progress: called with a line about the rows.
    """
    if residual_model.command_rows is None:
        return residual_model
    rows = with_fitted_rows(residual_model, vehicle, effects).command_rows
    progress(
        f"{table.name}: motor commands have a row every {1e3 * rows.interval_s:.3g} ms, and act "
        f"{1e3 * rows.shift_s:.2g} ms later than a smooth line through the rows"
    )
    recording = with_command_rows(residual_model.recording, table, vehicle, rows, firmware)
    return replace(residual_model, recording=recording)


def prepare_recording(
    table: FlightTable,
    residual_model: ResidualModel,
    vehicle: Vehicle,
    hypotheses: Hypotheses,
    seed: int,
    process_noise: np.ndarray,
) -> PreparedRecording:
    """Fly the reference flights of one recording and put them through the same pipeline.

    Args:
        table: the recording as it was measured.
        residual_model: the same recording on its grid.
        vehicle: the vehicle that it is compared with.
        hypotheses: effects to search for.
        seed: seed of the reference flights.
        process_noise: (6,), see `Prior`.
    """
    variants, rows = hypotheses.variants, hypotheses.rows
    disturbed = references.in_own_air(vehicle, residual_model)
    recorded, flown = run_in_threads(
        partial(linearise, residual_model, variants),
        partial(references.fly_references, table, residual_model, disturbed, seed, process_noise),
    )
    flights, noise_free = references.measured_references(table, residual_model, vehicle, seed, recorded, flown)
    quantities = [one.values for one in features.build_features(residual_model, variants)]
    reference = ReferenceFlights(residual_model, flights, noise_free, quantities, seed)
    lines, noise_free_line = reference.linearised(variants, recorded)
    share = recorded.good.mean() / max(np.mean([line.good.mean() for line in lines]), 1e-9)
    floor = noise_floor(lines, residual_model.channels)
    distribution = null_distribution.estimate_null_distribution(lines, rows, floor, noise_free_line)
    noise_m = estimate_noise_sheet(table, vehicle).get("position_m", 0.0)
    recorded_flight = RecordedFlight(table, residual_model, recorded, vehicle)
    distribution = phase_surrogates.with_pose_noise(distribution, recorded_flight, hypotheses.effects, noise_m, seed)
    distribution = null_distribution.scaled_to_recording(
        distribution, recorded, float(np.clip(share, null_distribution.MIN_INFORMATION_SHARE, 1.0))
    )
    distribution = with_row_bounds(distribution, hypotheses.effects, row_bounds(residual_model.recording))
    local_air, scatter, detectable = [], None, {}
    if "wind" in rows:
        local_air, scatter, detectable = _wind_statistics(reference, lines, recorded, rows["wind"], distribution.sigma)
    if hypotheses.knocked_out:
        detectable = detectable | references.detectable_sizes(hypotheses.knocked_out, vehicle, reference)
    rotor_noise = np.mean([_rotor_noise_variance(flight) for flight in flights])
    return PreparedRecording(
        null_distribution=distribution,
        seconds=null_distribution.seconds_with_data(recorded),
        noise_steps=np.mean([null_distribution.difference_variance(line) for line in lines], axis=0),
        squares=np.max([np.sum(line.residual**2, axis=0) for line in lines], axis=0) / distribution.sigma**2,
        window_squares=np.max([null_distribution.window_squares(line) for line in lines], axis=0)
        / distribution.sigma**2,
        rotor_noise_ratio=max(1.0, _rotor_noise_variance(residual_model) / rotor_noise),
        reference_lines=[
            (flight, replace(line, sensitivity=line.sensitivity[:0].copy()))  # a view would keep 30 MB each
            for flight, line in zip(flights, lines, strict=True)
        ],
        local_air=local_air,
        scatter=scatter,
        detectable=detectable,
    )


def _wind_statistics(
    reference: ReferenceFlights,
    lines: list[Linearisation],
    recorded: Linearisation,
    rows: slice,
    sigma: np.ndarray,
) -> tuple[list[tuple[float, float]], np.ndarray, dict]:
    """Return `local_air`, `scatter` and `detectable` of a `PreparedRecording`.

    Args:
        reference: the reference flights.
        lines: their linearisations, all with the same times.
        recorded: linearisation of the recording.
        rows: parameters of the wind effect.
        sigma: standard deviation (c,) of the residuals in reference flights.
    """
    reference_sigma = wind.local_sigma(lines, sigma, lines[0].t)
    local_air = [
        wind.reference_statistics(flight, line, rows, sigma, reference_sigma)
        for flight, line in zip(reference.flights, lines, strict=True)
    ]
    scatter = wind.local_sigma(lines, sigma, recorded.t)
    return local_air, scatter, wind.minimum_detectable(reference.recorded, recorded, rows, sigma, scatter)


def evidence_of(
    residual_models: list[ResidualModel], hypotheses: Hypotheses, prepared: list[PreparedRecording]
) -> Evidence:
    """Return the evidence of all recordings together."""
    distributions = [one.null_distribution for one in prepared]
    noises, sigmas = (tuple(getattr(part, name) for part in distributions) for name in ("noise", "sigma"))
    lines = [one.reference_lines for one in prepared]
    local_air = [pair for one in prepared for pair in one.local_air]
    scatters = [one.scatter for one in prepared if one.scatter is not None]
    local_wind_gains, gusts = (np.array(part) for part in zip(*local_air, strict=True)) if local_air else (None, np.inf)
    detectable: dict = {}
    for one in prepared:
        detectable |= one.detectable
    excluded = hypotheses.excluded
    return Evidence(
        residual_models=tuple(residual_models),
        null_distribution=null_distribution.pooled(distributions, [one.seconds for one in prepared]),
        noises=noises,
        sigmas=sigmas,
        noise_ratios=tuple(np.ones_like(sigma) for sigma in sigmas),
        effects=hypotheses.effects,
        not_testable=hypotheses.untestable,
        library=feature_library.build_library(tuple(residual_models), lines, hypotheses.variants, sigmas),
        reference_difference_variance=tuple(one.noise_steps for one in prepared),
        reference_squares=tuple(one.squares for one in prepared),
        reference_window_squares=tuple(one.window_squares for one in prepared),
        rotor_noise_ratio=tuple(one.rotor_noise_ratio for one in prepared),
        local_wind_gains=local_wind_gains if "local_draught" not in excluded else None,
        reference_gust_significance=float(np.max(gusts)) if "gust" not in excluded else np.inf,
        local_sigma=scatters[0] if scatters else None,
        other_minimum_detectable=detectable,
        search_payload="payload" not in excluded,
        physics=hypotheses.physics,
    )


def _rotor_noise_variance(residual_model: ResidualModel) -> float:
    """Return the mean fourth power of the rotor speeds, 1 where they are unknown.

    The noise of a rotor's speed is a share of it, so the noise of thrusts and moments has a variance that is
    proportional to this.
    """
    recording = residual_model.recording
    kept = recording.good & recording.flown
    return float(np.mean(recording.rotor_speed[kept] ** 4)) if recording.has("rotor_speed") and kept.any() else 1.0


def in_common(residual_models: list[ResidualModel], progress) -> list[ResidualModel]:
    """Return the residual models with those residuals that all of them have.

    Args:
        residual_models: one for each recording.
        progress: called with a line about what is left out.

    Raises:
        UsageError: a recording has no residual, or all together have none in common.
    """
    for name in (one.recording.name for one in residual_models if not one.channels):
        raise UsageError(f"{name}: no residual can be computed from its channels; record {COMPARABLE_CHANNELS}")
    shared = set.intersection(*(set(one.groups.items()) for one in residual_models))
    dropped = {name for one in residual_models for name in one.groups} - {name for name, _ in shared}
    if dropped:
        progress(f"left out, as not all recordings can show it: {', '.join(sorted(dropped))}")
    if not shared:
        raise UsageError(
            f"{', '.join(one.recording.name for one in residual_models)}: these recordings have no residual in common; "
            f"record in each {COMPARABLE_CHANNELS}"
        )
    return [replace(one, excluded_groups=frozenset(dropped)) for one in residual_models]
