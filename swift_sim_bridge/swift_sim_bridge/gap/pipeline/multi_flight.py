"""Several recordings of one vehicle as one diagnosis: the airframe is the same in all, battery, air and calibration are
each flight's own.

Each recording is first diagnosed alone. What it calls for that can differ from flight to flight is its own and stays in
its replay; then one search looks in all of them together for what the vehicle has in every flight.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import CHANNELS
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import model_comparison
from swift_sim_bridge.gap.attribution.evidence import Evidence, Found, Taken
from swift_sim_bridge.gap.attribution.gauss_newton import injected, settle
from swift_sim_bridge.gap.attribution.search import search
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.spec import start
from swift_sim_bridge.gap.inference.sensitivity import ready, steps
from swift_sim_bridge.gap.pipeline import single_flight as one_flight
from swift_sim_bridge.gap.pipeline.prepare import ENOUGH, gather
from swift_sim_bridge.gap.recording.rate_pid import loop_of
from swift_sim_bridge.gap.recording.recording import USED, refuse_other_rotors
from swift_sim_bridge.gap.report import content as report
from swift_sim_bridge.gap.residuals.replayer import Replayer
from swift_sim_bridge.gap.validation import holdout

AIR = ("wind", "gust", "local_draught")  # of a day: no vehicle file keeps it
SURE = 2.0  # times the smallest size that can be told: what is as large and is not seen is not there
AIRFRAME = ("imu_lever_arm",)  # of the instruments' effects the one that no flight changes


@dataclass(frozen=True)
class Alone:
    """One recording by itself: its evidence, what it has to itself, and what pushes its twins (see `twins.fly`)."""

    evidence: Evidence
    own: tuple[Taken, ...]
    unrest: np.ndarray


def per_flight(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the effects that can differ from flight to flight: battery, air, calibration."""
    instruments = {one.id for one in catalogue(vehicle) if one.layer in ("imu", "vio")} - set(AIRFRAME)
    return ("battery_sag", *AIR, *sorted(instruments))


def diagnose(recordings, vehicle: Vehicle, tell, seed: int, knocked_out, proven: bool):
    """Return the diagnosis of several recordings of one vehicle; arguments as of `diagnose.diagnose`."""
    apart = per_flight(vehicle)
    for table in recordings:
        refuse_other_rotors(table, vehicle)
    recordings = comparable(recordings, tell)
    alone = [_alone(table, vehicle, tell, seed, knocked_out, apart) for table in recordings]
    tell("all recordings together")
    owns, unrest = [_pairs(one.own) for one in alone], np.array([one.unrest for one in alone])
    evidence = gather(recordings, vehicle, tell, seed, knocked_out, owns, unrest, elsewhere=apart)
    found = search(evidence, ready(vehicle, evidence.effects), tell)
    found = replace(found, taken=_doubted(found.taken, [one.own for one in alone]))
    alone = _told_elsewhere(alone, vehicle)
    alone = [_resettled(one, vehicle, found.taken) for one in alone]
    alone = [replace(one, own=tuple(_told_apart(each, evidence, found) for each in one.own)) for one in alone]
    shown = _proof(evidence, alone, vehicle, found.taken, tell) if proven else holdout.Proof()
    plain = replace(found.evidence, replayers=tuple(Replayer(one.recording) for one in evidence.replayers))
    taken = (*found.taken, *_means([one.own for one in alone]))
    advice = one_flight.advised(evidence, vehicle, found, recordings[0], tell)
    repaired, pairs = one_flight.repair(vehicle, found.taken), [_pairs(one.own) for one in alone]
    left = {}
    if proven and taken:
        tell(one_flight.AGAIN)
        left = one_flight.remaining(recordings, repaired, seed, knocked_out, pairs, unrest, loop_of(vehicle), apart)
    return one_flight.Diagnosis(
        _report(recordings, evidence, alone, found, shown, advice, left),
        one_flight.repair(vehicle, taken),
        taken,
        plain,
        shown,
        found.unknown,
        tuple(one.own for one in alone),
    )


def comparable(recordings, tell):
    """Return the recordings with what all of them have, and without their gates in images unless all have them by the
    same camera and map: what is fitted to all of them together must be compared in all of them. Raises UsageError where
    they have nothing in common that a simulation can be held against."""
    shared = set.intersection(*(set(one.channels) for one in recordings))
    if not shared & {*USED, "motor_command"}:
        raise UsageError(
            f"{', '.join(one.name for one in recordings)}: nothing that all of them hold can be compared; "
            f"record in each {ENOUGH}"
        )
    dropped = {name for one in recordings for name in one.channels} - shared
    seen = [one.seen for one in recordings]
    alike = all(seen) and all((one.camera, one.track) == (seen[0].camera, seen[0].track) for one in seen)
    if dropped or (any(seen) and not alike):
        columns = [column for name in CHANNELS if name in dropped for column in CHANNELS[name].columns]
        gates = [] if alike or not any(seen) else ["gates in images"]
        tell(f"left out, as not all recordings can show it: {', '.join([*columns, *gates])}")
    return [replace(one, seen=one.seen if alike else None) for one in _with(shared, recordings)]


def _with(names: set, recordings) -> list:
    """Return the recordings with these channels alone."""
    return [
        replace(one, channels={name: samples for name, samples in one.channels.items() if name in names})
        for one in recordings
    ]


def _alone(table, vehicle: Vehicle, tell, seed: int, knocked_out, apart) -> Alone:
    evidence, found, unrest = one_flight.informed([table], vehicle, tell, seed, knocked_out)
    return Alone(evidence, tuple(one for one in found.taken if one.effect.id in apart), unrest)


def _pairs(taken) -> tuple:
    return tuple((one.effect, one.values) for one in taken)


def _doubted(shared: tuple[Taken, ...], owns) -> tuple[Taken, ...]:
    """Return what recordings share, none of it sure where it and what any of them has to itself (gusts not counted) are
    many: several neighbours together may stand for one cause that has none."""
    most = max(sum(own.effect.id != "gust" for own in owned) for owned in owns)
    return tuple(replace(one, sure=one.sure and len(shared) + most < model_comparison.MANY) for one in shared)


def _resettled(one: Alone, vehicle: Vehicle, shared: tuple[Taken, ...]) -> Alone:
    """Return a recording's own with the values that they have beside what all recordings share; of gusts, which no fit
    finds, as they were."""
    fitted = {own.effect.key: own for own in one.own if own.effect.id != "gust"}
    if not fitted:
        return one
    base = one_flight.repair(vehicle, shared)
    effects, begun = [own.effect for own in fitted.values()], {key: own.values for key, own in fitted.items()}
    values, covariance = settle(one.evidence, ready(base, one.evidence.effects), effects, begun)
    settled = {key: replace(own, values=values[key], covariance=covariance[key]) for key, own in fitted.items()}
    return replace(one, own=tuple(settled.get(own.effect.key, own) for own in one.own))


def _told_elsewhere(alone: list[Alone], vehicle: Vehicle) -> list[Alone]:
    """Return recordings in which what one leaves open among look-alikes is the one that another names beyond doubt: how
    much an instrument errs changes from flight to flight, in which way hardly."""
    sure = {own.effect.key: own.effect for one in alone for own in one.own if len(own.alike) == 1}

    def told(own: Taken) -> Taken:
        named = [key for key in own.alike if key in sure]
        if len(own.alike) == 1 or len(named) != 1:
            return own
        effect, key = sure[named[0]], named[0]
        return replace(own, effect=effect, values=start(effect, vehicle) + own.changes[key], alike={key: 1.0})

    def each_once(owned) -> tuple[Taken, ...]:
        found: dict[str, Taken] = {}
        for own in owned:
            found.setdefault(own.effect.key, own)
        return tuple(found.values())

    return [replace(one, own=each_once(told(own) for own in one.own)) for one in alone]


def _told_apart(own: Taken, evidence: Evidence, found: Found) -> Taken:
    """Return what a flight has to itself without look-alikes that all flights have or none has, and which all of them
    together would show but do not."""
    taken, slices = {one.effect.key for one in found.taken}, evidence.nulls.slices
    least = steps(evidence.effects) * evidence.nulls.detectable

    def denied(key: str) -> bool:
        shared = key in slices and key not in taken
        return shared and bool(np.any(np.abs(own.changes[key]) > SURE * least[slices[key]]))

    kept = {key: weight for key, weight in own.alike.items() if not denied(key)}
    return replace(own, alike={key: weight / sum(kept.values()) for key, weight in kept.items()})


def _means(owns) -> tuple[Taken, ...]:
    """Return what recordings have to themselves as the vehicle file can hold it: the mean over all that call for it."""
    found = {}
    for own in (own for owned in owns for own in owned if own.effect.id not in AIR):
        found.setdefault(own.effect.key, []).append(own)
    return tuple(
        replace(
            some[0],
            values=np.mean([one.values for one in some], axis=0),
            covariance=np.mean([one.covariance for one in some], axis=0) / len(some),
            sigma=max(one.sigma for one in some),
        )
        for some in found.values()
    )


def _proof(evidence: Evidence, alone: list[Alone], vehicle: Vehicle, shared, tell) -> holdout.Proof:
    """Return the errors on the unseen part of each recording, with what all share and what it has to itself, both
    fitted on the rest."""
    tell(one_flight.BEFORE_AND_AFTER)
    effects = [one.effect for one in shared]
    values = (
        settle(evidence, vehicle, effects, {one.effect.key: one.values for one in shared}, holdout.LEARNT_SHARE)[0]
        if shared
        else {}
    )
    parts = []
    for one in (one for one in alone if shared or one.own):
        after, own = injected(vehicle, effects, values), [own.effect for own in one.own]
        if own:
            settled, _ = settle(
                one.evidence,
                ready(after, one.evidence.effects),
                own,
                {each.effect.key: each.values for each in one.own},
                holdout.LEARNT_SHARE,
            )
            after = injected(after, own, settled)
        parts.append(holdout.held_out(one.evidence.replayers, vehicle, after, [*effects, *own]))
    return holdout.Proof(_mean_entry([part.entry for part in parts]), sum((part.courses for part in parts), ()))


def _mean_entry(entries: list[dict]) -> dict:
    """Return nested root mean squares over recordings, each of those that have it: a short one may have no rollouts."""
    keys = dict.fromkeys(key for entry in entries for key in entry)
    return {key: _mean([entry[key] for entry in entries if key in entry]) for key in keys}


def _mean(values: list):
    """Return what values of one entry have in common: a unit, the root mean square of errors, or an entry of these."""
    if isinstance(values[0], dict):
        return _mean_entry(values)
    return values[0] if isinstance(values[0], str) else float(np.sqrt(np.mean(np.square(values))))


def _least(entries: list[dict]) -> dict:
    """Return what is told of flights one by one, entries of `minimum_detectable`, by the one that tells it best."""
    found = {}
    for name, sizes in (item for entry in entries for item in entry.items()):
        known = found.setdefault(name, {})
        known.update({parameter: min(size, known.get(parameter, size)) for parameter, size in sizes.items()})
    return found


def _report(
    recordings, evidence: Evidence, alone: list[Alone], found: Found, shown: holdout.Proof, advice, left
) -> dict:
    """Return the content of report.json: the findings of all, then those of single recordings, which name theirs."""
    content = report.content(evidence, found, shown.entry, advice, left)
    findings = list(content["findings"])
    for table, one in zip(recordings, alone, strict=True):
        findings += [{**report.finding(own, one.evidence, {}), "recording": table.name} for own in one.own]
    tested = evidence.effects or any(one.evidence.effects for one in alone)
    verdict = max(
        (one["verdict"] for one in findings),
        key=report.GRAVITY_OF.index,
        default="nothing_left_out" if tested else "not_testable",
    )
    told, untold = _least([report.minimum_detectable(one.evidence) for one in alone]), {}
    for one in alone:
        untold |= {name: reason for name, reason in one.evidence.untold.items() if name not in told}
    return content | {
        "verdict": verdict,
        "findings": findings,
        "minimum_detectable": told | content["minimum_detectable"],
        "not_testable": dict(sorted((untold | content["not_testable"]).items())),
    }
