"""What a search works on, gathered: recordings on their grids, beside nominal twins put through the same pipeline."""

from dataclasses import replace
from functools import partial

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import payload, wind
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.discovery import equation_search, features
from swift_sim_bridge.gap.effects.catalogue import NOT_COVERED, catalogue
from swift_sim_bridge.gap.effects.spec import Effect, inject
from swift_sim_bridge.gap.inference import null_distribution
from swift_sim_bridge.gap.inference.sensitivity import (
    Linearisation,
    least_noise,
    linearise,
    linearise_all,
    slices,
    variants_of,
)
from swift_sim_bridge.gap.nominal import closed_loop, corner_bootstrap, motors_only, phase_surrogates, rotor_speed_model
from swift_sim_bridge.gap.recording import recording as check
from swift_sim_bridge.gap.recording.channel_names import names_with_columns
from swift_sim_bridge.gap.recording.rate_pid import RatePid
from swift_sim_bridge.gap.report import effect_help
from swift_sim_bridge.gap.residuals.replayer import Replayer, Variants
from swift_sim_bridge.parallel import at_once

TWINS = 24
ENOUGH = (
    "a pose with the gyro (px .. qw, wx wy wz), or rotor speeds with motor commands (rotor_1 .., u_1 ..) or the "
    "pack's voltage (vbat)"
)  # to record, for something to be compared


def gather(
    recordings: list[FlightTable],
    vehicle: Vehicle,
    tell,
    seed: int = 0,
    knocked_out=(),
    owns=None,
    unrest=closed_loop.CALM,
    firmware: RatePid | None = None,
    elsewhere=(),
) -> Evidence:
    """Return what the search works on: recordings on their grids, twins flown and put through the same pipeline.

    knocked_out: effects to leave out, of which only the smallest sizes are told that would show; owns: what each
    recording has to itself (see `Replayer`); unrest (6,): what pushes the twins (see `twins.fly`), or (n, 6), those of
    each recording; firmware: see `check.read`; elsewhere: effects that are looked for in each recording by itself.
    """
    read = [check.read(rotor_speed_model.completed(table, vehicle), vehicle, firmware) for table in recordings]
    replayers = in_common([Replayer(one, own) for one, own in zip(read, owns or [()] * len(read), strict=True)], tell)
    known_effects, untold = testable(vehicle, read)
    absent = {*knocked_out, *elsewhere}
    effects = tuple(effect for effect in known_effects if effect.id not in absent)
    removed = tuple(effect for effect in known_effects if effect.id in absent.difference(elsewhere))
    own = slices(effects)
    variants = variants_of(vehicle, effects, central=False)
    parts, seconds, seen, blown, rough, moving, louder, others = [], [], [], [], [], [], [], {}
    pushes = np.broadcast_to(unrest, (len(recordings), len(closed_loop.CALM)))
    for table, replayer, push in zip(recordings, replayers, pushes, strict=True):
        tell(f"{table.name}: flying {TWINS} nominal twins")
        blowing = in_own_air(vehicle, replayer)
        recorded, moved = at_once(
            partial(linearise, replayer, variants), partial(fly_twins, table, replayer, blowing, seed, push)
        )
        flown, quiet = twin_replayers(table, replayer, vehicle, seed, recorded, moved)
        known = [one.values for one in features.of(replayer, variants)]
        lines, quiet_line = lines_of(flown, quiet, variants, recorded, known, seed)
        measured = recorded.good.mean() / max(np.mean([line.good.mean() for line in lines]), 1e-9)
        population = null_distribution.population(lines, own, least_noise(lines, replayer.channels), quiet_line)
        noise_m = closed_loop.sheet_of(table, vehicle).get("position_m", 0.0)
        population = phase_surrogates.with_pose_noise(
            population, table, replayer, recorded, vehicle, effects, noise_m, seed
        )
        parts.append(
            null_distribution.as_recorded(
                population, recorded, float(np.clip(measured, null_distribution.LEAST_TOLD, 1.0))
            )
        )
        if "wind" in own:
            sigma = parts[-1].sigma
            theirs = wind.scatter(lines, sigma, lines[0].t)  # which all twins share
            blown += [
                wind.of_twin(twin, line, own["wind"], sigma, theirs) for twin, line in zip(flown, lines, strict=True)
            ]
            rough.append(wind.scatter(lines, sigma, recorded.t))
            others |= wind.detectable(replayer, recorded, own["wind"], sigma, rough[-1])
        if removed:
            others |= least_of(removed, vehicle, flown, quiet, replayer, known, seed)
        seconds.append(null_distribution.seconds_of(recorded))
        moving.append(np.mean([null_distribution.unrest(line) for line in lines], axis=0))
        louder.append(max(1.0, _loudness(replayer) / np.mean([_loudness(twin) for twin in flown])))
        seen.append([(twin, replace(line, columns=line.columns[:0])) for twin, line in zip(flown, lines, strict=True)])
    noises, sigmas = (tuple(getattr(part, name) for part in parts) for name in ("noise", "sigma"))
    known = equation_search.library(tuple(replayers), seen, variants, sigmas)
    draughts, gusts = (np.array(part) for part in zip(*blown, strict=True)) if blown else (None, np.inf)
    return Evidence(
        tuple(replayers),
        null_distribution.of_recordings(parts, seconds),
        noises,
        sigmas,
        effects,
        untold,
        known,
        tuple(moving),
        tuple(louder),
        draughts if "local_draught" not in absent else None,
        float(np.max(gusts)) if "gust" not in absent else np.inf,
        rough[0] if rough else None,
        others,
        "payload" not in absent,
    )


def _loudness(replayer: Replayer) -> float:
    """Return the mean fourth power of the rotors' speeds: their noise is a share of it, and what that makes of thrusts
    and moments has a variance that goes by this."""
    recording = replayer.recording
    kept = recording.good & recording.flown
    return float(np.mean(recording.rotor_speed[kept] ** 4)) if recording.has("rotor_speed") and kept.any() else 1.0


def in_common(replayers: list[Replayer], tell) -> list[Replayer]:
    """Return the replayers with those residuals that all of them have. Raises UsageError where there are none."""
    for name in (one.recording.name for one in replayers if not one.channels):
        raise UsageError(f"{name}: nothing in it can be held against anything else; record {ENOUGH}")
    shared = set.intersection(*(set(one.groups.items()) for one in replayers))
    odd = {name for one in replayers for name in one.groups} - {name for name, _ in shared}
    if odd:
        tell(f"left out, as not all recordings can show it: {', '.join(sorted(odd))}")
    if not shared:
        raise UsageError(
            f"{', '.join(one.recording.name for one in replayers)}: nothing that all of them show can be "
            f"compared; record in each {ENOUGH}"
        )
    return [replace(one, without=frozenset(odd)) for one in replayers]


def in_own_air(vehicle: Vehicle, replayer: Replayer) -> Vehicle:
    """Return the vehicle in the gusts of a recording: a loop that answers them makes its answer look like an effect."""
    for effect, values in replayer.own:
        if effect.id == "gust":
            vehicle = inject(vehicle, effect, values)
    return vehicle


def lines_of(
    flown: list[Replayer], quiet: Replayer | None, variants: Variants, recorded: Linearisation, known, seed: int
) -> tuple[list[Linearisation], Linearisation | None]:
    """Return the linearisations of twins, and of the quiet one if there is one. recorded, known: see
    `surrogates.completed`."""
    lines = linearise_all([*flown, quiet] if quiet else flown, variants)
    lines = phase_surrogates.completed(lines, recorded, known, seed)
    return lines[: len(flown)], lines[-1] if quiet else None


def least_of(
    effects: tuple[Effect, ...],
    vehicle: Vehicle,
    flown: list[Replayer],
    quiet: Replayer | None,
    replayer: Replayer,
    known,
    seed: int,
) -> dict:
    """Return the smallest sizes of effects that a recording could show, for those that no search will look for. flown,
    quiet: its twins; known: see `surrogates.completed`."""
    variants = variants_of(vehicle, effects, central=False)
    recorded = linearise(replayer, variants)
    lines, quiet_line = lines_of(flown, quiet, variants, recorded, known, seed)
    seen = null_distribution.population(lines, slices(effects), least_noise(lines, replayer.channels), quiet_line)
    return null_distribution.least_sizes(effects, null_distribution.as_recorded(seen, recorded, 1.0))


def fly_twins(
    table: FlightTable, replayer: Replayer, vehicle: Vehicle, seed: int, unrest=closed_loop.CALM
) -> tuple[closed_loop.Path, list[closed_loop.Trace]] | None:
    """Return the path of nominal twins of a recording and how they moved, None for motors on a bench, which do not.
    unrest: see `twins.fly`."""
    if not replayer.recording.has("p_world", "q_world_body", "gyro_body"):
        return None
    path = closed_loop.path_of(replayer.recording, closed_loop.step_of(table), TWINS, seed)
    return path, closed_loop.fly(
        vehicle, path, closed_loop.sheet_of(table, vehicle).get("gyro_rad_s", 0.0), seed, unrest
    )


def twin_replayers(
    table: FlightTable, replayer: Replayer, vehicle: Vehicle, seed: int, recorded: Linearisation, flown
) -> tuple[list[Replayer], Replayer | None]:
    """Return nominal twins of a recording, as recorded, and the first of them without noise, None on a bench. recorded:
    the recording's own residuals and footprints; flown: see `fly_twins`."""
    if flown is None:
        found = motors_only.tables(table, replayer.recording, vehicle, TWINS, seed)
        return [_twin(one, vehicle, replayer) for one in found], None
    path, traces = flown
    found = closed_loop.tables_of(traces, path, table, vehicle, seed)
    found += closed_loop.tables_of(traces[:1], path, table, vehicle, seed, noisy=False)
    if replayer.recording.sightings:
        found = corner_bootstrap.with_gates(found, [*traces, traces[0]], path.t, vehicle, replayer, recorded, seed)
    *noisy, quiet = (_twin(one, vehicle, replayer) for one in found)
    return noisy, quiet


def _twin(table: FlightTable, vehicle: Vehicle, recorded: Replayer) -> Replayer:
    return Replayer(
        check.read(rotor_speed_model.completed(table, vehicle), vehicle, simulated=True), without=recorded.without
    )


def testable(vehicle: Vehicle, recordings) -> tuple[tuple[Effect, ...], dict[str, str]]:
    """Return the effects that the recordings' channels can show, and why others cannot."""
    found, untold, known = [], dict(NOT_COVERED), catalogue(vehicle, gates_of(recordings))
    for effect in known:
        missing = [name for name in effect.channels if not all(one.has(name) for one in recordings)]
        if effect.layer == "command" and missing:
            untold[effect.id] = _unheard(missing, recordings)
        elif effect.layer == "camera" and missing:
            untold[effect.id] = "the recording has no gates in images, or no pose from where they were seen"
        elif missing:
            untold[effect.id] = f"the recording lacks {names_with_columns(_unmeasured(missing, recordings))}"
        else:
            found.append(effect)
    part = next((part for part in payload.PARTS if part in untold), None)  # without which nobody knows a load
    if part:
        untold["payload"] = untold[part]
    if "wind" in untold:
        untold |= dict.fromkeys(("gust", "local_draught"), untold["wind"])
    return tuple(found), untold | effect_help.undragged({effect.id for effect in known})


def _unmeasured(missing, recordings) -> list[str]:
    """Return missing channels as what was not measured: motor commands that stand in for rotor speeds were, and those
    that a bag has of a faster loop are not all."""
    lacking = "motor_command"
    if any(one.skips_commands for one in recordings):
        lacking = "every_motor_command"
    if any(one.spun for one in recordings):
        lacking = "single_rotor_speeds"
    return [lacking if name == "motor_command" else name for name in missing]


def _unheard(missing, recordings) -> str:
    """Return why one of the recordings does not tell what became of its commands, or of its rate loop where that is
    missing."""
    reasons = [(one, one.loop if "rate_loop" in missing else one.line) for one in recordings]
    recording, reason = next((one, reason) for one, reason in reasons if isinstance(reason, str))
    start = "the recording lacks "
    if not reason.startswith(start):
        return reason
    return start + names_with_columns(_unmeasured(reason.removeprefix(start).split(", "), [recording]))


def gates_of(recordings) -> int:
    """Return how many gates the map has that recordings share; one where there is no map, as an example."""
    maps = [one.sightings.track for one in recordings if one.sightings]
    return len(maps[0].gates) if maps else 1
