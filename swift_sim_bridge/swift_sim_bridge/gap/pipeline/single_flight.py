"""The diagnosis of one recording, and the steps that the diagnosis of several recordings has in common with it."""

from dataclasses import replace
from functools import partial

import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import wind
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.gauss_newton import gauss_newton_fit, with_effects
from swift_sim_bridge.gap.attribution.likeliest import with_likeliest_first
from swift_sim_bridge.gap.attribution.process_noise import (
    MIN_EXCESS_SHARE,
    MIN_EXCESS_SHARE_OF_FORCES,
    excess_process_noise,
)
from swift_sim_bridge.gap.attribution.search import select_effects
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.pipeline.diagnosis import REPEATING, VALIDATING, Diagnosis, Options
from swift_sim_bridge.gap.pipeline.prepare import Prior, prepare_again, prepare_evidence
from swift_sim_bridge.gap.recording.rate_pid import rate_pid_from_vehicle
from swift_sim_bridge.gap.report.content import report_content
from swift_sim_bridge.gap.validation import experiment_design, holdout, repair_choice
from swift_sim_bridge.gap.validation.parts import TRAINING_SHARE
from swift_sim_bridge.gap.validation.repair_choice import Repair
from swift_sim_bridge.parallel import run_in_threads


def diagnose(recording: FlightTable, vehicle: Vehicle, options: Options) -> Diagnosis:
    """Return the diagnosis of one recording; call it through `gap.api.diagnose`."""
    evidence, found, process_noise = search_recording(recording, vehicle, options)
    found = with_likeliest_first(found, with_effect_terms(vehicle, found.evidence.effects), options.progress)
    advice = propose_manoeuvres(evidence, vehicle, found, recording, options.progress)
    chosen = repair_choice.choose_repair(vehicle, found, options.progress)
    repaired, holdout_result, left = repair(vehicle, chosen.effects), holdout.HoldoutResult(), {}
    if options.validate and chosen.effects:
        options.progress(f"{VALIDATING}; {REPEATING}")
        prior = Prior(process_noise=process_noise, firmware=rate_pid_from_vehicle(vehicle))
        holdout_result, left = run_in_threads(
            partial(validate, evidence, vehicle, chosen),
            partial(diagnose_repaired, evidence, [recording], repaired, options, prior),
        )
    report = report_content(evidence, repair_choice.reported(found, chosen), holdout_result.entry, advice, left, chosen)
    searched = replace(evidence, library=found.evidence.library)
    return Diagnosis(report, repaired, chosen.effects, searched, holdout_result, found.equation_terms)


def search_recording(
    recording: FlightTable, vehicle: Vehicle, options: Options
) -> tuple[Evidence, SearchResult, np.ndarray]:
    """Return the evidence of one recording, the selected effects, and its process noise (6,) (see `Prior`).

    The reference flights must have the gusts and the process noise of the recording: the rate loop reacts to them, and
    without them in the reference flights its reaction would look like an effect. Each of the two that is found is added
    to the reference flights, and the search is repeated.
    """
    evidence = prepare_evidence([recording], vehicle, options)
    found = select_effects(evidence, with_effect_terms(vehicle, evidence.effects), options.progress)
    gusts = ()
    if gust := wind.find_gusts(evidence, with_effect_terms(vehicle, evidence.effects), found):
        options.progress(
            f"{gust.effect.key}: {gust.significance:.1f} standard deviations; "
            "other effects must explain more than the gusts do"
        )
        gusts = (gust,)
        evidence = prepare_evidence([recording], repair(vehicle, gusts), options)
        found = select_effects(evidence, with_effect_terms(vehicle, evidence.effects), options.progress)
    layers = {one.effect.layer for one in found.selected} | {term.channel.layer for term in found.equation_terms}
    least = MIN_EXCESS_SHARE_OF_FORCES if layers & {"force", "moment"} else MIN_EXCESS_SHARE
    process_noise = excess_process_noise(
        evidence, with_effect_terms(repair(vehicle, found.selected), evidence.effects), least
    )
    if np.any(process_noise):
        options.progress("more process noise than in the reference flights: flying them again with as much")
        prior = Prior(process_noise=process_noise)
        evidence = prepare_evidence([recording], repair(vehicle, gusts), options, prior)
        found = select_effects(evidence, with_effect_terms(vehicle, evidence.effects), options.progress)
    gusts = tuple(replace(one, is_certain=wind.gusts_are_certain(one, found)) for one in gusts)
    return evidence, replace(found, selected=(*found.selected, *gusts)), process_noise


def diagnose_repaired(
    evidence: Evidence, recordings: list[FlightTable], repaired: Vehicle, options: Options, prior: Prior
) -> dict:
    """Return verdict and findings that remain with the repaired vehicle, as the report has them.

    Args:
        evidence: what the diagnosis worked on; its reference flights are not flown again.
        recordings: the recordings of the diagnosis.
        repaired: the repaired vehicle.
        options: options of the diagnosis; no progress is reported.
        prior: what the diagnosis found before; its `firmware` is the rate loop that flew, which is not repaired.
    """
    silent = replace(options, progress=lambda _: None)
    evidence = prepare_again(evidence, recordings, repaired, silent, prior)
    found = select_effects(evidence, with_effect_terms(repaired, evidence.effects), silent.progress)
    found = with_likeliest_first(found, with_effect_terms(repaired, found.evidence.effects), silent.progress)
    report = report_content(evidence, found, {}, {}, {})
    return {key: report[key] for key in ("verdict", "findings")}


def propose_manoeuvres(evidence: Evidence, vehicle: Vehicle, found: SearchResult, table: FlightTable, progress) -> dict:
    """Return for each ambiguous effect, by key, the manoeuvre that separates its confounders, None where none does."""
    effects, advice = {effect.key: effect for effect in found.evidence.effects}, {}
    for one in (one for one in found.selected if len(one.confounders) > 1):
        progress(f"{' or '.join(one.confounders)}: simulating which manoeuvre separates them")
        confounders = [one.effect if key == one.effect.key else effects[key] for key in one.confounders]
        weights = evidence.sigmas[0], found.evidence.null_distribution.variance_inflation(one.effect.key)
        advice[one.effect.key] = experiment_design.separating_manoeuvre(
            confounders, one.changes, vehicle, table, weights
        )
    return advice


def validate(evidence: Evidence, vehicle: Vehicle, chosen: Repair) -> holdout.HoldoutResult:
    """Return the errors on the last part of the flights, with the effects of the repair fitted to the rest."""
    effects = [one.effect for one in chosen.effects]
    values = {one.effect.key: one.values for one in chosen.effects}
    if fitted := [one for one in effects if one.id != "gust"]:  # random: no fit estimates it
        ready = with_effect_terms(vehicle, tuple(effects))
        values |= gauss_newton_fit(evidence, ready, fitted, values, TRAINING_SHARE)[0]
    return holdout.validate(evidence.residual_models, vehicle, with_effects(vehicle, effects, values), effects)


def repair(vehicle: Vehicle, taken: tuple[SelectedEffect, ...]) -> Vehicle:
    """Return the vehicle with the selected effects at their estimated values."""
    return with_effects(vehicle, [one.effect for one in taken], {one.effect.key: one.values for one in taken})
