"""The whole diagnosis: recordings and the vehicle file that should explain them, to a report."""

from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import numpy as np

from swift_ros.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import check, nulls, prove, select, twins
from swift_sim_bridge.gap.effects import Effect, catalogue, inject, start
from swift_sim_bridge.gap.footprints import Sums, joined, linearise, slices, steps, sums_of, variants_of
from swift_sim_bridge.gap.residuals import Replayer

TWINS = 24
ROUNDS = 8
STEADY = 0.1  # of a standard error: the fit has settled
SETTLING = 6


@dataclass(frozen=True)
class Evidence:
    """Replayers of the recordings, the null population, noise and sigma (c,) of each recording's residuals, the effects
    that can be told, and why the others cannot."""

    replayers: tuple[Replayer, ...]
    nulls: nulls.Nulls
    noises: tuple[np.ndarray, ...]
    sigmas: tuple[np.ndarray, ...]
    effects: tuple[Effect, ...]
    untold: dict[str, str]


@dataclass(frozen=True)
class Taken:
    """An effect that was taken in: its parameters (k,), their covariance (k, k), significance in standard deviations,
    and all that could stand in for it with their weights, itself included."""

    effect: Effect
    values: np.ndarray
    covariance: np.ndarray
    sigma: float
    alike: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Diagnosis:
    """report: the content of report.json; vehicle: the repaired one; taken: what was taken in; evidence; proof: what
    it is worth where no fit has seen the flights."""

    report: dict
    vehicle: Vehicle
    taken: tuple[Taken, ...]
    evidence: Evidence
    proof: prove.Proof


def diagnose(recordings: list[FlightTable], vehicle: Vehicle, tell: Callable[[str], None] = print,
             seed: int = 0, knocked_out: tuple[str, ...] = ()) -> Diagnosis:
    """Return what the vehicle file leaves out of these recordings of one vehicle.

    tell: hears of the progress; seed: of the twins' chance; knocked_out: effects to leave out of the catalogue.
    Raises UsageError for recordings that cannot be used.
    """
    from swift_sim_bridge.gap import report

    with jax.enable_x64(True):
        evidence = gather(recordings, vehicle, tell, seed, knocked_out)
        taken = search(evidence, vehicle, tell)
        shown = proof(evidence, vehicle, taken, tell)
        return Diagnosis(report.content(evidence, taken, shown.entry), repair(vehicle, taken), taken, evidence, shown)


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


def gather(recordings: list[FlightTable], vehicle: Vehicle, tell, seed: int = 0, knocked_out=()) -> Evidence:
    """Return what the search works on: recordings on their grids, twins flown and put through the same pipeline."""
    read = [check.read(table, vehicle) for table in recordings]
    replayers = [Replayer(recording) for recording in read]
    effects, untold = testable(vehicle, read, knocked_out)
    own = slices(effects)
    variants = variants_of(vehicle, effects, central=False)
    parts = []
    for table, replayer in zip(recordings, replayers, strict=True):
        tell(f"{table.name}: flying {TWINS} nominal twins")
        lines = [linearise(twin, variants, central=False)
                 for twin in twin_replayers(table, replayer, vehicle, seed)]
        parts.append(nulls.population(lines, own))
    noises, sigmas = (tuple(getattr(part, name) for part in parts) for name in ("noise", "sigma"))
    return Evidence(tuple(replayers), nulls.of_recordings(parts), noises, sigmas, effects, untold)


def twin_replayers(table: FlightTable, replayer: Replayer, vehicle: Vehicle, seed: int) -> list[Replayer]:
    """Return nominal twins of a recording, as recorded."""
    path = twins.path_of(replayer.recording, twins.step_of(table), TWINS, seed)
    traces = twins.fly(vehicle, path, vehicle.sensors.get("gyro_rad_s", 0.0), seed)
    tables = twins.tables_of(traces, path, table, vehicle, seed)
    return [Replayer(check.read(one, vehicle)) for one in tables]


def testable(vehicle: Vehicle, recordings, knocked_out=()) -> tuple[tuple[Effect, ...], dict[str, str]]:
    """Return the effects that the recordings' channels can show, and why others cannot."""
    from swift_sim_bridge.gap.effects import NOT_COVERED

    found, untold = [], dict(NOT_COVERED)
    for effect in catalogue(vehicle):
        missing = [name for name in effect.channels if not all(one.has(name) for one in recordings)]
        if missing:
            untold[effect.id] = f"the recording lacks {', '.join(missing)}"
        elif effect.id not in knocked_out:
            found.append(effect)
    known = {effect.id for effect in catalogue(vehicle)}
    untold |= {name: "the vehicle file has nothing that it could change" for name in ("drag_center", "wind")
               if name not in known}
    return tuple(found), untold


def search(evidence: Evidence, vehicle: Vehicle, tell) -> tuple[Taken, ...]:
    """Return the effects that the recordings call for."""
    effects = {effect.key: effect for effect in evidence.effects}
    keys: list[str] = []
    values: dict[str, np.ndarray] = {}
    dropped: set[str] = set()
    for _ in range(ROUNDS):
        scene = scene_at(evidence, vehicle, effects, keys, values)
        key, sigma = select.forward(scene, keys, _excluded(keys, effects) | dropped)
        if key is None:
            break
        tell(f"{key}: {sigma:.1f} standard deviations")
        keys.append(key)
        values, _ = settle(evidence, vehicle, [effects[one] for one in keys], values)
        scene = scene_at(evidence, vehicle, effects, keys, values)
        kept = select.backward(scene, keys)
        if len(kept) < len(keys):
            gone = set(keys) - set(kept)
            tell(f"{', '.join(gone)}: superfluous now")
            dropped |= gone if key in gone else set()
            keys = kept
            values = {one: values[one] for one in kept}
            values, _ = settle(evidence, vehicle, [effects[one] for one in keys], values)
    if not keys:
        return ()
    scene = scene_at(evidence, vehicle, effects, keys, values)
    _, covariance = settle(evidence, vehicle, [effects[one] for one in keys], values)
    found = []
    for key in keys:
        others = [one for one in keys if one != key]
        _, sigma = select.passes(scene, others, key)
        alike = select.look_alikes(scene, keys, key, _excluded(others, effects))
        found.append(Taken(effects[key], values[key], covariance[key], sigma, alike))
    return tuple(sorted(found, key=lambda one: -one.sigma))


def _excluded(keys: list[str], effects) -> set[str]:
    """Return the effects that cannot stand beside those taken: other variants of the same one."""
    ids = {effects[key].id for key in keys}
    return {key for key, effect in effects.items() if effect.variant and effect.id in ids}


def scene_at(evidence: Evidence, vehicle: Vehicle, effects, keys, values) -> select.Scene:
    """Return what the selection sees: footprints at the vehicle with what was taken in, and to first order what would
    be left without that."""
    flown = injected(vehicle, [effects[key] for key in keys], values)
    all_effects = tuple(effects.values())
    sums = nulls.without_artefact(sums_at(evidence, flown, all_effects), evidence.nulls.artefact)
    own, size = slices(all_effects), steps(all_effects)
    for key in keys:
        rows = np.arange(own[key].start, own[key].stop)
        sums = select.without(sums, rows, (values[key] - start(effects[key], vehicle)) / size[rows])
    return select.Scene(sums, own, evidence.nulls)


def sums_at(evidence: Evidence, vehicle: Vehicle, effects: tuple[Effect, ...], share: float = 1.0) -> Sums:
    """Return the sums of the first `share` of all recordings against a vehicle."""
    variants, found = variants_of(vehicle, effects), []
    for replayer, sigma in zip(evidence.replayers, evidence.sigmas, strict=True):
        sums = sums_of(linearise(replayer, variants), sigma)
        kept = int(np.ceil(share * len(sums.samples)))
        found.append(Sums(*(values[:kept] for values in vars(sums).values())))
    return joined(found)


def settle(evidence: Evidence, vehicle: Vehicle, effects: list[Effect], values: dict, share: float = 1.0):
    """Return values and covariances by key of these effects together, on the first `share` of each recording: Gauss
    and Newton's steps through inject."""
    values = {effect.key: values.get(effect.key, start(effect, vehicle)) for effect in effects}
    own, size = slices(tuple(effects)), steps(tuple(effects))
    for _ in range(SETTLING):
        flown = injected(vehicle, effects, values)
        found = select.fit(sums_at(evidence, flown, tuple(effects), share), np.arange(len(size)))
        for effect in effects:
            moved = values[effect.key] + (found.sizes * size)[own[effect.key]]
            low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
            values[effect.key] = np.clip(moved, low, high)
        if np.all(np.abs(found.sizes) < STEADY * np.sqrt(np.diag(found.covariance))):
            break
    covariance = found.covariance * np.outer(size, size)
    return values, {effect.key: covariance[own[effect.key], own[effect.key]] for effect in effects}


def injected(vehicle: Vehicle, effects: list[Effect], values: dict) -> Vehicle:
    """Return the vehicle with these effects at their values."""
    for effect in effects:
        vehicle = inject(vehicle, effect, values[effect.key])
    return vehicle


def repair(vehicle: Vehicle, taken: tuple[Taken, ...]) -> Vehicle:
    """Return the vehicle with what was taken in."""
    return injected(vehicle, [one.effect for one in taken], {one.effect.key: one.values for one in taken})
