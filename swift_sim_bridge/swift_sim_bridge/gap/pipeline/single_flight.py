"""The whole diagnosis: recordings and the vehicle file that should explain them, to a report."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import gauss_newton, wind
from swift_sim_bridge.gap.attribution.evidence import Evidence, Found, Taken
from swift_sim_bridge.gap.attribution.gauss_newton import injected, settle
from swift_sim_bridge.gap.attribution.search import search
from swift_sim_bridge.gap.discovery.equation_search import Term
from swift_sim_bridge.gap.inference.sensitivity import ready
from swift_sim_bridge.gap.nominal import closed_loop
from swift_sim_bridge.gap.pipeline.prepare import gather
from swift_sim_bridge.gap.recording.betaflight_log import with_gains
from swift_sim_bridge.gap.recording.rate_pid import RatePid, loop_of
from swift_sim_bridge.gap.validation import experiment_design, holdout
from swift_sim_bridge.parallel import at_once

BEFORE_AND_AFTER = "before and after, on parts of the flights that no fit has seen"  # what is told of the progress
AGAIN = "diagnosing again, with the repaired vehicle"


@dataclass(frozen=True)
class Diagnosis:
    """report: the content of report.json; vehicle: the repaired one; taken: what was taken in; evidence; proof: what
    it is worth where no fit has seen the flights; unknown: what is left that no name explains; own: what each of
    several recordings has to itself, of which `taken` and `vehicle` hold the mean."""

    report: dict
    vehicle: Vehicle
    taken: tuple[Taken, ...]
    evidence: Evidence
    proof: holdout.Proof
    unknown: tuple[Term, ...] = ()
    own: tuple[tuple[Taken, ...], ...] = ()


def diagnose(
    recordings: list[FlightTable],
    vehicle: Vehicle,
    tell: Callable[[str], None] = print,
    seed: int = 0,
    knocked_out: tuple[str, ...] = (),
    proven: bool = True,
) -> Diagnosis:
    """Return what the vehicle file leaves out of these recordings of one vehicle.

    tell: hears of the progress; seed: of the twins' chance; knocked_out: effects to leave out of the catalogue;
    proven: with the errors before and after on what no fit has seen, a third of the work.
    Raises UsageError for recordings that cannot be used.
    """
    from swift_sim_bridge.gap.pipeline import multi_flight
    from swift_sim_bridge.gap.report import content as report

    vehicle = with_gains(vehicle)
    with jax.enable_x64(True):
        if len(recordings) > 1:
            return multi_flight.diagnose(recordings, vehicle, tell, seed, knocked_out, proven)
        evidence, found, unrest = informed(recordings, vehicle, tell, seed, knocked_out)
        advice = advised(evidence, vehicle, found, recordings[0], tell)
        repaired, shown, left = repair(vehicle, found.taken), holdout.Proof(), {}
        if proven and found.taken:
            tell(f"{BEFORE_AND_AFTER}; {AGAIN}")
            shown, left = at_once(
                partial(proof, evidence, vehicle, found.taken),
                partial(remaining, recordings, repaired, seed, knocked_out, unrest=unrest, firmware=loop_of(vehicle)),
            )
        content = report.content(evidence, found, shown.entry, advice, left)
        searched = replace(evidence, library=found.evidence.library)
        return Diagnosis(content, repaired, found.taken, searched, shown, found.unknown)


def informed(recordings, vehicle: Vehicle, tell, seed: int, knocked_out) -> tuple[Evidence, Found, np.ndarray]:
    """Return the evidence of one recording, what it calls for, and what pushes its twins (see `twins.fly`).

    They must be pushed by chance as the recording was: a loop that answers makes its answer look like an effect.
    """
    evidence = gather(recordings, vehicle, tell, seed, knocked_out)
    found = search(evidence, ready(vehicle, evidence.effects), tell)
    air_of_day = ()
    if blown := wind.gusts(evidence, ready(vehicle, evidence.effects), found):
        tell(f"{blown.effect.key}: {blown.sigma:.1f} standard deviations; what else is named must exceed them")
        air_of_day = (blown,)
        evidence = gather(recordings, repair(vehicle, air_of_day), tell, seed, knocked_out)
        found = search(evidence, ready(vehicle, evidence.effects), tell)
    layers = {one.effect.layer for one in found.taken} | {term.channel.layer for term in found.unknown}
    least = gauss_newton.ANSWERED if layers & {"force", "moment"} else gauss_newton.RESTLESS
    unrest = gauss_newton.pushed(evidence, ready(repair(vehicle, found.taken), evidence.effects), least)
    if np.any(unrest):
        tell("chance pushes it more than its twins: flying them again, pushed as much")
        evidence = gather(recordings, repair(vehicle, air_of_day), tell, seed, knocked_out, unrest=unrest)
        found = search(evidence, ready(vehicle, evidence.effects), tell)
    return evidence, replace(found, taken=(*found.taken, *air_of_day)), unrest


def remaining(
    recordings,
    repaired: Vehicle,
    seed: int,
    knocked_out,
    owns=None,
    unrest=closed_loop.CALM,
    firmware: RatePid | None = None,
    elsewhere=(),
) -> dict:
    """Return what the repaired vehicle still leaves out: verdict and findings, as the report has them. firmware: the
    loop that flew, which knows nothing of the repair; owns, unrest, elsewhere: see `gather`."""
    from swift_sim_bridge.gap.report import content as report

    evidence = gather(recordings, repaired, lambda _: None, seed, knocked_out, owns, unrest, firmware, elsewhere)
    found = search(evidence, ready(repaired, evidence.effects), lambda _: None)
    content = report.content(evidence, found, {}, {}, {})
    return {key: content[key] for key in ("verdict", "findings")}


def advised(evidence: Evidence, vehicle: Vehicle, found: Found, table: FlightTable, tell) -> dict:
    """Return by key of each effect that has look-alikes what to fly to tell them apart, None where nothing helps."""
    effects, advice = {effect.key: effect for effect in found.evidence.effects}, {}
    for one in (one for one in found.taken if len(one.alike) > 1):
        tell(f"{' or '.join(one.alike)}: trying which manoeuvre tells them apart")
        rivals = [one.effect if key == one.effect.key else effects[key] for key in one.alike]
        weights = evidence.sigmas[0], found.evidence.nulls.copies(one.effect.key)
        advice[one.effect.key] = experiment_design.advice(rivals, one.changes, vehicle, table, weights)
    return advice


def proof(evidence: Evidence, vehicle: Vehicle, taken: tuple[Taken, ...]) -> holdout.Proof:
    """Return the errors on the part of the flights that a fit of what was taken in has not seen."""
    effects = [one.effect for one in taken]
    values = {one.effect.key: one.values for one in taken}
    values, _ = settle(evidence, vehicle, effects, values, holdout.LEARNT_SHARE)
    return holdout.held_out(evidence.replayers, vehicle, injected(vehicle, effects, values), effects)


def repair(vehicle: Vehicle, taken: tuple[Taken, ...]) -> Vehicle:
    """Return the vehicle with what was taken in."""
    return injected(vehicle, [one.effect for one in taken], {one.effect.key: one.values for one in taken})
