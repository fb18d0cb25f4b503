"""The whole diagnosis: recordings and the vehicle file that should explain them, to a report."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import numpy as np

from swift_ros.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import (
    air,
    bench,
    check,
    command,
    detector,
    doubt,
    estimate,
    features,
    manoeuvres,
    nulls,
    prove,
    select,
    spun,
    surrogates,
    twins,
    unknown,
)
from swift_sim_bridge.gap.effect import Effect, start
from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.estimate import injected, settle
from swift_sim_bridge.gap.evidence import Evidence, Found, Taken
from swift_sim_bridge.gap.footprints import (
    Linearisation,
    least_noise,
    linearise,
    linearise_all,
    ready,
    slices,
    steps,
    variants_of,
)
from swift_sim_bridge.gap.residuals import Replayer
from swift_sim_bridge.gap.unknown import Term

TWINS = 24
ROUNDS = 8
MANY = 3  # names at once: several neighbours together may stand for one cause that has none
WEAK = 2.0  # times its threshold: a name that gains less is tentative


@dataclass(frozen=True)
class Diagnosis:
    """report: the content of report.json; vehicle: the repaired one; taken: what was taken in; evidence; proof: what
    it is worth where no fit has seen the flights; unknown: what is left that no name explains; own: what each of
    several recordings has to itself, of which `taken` and `vehicle` hold the mean."""

    report: dict
    vehicle: Vehicle
    taken: tuple[Taken, ...]
    evidence: Evidence
    proof: prove.Proof
    unknown: tuple[Term, ...] = ()
    own: tuple[tuple[Taken, ...], ...] = ()


def diagnose(recordings: list[FlightTable], vehicle: Vehicle, tell: Callable[[str], None] = print,
             seed: int = 0, knocked_out: tuple[str, ...] = (), proven: bool = True) -> Diagnosis:
    """Return what the vehicle file leaves out of these recordings of one vehicle.

    tell: hears of the progress; seed: of the twins' chance; knocked_out: effects to leave out of the catalogue;
    proven: with the errors before and after on what no fit has seen, a third of the work.
    Raises UsageError for recordings that cannot be used.
    """
    from swift_sim_bridge.gap import report, several

    with jax.enable_x64(True):
        if len(recordings) > 1:
            return several.diagnose(recordings, vehicle, tell, seed, knocked_out, proven)
        evidence, found, unrest = informed(recordings, vehicle, tell, seed, knocked_out)
        advice = advised(evidence, vehicle, found, recordings[0], tell)
        shown = proof(evidence, vehicle, found.taken, tell) if proven else prove.Proof()
        repaired = repair(vehicle, found.taken)
        left = remaining(recordings, repaired, tell, seed, knocked_out, unrest=unrest) if proven and found.taken else {}
        content = report.content(evidence, found, shown.entry, advice, left)
        return Diagnosis(content, repaired, found.taken, evidence, shown, found.unknown)


def informed(recordings, vehicle: Vehicle, tell, seed: int, knocked_out) -> tuple[Evidence, Found, np.ndarray]:
    """Return the evidence of one recording, what it calls for, and what pushes its twins (see `twins.fly`).

    They must be pushed by chance as the recording was: a loop that answers makes its answer look like an effect.
    """
    evidence = gather(recordings, vehicle, tell, seed, knocked_out)
    found = search(evidence, ready(vehicle, evidence.effects), tell)
    air_of_day = ()
    if blown := air.gusts(evidence, ready(vehicle, evidence.effects), found):
        tell(f"{blown.effect.key}: {blown.sigma:.1f} standard deviations; what else is named must exceed them")
        air_of_day = (blown,)
        evidence = gather(recordings, repair(vehicle, air_of_day), tell, seed, knocked_out)
        found = search(evidence, ready(vehicle, evidence.effects), tell)
    unrest = estimate.pushed(evidence, ready(repair(vehicle, found.taken), evidence.effects))
    if np.any(unrest):
        tell("chance pushes it more than its twins: flying them again, pushed as much")
        evidence = gather(recordings, repair(vehicle, air_of_day), tell, seed, knocked_out, unrest=unrest)
        found = search(evidence, ready(vehicle, evidence.effects), tell)
    return evidence, Found((*found.taken, *air_of_day), found.unknown), unrest


def remaining(recordings, repaired: Vehicle, tell, seed: int, knocked_out, owns=None, unrest=twins.CALM) -> dict:
    """Return what the repaired vehicle still leaves out: verdict and findings, as the report has them. owns: what each
    recording has to itself; unrest: see `gather`."""
    from swift_sim_bridge.gap import report

    tell("diagnosing again, with the repaired vehicle")
    evidence = gather(recordings, repaired, lambda _: None, seed, knocked_out, owns, unrest)
    found = search(evidence, ready(repaired, evidence.effects), lambda _: None)
    content = report.content(evidence, found, {}, {}, {})
    return {key: content[key] for key in ("verdict", "findings")}


def advised(evidence: Evidence, vehicle: Vehicle, found: Found, table: FlightTable, tell) -> dict:
    """Return by key of each effect that has look-alikes what to fly to tell them apart, None where nothing helps."""
    effects, advice = {effect.key: effect for effect in evidence.effects}, {}
    for one in (one for one in found.taken if len(one.alike) > 1):
        tell(f"{' or '.join(one.alike)}: trying which manoeuvre tells them apart")
        rivals = [one.effect if key == one.effect.key else effects[key] for key in one.alike]
        weights = evidence.sigmas[0], evidence.nulls.copies(one.effect.key)
        advice[one.effect.key] = manoeuvres.advice(rivals, one.changes, vehicle, table, weights)
    return advice


def proof(evidence: Evidence, vehicle: Vehicle, taken: tuple[Taken, ...], tell) -> prove.Proof:
    """Return the errors on the part of the flights that a fit of what was taken in has not seen; an empty proof where
    nothing was taken in, or nothing can be flown on."""
    if not taken or not all(one.recording.has("p_world", "q_world_body", "gyro_body", "specific_force_body",
                                              "rotor_speed") for one in evidence.replayers):
        return prove.Proof()
    tell("flying on from the recorded states, before and after")
    effects = [one.effect for one in taken]
    values = {one.effect.key: one.values for one in taken}
    values, _ = settle(evidence, vehicle, effects, values, prove.LEARNT_SHARE)
    return prove.held_out(evidence.replayers, vehicle, injected(vehicle, effects, values), effects)


def gather(recordings: list[FlightTable], vehicle: Vehicle, tell, seed: int = 0, knocked_out=(), owns=None,
           unrest=twins.CALM) -> Evidence:  # fmt: skip
    """Return what the search works on: recordings on their grids, twins flown and put through the same pipeline. owns:
    what each recording has to itself (see `Replayer`); unrest: what pushes the twins (see `twins.fly`)."""
    read = [check.read(spun.completed(table, vehicle), vehicle) for table in recordings]
    replayers = [Replayer(one, own) for one, own in zip(read, owns or [()] * len(read), strict=True)]
    known_effects, untold = testable(vehicle, read)
    effects = tuple(effect for effect in known_effects if effect.id not in knocked_out)
    removed = tuple(effect for effect in known_effects if effect.id in knocked_out)
    own = slices(effects)
    variants = variants_of(vehicle, effects, central=False)
    parts, seen, blown, moving, others = [], [], [], [], {}
    for table, replayer in zip(recordings, replayers, strict=True):
        tell(f"{table.name}: flying {TWINS} nominal twins")
        recorded = linearise(replayer, variants, central=False)
        flown = twin_replayers(table, replayer, vehicle, seed, recorded, unrest)
        lines = linearise_all(flown, variants)
        known = [one.values for one in features.of(replayer, variants.vehicles[0])]
        lines = surrogates.completed(lines, recorded, known, seed)
        parts.append(nulls.population(lines, own, least_noise(lines, replayer.channels)))
        if "wind" in own:
            blown += [air.of_twin(twin, line, own["wind"], parts[-1].sigma)
                      for twin, line in zip(flown, lines, strict=True)]
            others |= air.detectable(replayer, recorded, own["wind"], parts[-1].sigma)
        if removed:
            others |= least_of(removed, vehicle, flown, replayer, known, seed)
        moving.append(np.mean([nulls.unrest(line) for line in lines], axis=0))
        seen.append([(twin, replace(line, columns=line.columns[:0])) for twin, line in zip(flown, lines, strict=True)])
    noises, sigmas = (tuple(getattr(part, name) for part in parts) for name in ("noise", "sigma"))
    known = unknown.library(tuple(replayers), seen, variants.vehicles[0], sigmas)
    draughts, gusts = (np.array(part) for part in zip(*blown, strict=True)) if blown else (None, np.inf)
    return Evidence(tuple(replayers), nulls.of_recordings(parts), noises, sigmas, effects, untold, known,
                    tuple(moving), draughts if "local_draught" not in knocked_out else None,
                    float(np.max(gusts)) if "gust" not in knocked_out else np.inf, others)


def least_of(effects: tuple[Effect, ...], vehicle: Vehicle, flown: list[Replayer], replayer: Replayer, known, seed: int
             ) -> dict:  # fmt: skip
    """Return the smallest sizes of effects that a recording could show, for those that no search will look for. flown:
    its twins; known: see `surrogates.completed`."""
    variants = variants_of(vehicle, effects, central=False)
    lines = linearise_all(flown, variants)
    lines = surrogates.completed(lines, linearise(replayer, variants, central=False), known, seed)
    seen = nulls.population(lines, slices(effects), least_noise(lines, replayer.channels))
    return nulls.least_sizes(effects, seen)


def twin_replayers(table: FlightTable, replayer: Replayer, vehicle: Vehicle, seed: int, recorded: Linearisation,
                   unrest=twins.CALM) -> list[Replayer]:  # fmt: skip
    """Return nominal twins of a recording, as recorded. recorded: the recording's own residuals and footprints; unrest:
    see `twins.fly`."""
    if replayer.recording.has("p_world", "q_world_body", "gyro_body"):
        path = twins.path_of(replayer.recording, twins.step_of(table), TWINS, seed)
        traces = twins.fly(vehicle, path, vehicle.sensors.get("gyro_rad_s", 0.0), seed, unrest)
        tables = twins.tables_of(traces, path, table, vehicle, seed)
        if replayer.recording.sightings:
            tables = detector.with_gates(tables, traces, path.t, vehicle, replayer, recorded, seed)
    else:
        tables = bench.tables(table, replayer.recording, vehicle, TWINS, seed)
    return [Replayer(check.read(spun.completed(one, vehicle), vehicle)) for one in tables]


def testable(vehicle: Vehicle, recordings) -> tuple[tuple[Effect, ...], dict[str, str]]:
    """Return the effects that the recordings' channels can show, and why others cannot."""
    from swift_sim_bridge.gap.effects import NOT_COVERED

    found, untold, known = [], dict(NOT_COVERED), catalogue(vehicle, gates_of(recordings))
    for effect in known:
        missing = [name for name in effect.channels if not all(one.has(name) for one in recordings)]
        if effect.layer == "command" and missing:
            untold[effect.id] = next(one.line for one in recordings if not one.heard)
        elif effect.layer == "camera" and missing:
            untold[effect.id] = "the recording has no gates in images, or no pose from where they were seen"
        elif missing:
            untold[effect.id] = f"the recording lacks {', '.join(missing)}"
        else:
            found.append(effect)
    known = {effect.id for effect in known}
    untold |= {name: "the vehicle file has nothing that it could change" for name in ("drag_center", "wind", "gust",
                                                                                      "local_draught")
               if name not in known and ("wind" not in known or name == "drag_center")}
    return tuple(found), untold


def gates_of(recordings) -> int:
    """Return how many gates the map has that recordings share; one where there is no map, as an example."""
    maps = [one.sightings.track for one in recordings if one.sightings]
    return len(maps[0].gates) if maps else 1


def search(evidence: Evidence, vehicle: Vehicle, tell) -> Found:
    """Return what the recordings call for: effects, as long as they are worth more than an equation, and what is left
    beside them. vehicle: with all effects' terms."""
    keys, values = names(evidence, vehicle, [], {}, tell)
    rougher = estimate.as_rough(evidence, vehicle, keys, values)
    if rougher is not evidence:
        evidence = rougher
        keys, values = names(evidence, vehicle, *pruned(evidence, vehicle, keys, values), tell)
    evidence, keys, values = air.with_draught(evidence, vehicle, keys, values, tell)
    account = doubt.best_account(evidence, vehicle, keys, values, tell)
    if len(account.keys) < len(keys):  # what stood beside a wrong name may have been there because of it
        keys, values = pruned(evidence, vehicle, list(account.keys), account.values)
        account = doubt.best_account(evidence, vehicle, keys, values, tell)
    if not account.keys:
        return Found((), account.terms)
    effects = {effect.key: effect for effect in evidence.effects}
    keys, values = list(account.keys), account.values
    scene = estimate.scene_at(evidence, vehicle, effects, keys, values)
    _, covariance = settle(evidence, vehicle, [effects[one] for one in keys], values)
    found = []
    for key in keys:
        others = [one for one in keys if one != key]
        _, sigma = select.passes(scene, others, key)
        alike = select.look_alikes(scene, keys, key, _excluded(others, effects))
        changes = changes_of(scene, others, alike, effects) | {key: values[key] - start(effects[key], vehicle)}
        certain = len(keys) < MANY and key not in account.doubtful and not account.terms
        strong = scene.gain(keys) - scene.gain(others) > WEAK * evidence.nulls.threshold(key)
        if effects[key].layer == "camera":  # seconds scatter less than a detector's bias, which a view keeps
            covariance[key] = widened(scene, keys, effects[key])
        if effects[key].layer == "command":
            lines = [one.recording.heard for one in evidence.replayers]
            covariance[key][0, 0] += command.by_chance(effects[key].id, values[key], lines)
        found.append(Taken(effects[key], values[key], covariance[key], sigma, alike, changes,
                           strong and certain))
    return Found(tuple(sorted(found, key=lambda one: -one.sigma)), account.terms)


def widened(scene, keys: list[str], effect: Effect) -> np.ndarray:
    """Return the covariance (k, k) of one of several effects, at least as wide as twins scatter it."""
    rows, own, size = scene.rows(keys), scene.slices[effect.key], steps((effect,))
    inside = (rows >= own.start) & (rows < own.stop)
    wide = select.fit(scene.whole, rows, scene.nulls.copies(effect.key)).covariance
    return wide[np.ix_(inside, inside)] * np.outer(size, size)


def changes_of(scene, others: list[str], alike, effects) -> dict:
    """Return by key what each of several effects would change of its parameters (k,) in the place of one."""
    found = {}
    for key in alike:
        size = scene.slices[key].stop - scene.slices[key].start
        fitted = select.fit(scene.sums, scene.rows([*others, key]))
        found[key] = fitted.sizes[-size:] * steps((effects[key],))
    return found


def pruned(evidence: Evidence, vehicle: Vehicle, keys, values) -> tuple[list[str], dict]:
    """Return those of the names, with their values, that the evidence still calls for."""
    effects = {effect.key: effect for effect in evidence.effects}
    if not keys:
        return keys, values
    scene = estimate.scene_at(evidence, vehicle, effects, keys, values)
    kept = [key for key in select.backward(scene, keys) if len(keys) > 1 or select.passes(scene, [], key)[0]]
    values = {key: values[key] for key in kept}
    return kept, settle(evidence, vehicle, [effects[key] for key in kept], values)[0] if kept else {}


def names(evidence: Evidence, vehicle: Vehicle, keys, values, tell) -> tuple[list[str], dict]:
    """Return the effects, by key, that the recordings call for one after the other beside `keys`, and their values."""
    effects = {effect.key: effect for effect in evidence.effects}
    keys = list(keys)
    dropped: set[str] = set()
    seen: set[frozenset] = set()
    for _ in range(ROUNDS):
        scene = estimate.scene_at(evidence, vehicle, effects, keys, values)
        key, sigma = select.forward(scene, keys, _excluded(keys, effects) | dropped)
        if key is None:
            old, key = _exchanged(scene, keys, effects)
            if key is None or frozenset(keys) in seen:
                break
            tell(f"{key} in the place of {old}")
            seen.add(frozenset(keys))
            keys.remove(old)
        else:
            tell(f"{key}: {sigma:.1f} standard deviations")
        keys.append(key)
        values, _ = settle(evidence, vehicle, [effects[one] for one in keys], values)
        scene = estimate.scene_at(evidence, vehicle, effects, keys, values)
        kept = select.backward(scene, keys)
        if len(kept) < len(keys):
            gone = set(keys) - set(kept)
            tell(f"{', '.join(gone)}: superfluous now")
            dropped |= gone if key in gone else set()
            keys = kept
            values = {one: values[one] for one in kept}
            values, _ = settle(evidence, vehicle, [effects[one] for one in keys], values)
    return keys, values


def _exchanged(scene, keys: list[str], effects) -> tuple[str | None, str | None]:
    """Return which of the effects taken should give its place to which other, None where none should."""
    found = []
    for key in keys:
        others = [one for one in keys if one != key]
        rival, by = select.better(scene, others, key, _excluded(others, effects))
        found += [(by, key, rival)] if rival else []
    return max(found)[1:] if found else (None, None)


def _excluded(keys: list[str], effects) -> set[str]:
    """Return the effects that cannot stand beside those taken: other variants of the same one."""
    ids = {effects[key].id for key in keys}
    return {key for key, effect in effects.items() if effect.exclusive and effect.id in ids}


def repair(vehicle: Vehicle, taken: tuple[Taken, ...]) -> Vehicle:
    """Return the vehicle with what was taken in."""
    return injected(vehicle, [one.effect for one in taken], {one.effect.key: one.values for one in taken})
