"""The diagnosis of several recordings of one vehicle together.

The airframe is the same in all recordings; battery, air and calibration can differ from flight to flight. Each
recording is first diagnosed alone. Its selected effects that can differ from flight to flight belong to that recording
and stay in its residual model. Then one search over all recordings together looks for the effects that the vehicle has
in every flight.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_channels import CHANNELS
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import gauss_newton_fit, with_effects
from swift_sim_bridge.gap.attribution.likeliest import with_likeliest_first
from swift_sim_bridge.gap.attribution.search import select_effects
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import file_values
from swift_sim_bridge.gap.inference.sensitivity import parameter_steps, with_effect_terms
from swift_sim_bridge.gap.pipeline import single_flight
from swift_sim_bridge.gap.pipeline.diagnosis import REPEATING, VALIDATING, Diagnosis, Options
from swift_sim_bridge.gap.pipeline.prepare import COMPARABLE_CHANNELS, Prior, prepare_evidence
from swift_sim_bridge.gap.recording.rate_pid import rate_pid_from_vehicle
from swift_sim_bridge.gap.recording.recording import SYNCHRONOUS_CHANNELS, require_rotor_count
from swift_sim_bridge.gap.report import content
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.validation import holdout, repair_choice
from swift_sim_bridge.gap.validation.parts import TRAINING_SHARE

AIR = ("wind", "gust", "local_draught")  # effects of the day, which no vehicle file keeps
EXCLUSION_FACTOR = 2.0  # times the minimum detectable magnitude: a larger effect that is not found is not there
FIXED_SENSOR_EFFECTS = ("imu_lever_arm",)  # sensor effects that are the same in every flight


@dataclass(frozen=True)
class SingleRecording:
    """The diagnosis of one recording alone.

    Attributes:
        evidence: evidence of this recording.
        own_effects: selected effects that belong to this recording.
        process_noise: standard deviations (6,) of its process noise (see `prepare.Prior`).
    """

    evidence: Evidence
    own_effects: tuple[SelectedEffect, ...]
    process_noise: np.ndarray


def per_flight(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the ids of effects that can differ from flight to flight: battery, air, calibration."""
    sensors = {one.id for one in catalogue(vehicle) if one.layer in ("imu", "vio")} - set(FIXED_SENSOR_EFFECTS)
    return ("battery_sag", *AIR, *sorted(sensors))


def diagnose(recordings: list[FlightTable], vehicle: Vehicle, options: Options) -> Diagnosis:
    """Return the diagnosis of several recordings of one vehicle; call it through `gap.api.diagnose`."""
    flight_effects = per_flight(vehicle)
    for table in recordings:
        require_rotor_count(table, vehicle)
    recordings = comparable(recordings, options.progress)
    singles = [_diagnose_alone(table, vehicle, options, flight_effects) for table in recordings]
    options.progress("all recordings together")
    prior = Prior(_values(singles), np.array([one.process_noise for one in singles]), per_flight=flight_effects)
    evidence = prepare_evidence(recordings, vehicle, options, prior)
    found = select_effects(evidence, with_effect_terms(vehicle, evidence.effects), options.progress)
    found = with_likeliest_first(found, with_effect_terms(vehicle, found.evidence.effects), options.progress)
    found = replace(found, selected=_limit_certainty(found.selected, [one.own_effects for one in singles]))
    singles = _resolve_by_other_flights(singles, vehicle)
    chosen = repair_choice.choose_repair(vehicle, found, options.progress)
    singles = [_exclude_shared(one, evidence, found) for one in singles]
    singles = [_refit(_with_likeliest_first(one, vehicle), vehicle, chosen.effects) for one in singles]
    holdout_result = holdout.HoldoutResult()
    if options.validate:
        holdout_result = _validate(evidence, singles, vehicle, chosen.effects, options.progress)
    selected = (*chosen.effects, *_means([one.own_effects for one in singles]))
    advice = single_flight.propose_manoeuvres(evidence, vehicle, found, recordings[0], options.progress)
    left = {}
    if options.validate and selected:
        options.progress(REPEATING)
        repaired = single_flight.repair(vehicle, chosen.effects)
        again = replace(prior, own_effects=_values(singles), firmware=rate_pid_from_vehicle(vehicle))
        left = single_flight.diagnose_repaired(evidence, recordings, repaired, options, again)
    described = repair_choice.reported(found, chosen)
    report = content.report_content(evidence, described, holdout_result.entry, advice, left, chosen)
    bare = replace(
        found.evidence, residual_models=tuple(ResidualModel(one.recording) for one in evidence.residual_models)
    )
    return Diagnosis(
        report=_with_own_findings(report, recordings, evidence, singles),
        vehicle=single_flight.repair(vehicle, selected),
        selected=selected,
        evidence=bare,
        holdout_result=holdout_result,
        equation_terms=found.equation_terms,
        own_effects=tuple(one.own_effects for one in singles),
    )


def comparable(recordings: list[FlightTable], progress) -> list[FlightTable]:
    """Return the recordings with the channels that all of them have.

    Gates in images are kept only if all recordings have them with the same camera and map. Effects that are fitted to
    all recordings together must be compared in all of them.

    Args:
        recordings: recordings of one vehicle.
        progress: called with a line about what is left out.

    Raises:
        UsageError: they have no channel in common that can be compared with a simulation.
    """
    shared = set.intersection(*(set(one.channels) for one in recordings))
    if not shared & {*SYNCHRONOUS_CHANNELS, "motor_command"}:
        raise UsageError(
            f"{', '.join(one.name for one in recordings)}: these recordings have no channel in common that can be "
            f"compared; record in each {COMPARABLE_CHANNELS}"
        )
    dropped = {name for one in recordings for name in one.channels} - shared
    gates = [one.detected_gates for one in recordings]
    same_gates = all(gates) and all((one.camera, one.track) == (gates[0].camera, gates[0].track) for one in gates)
    if dropped or (any(gates) and not same_gates):
        columns = [column for name in CHANNELS if name in dropped for column in CHANNELS[name].columns]
        images = [] if same_gates or not any(gates) else ["gates in images"]
        progress(f"left out, as not all recordings can show it: {', '.join([*columns, *images])}")
    return [
        replace(
            one,
            channels={name: samples for name, samples in one.channels.items() if name in shared},
            detected_gates=one.detected_gates if same_gates else None,
        )
        for one in recordings
    ]


def _diagnose_alone(table: FlightTable, vehicle: Vehicle, options: Options, flight_effects) -> SingleRecording:
    """Search one recording alone and keep the effects that can differ from flight to flight."""
    evidence, found, process_noise = single_flight.search_recording(table, vehicle, options)
    own = tuple(one for one in found.selected if one.effect.id in flight_effects)
    return SingleRecording(evidence, own, process_noise)


def _values(singles: list[SingleRecording]) -> tuple:
    """Return for each recording its own effects with their values."""
    return tuple(tuple((one.effect, one.values) for one in single.own_effects) for single in singles)


def _limit_certainty(shared: tuple[SelectedEffect, ...], own_effects) -> tuple[SelectedEffect, ...]:
    """Return the shared effects, none of them certain where a recording has many effects.

    Counted are the shared effects and those of one recording, without gusts: several effects that resemble each other
    may together replace one cause that is not in the catalogue.
    """
    most = max(sum(one.effect.id != "gust" for one in own) for own in own_effects)
    few = len(shared) + most < model_comparison.MIN_UNCERTAIN_COUNT
    return tuple(replace(one, is_certain=one.is_certain and few) for one in shared)


def _refit(single: SingleRecording, vehicle: Vehicle, shared: tuple[SelectedEffect, ...]) -> SingleRecording:
    """Fit a recording's own effects again beside the shared effects; gusts, which no fit estimates, stay unchanged."""
    fitted = {one.effect.key: one for one in single.own_effects if one.effect.id != "gust"}
    if not fitted:
        return single
    base = single_flight.repair(vehicle, shared)
    effects, initial = [one.effect for one in fitted.values()], {key: one.values for key, one in fitted.items()}
    ready = with_effect_terms(base, single.evidence.effects)
    values, covariance = gauss_newton_fit(single.evidence, ready, effects, initial)
    refitted = {key: one.fitted_again(values[key], covariance[key]) for key, one in fitted.items()}
    return replace(single, own_effects=tuple(refitted.get(one.effect.key, one) for one in single.own_effects))


def _resolve_by_other_flights(singles: list[SingleRecording], vehicle: Vehicle) -> list[SingleRecording]:
    """Resolve an ambiguous effect of one recording to the one of its confounders that another recording identifies.

    The size of a sensor's error changes from flight to flight, but hardly its kind.
    """
    identified = {own.effect.key: own.effect for one in singles for own in one.own_effects if len(own.confounders) == 1}

    def resolved(own: SelectedEffect) -> SelectedEffect:
        keys = [key for key in own.confounders if key in identified]
        if len(own.confounders) == 1 or len(keys) != 1:
            return own
        return replace(_in_place_of(own, identified[keys[0]], vehicle), confounders={keys[0]: 1.0})

    def without_duplicates(own_effects) -> tuple[SelectedEffect, ...]:
        found: dict[str, SelectedEffect] = {}
        for own in own_effects:
            found.setdefault(own.effect.key, own)
        return tuple(found.values())

    return [replace(one, own_effects=without_duplicates(resolved(own) for own in one.own_effects)) for one in singles]


def _exclude_shared(single: SingleRecording, evidence: Evidence, found: SearchResult) -> SingleRecording:
    """Return a recording's own effects without the confounders that all recordings together exclude.

    A shared effect is excluded where it would be large enough for all recordings together to show it, and their search
    has not selected it.
    """
    selected, slices = {one.effect.key for one in found.selected}, evidence.null_distribution.slices
    least = parameter_steps(evidence.effects) * evidence.null_distribution.minimum_detectable

    def excluded(own: SelectedEffect, key: str) -> bool:
        shared = key in slices and key not in selected
        return shared and bool(np.any(np.abs(own.changes[key]) > EXCLUSION_FACTOR * least[slices[key]]))

    own_effects = (
        own.without_confounders({key for key in own.confounders if excluded(own, key)}) for own in single.own_effects
    )
    return replace(single, own_effects=tuple(own_effects))


def _with_likeliest_first(single: SingleRecording, vehicle: Vehicle) -> SingleRecording:
    """Return a recording whose own effects are the likeliest ones of their sets that can belong to it alone."""
    effects = {one.key: one for one in single.evidence.effects if one.id in per_flight(vehicle)}
    found: dict[str, SelectedEffect] = {}
    for own in single.own_effects:
        weights = {key: weight for key, weight in own.confounders.items() if key in effects and key not in found}
        likeliest = max(weights, key=weights.__getitem__, default=own.effect.key)
        headed = own if likeliest == own.effect.key else _in_place_of(own, effects[likeliest], vehicle)
        found.setdefault(headed.effect.key, headed)
    return replace(single, own_effects=tuple(found.values()))


def _in_place_of(own: SelectedEffect, effect: Effect, vehicle: Vehicle) -> SelectedEffect:
    """Return a confounder of a selected effect in its place, with the value that it has to first order."""
    return replace(own, effect=effect, values=file_values(effect, vehicle) + own.changes[effect.key])


def _means(own_effects) -> tuple[SelectedEffect, ...]:
    """Return the recordings' own effects as a vehicle file can hold them: the mean over those that have the effect."""
    found = {}
    for one in (one for own in own_effects for one in own if one.effect.id not in AIR):
        found.setdefault(one.effect.key, []).append(one)
    return tuple(
        replace(
            some[0],
            values=np.mean([one.values for one in some], axis=0),
            covariance=np.mean([one.covariance for one in some], axis=0) / len(some),
            significance=max(one.significance for one in some),
        )
        for some in found.values()
    )


def _validate(
    evidence: Evidence, singles: list[SingleRecording], vehicle: Vehicle, shared: tuple[SelectedEffect, ...], progress
) -> holdout.HoldoutResult:
    """Return the errors on the last part of each recording, with shared and own effects fitted to the rest."""
    progress(VALIDATING)
    effects, values = [one.effect for one in shared], {}
    if shared:
        initial = {one.effect.key: one.values for one in shared}
        values, _ = gauss_newton_fit(evidence, vehicle, effects, initial, TRAINING_SHARE)
    parts = []
    for single in (one for one in singles if shared or one.own_effects):
        after, own = with_effects(vehicle, effects, values), [one.effect for one in single.own_effects]
        if own:
            ready = with_effect_terms(after, single.evidence.effects)
            initial = {one.effect.key: one.values for one in single.own_effects}
            fitted, _ = gauss_newton_fit(single.evidence, ready, own, initial, TRAINING_SHARE)
            after = with_effects(after, own, fitted)
        parts.append(holdout.validate(single.evidence.residual_models, vehicle, after, [*effects, *own]))
    rollouts = sum((part.trajectories for part in parts), ())
    return holdout.HoldoutResult(_mean_entry([part.entry for part in parts]), rollouts)


def _mean_entry(entries: list[dict]) -> dict:
    """Return nested root mean squares over the recordings that have each value; a short one may have no rollouts."""
    keys = dict.fromkeys(key for entry in entries for key in entry)
    return {key: _mean([entry[key] for entry in entries if key in entry]) for key in keys}


def _mean(values: list):
    """Return the mean of the values of one key: kinds, the root mean square of errors, or an entry of these."""
    if isinstance(values[0], dict):
        return _mean_entry(values)
    return (
        ", ".join(dict.fromkeys(values)) if isinstance(values[0], str) else float(np.sqrt(np.mean(np.square(values))))
    )


def _smallest(entries: list[dict]) -> dict:
    """Return the smallest magnitude of each parameter over entries of `minimum_detectable`, one for each recording."""
    found = {}
    for name, sizes in (item for entry in entries for item in entry.items()):
        known = found.setdefault(name, {})
        known.update({parameter: min(size, known.get(parameter, size)) for parameter, size in sizes.items()})
    return found


def _with_own_findings(
    report: dict, recordings: list[FlightTable], evidence: Evidence, singles: list[SingleRecording]
) -> dict:
    """Return the content of report.json with the findings of single recordings after those of all.

    A finding of a single recording has the recording's name.
    """
    findings = list(report["findings"])
    for table, single in zip(recordings, singles, strict=True):
        own = [content.finding(one, single.evidence, {}) for one in single.own_effects]
        findings += [{**finding, "recording": table.name} for finding in own]
    detectable, untestable = _smallest([content.minimum_detectable(one.evidence) for one in singles]), {}
    for one in singles:
        untestable |= {name: reason for name, reason in one.evidence.not_testable.items() if name not in detectable}
    detectable |= report["minimum_detectable"]
    return report | {
        "verdict": content.overall_verdict(findings, evidence, detectable),
        "findings": findings,
        "minimum_detectable": detectable,
        "not_testable": dict(sorted((untestable | report["not_testable"]).items())),
    }
