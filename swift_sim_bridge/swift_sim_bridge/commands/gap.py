"""Find what the simulation left out: recordings against the vehicle file, layer by layer."""

import json
import os
from pathlib import Path

REPORT, PAGE, VEHICLE, TRACK, PICTURES = "report.json", "report.html", "vehicle.yaml", "track.yaml", "*.png"
SELF_TEST = "self_test.json"
OUT, SELF_TEST_OUT = Path("runs/gap"), Path("runs/gap-self-test")
MOST_SEEDS = 2**32


def command(subparsers) -> None:
    """Add the parser of `swiftros gap`."""
    parser = subparsers.add_parser("gap", help=__doc__, description=__doc__)
    parser.add_argument(
        "recordings",
        type=Path,
        nargs="*",
        metavar="RECORDING",
        help="a .csv or .parquet table, or a bag; several of one vehicle are one diagnosis",
    )
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="vehicle file (default: drone.yaml)")
    parser.add_argument(
        "--track",
        type=Path,
        metavar="FILE",
        help="track file, the map of the gates (default: the bag's own, or track.yaml where all its gates are flown)",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the twins' chance (default: %(default)s)")
    parser.add_argument("--list-effects", action="store_true", help="print the effects that are known, and stop")
    parser.add_argument("--explain", metavar="EFFECT", help="print what an effect is and what to fly, and stop")
    parser.add_argument(
        "--self-test",
        action="store_true",
        help="prove the installation: nominal flights say nothing, planted effects come back",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"(default: {OUT}; of --self-test {SELF_TEST_OUT})")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Diagnose, print what was found, write report.json, report.html with its pictures, vehicle.yaml, and track.yaml
    where the map is wrong. Return 0 for every verdict. With --self-test return 1 when one of its flights was not
    understood.

    Raises UsageError on bad input.
    """
    from swift_ros.configuration import configuration_folder, load, read_yaml
    from swift_ros.errors import UsageError
    from swift_ros.recording import flight_files
    from swift_ros.results import fresh_folder
    from swift_ros.track import Track
    from swift_ros.vehicle import Vehicle
    from swift_sim_bridge.gap.api import diagnose
    from swift_sim_bridge.gap.report import effect_help

    source = arguments.vehicle or configuration_folder() / "drone.yaml"
    vehicle = load(Vehicle, source)
    if arguments.list_effects or arguments.explain:
        print(effect_help.one(arguments.explain, vehicle) if arguments.explain else effect_help.table(vehicle))
        return 0
    if not 0 <= arguments.seed < MOST_SEEDS:
        raise UsageError(f"--seed is {arguments.seed}; give a whole number from 0 to {MOST_SEEDS - 1}")
    refuse_weak(vehicle, source)
    content = read_yaml(source)  # now: minutes later the file may be another
    out = arguments.out or (SELF_TEST_OUT if arguments.self_test else OUT)
    refuse_within(out, (source, arguments.track, *arguments.recordings))
    if arguments.self_test:
        if arguments.recordings or arguments.track or arguments.seed:
            raise UsageError("--self-test flies its own flights; leave out RECORDING, --track and --seed")
        return self_test(vehicle, fresh_folder(out, (SELF_TEST,)))
    if not arguments.recordings:
        raise UsageError("no recording is given; name one or more .csv or .parquet tables or bags")
    refuse_twice(arguments.recordings)
    track = load(Track, arguments.track) if arguments.track else None
    recordings = [by_map(flight_files.read(path), track) for path in arguments.recordings]
    recordings = told_apart(recordings, arguments.recordings)
    for one in recordings:
        print(described(one))
        for rejection in one.rejections:
            print(f"  left out {rejection}")
    ours = REPORT, PAGE, VEHICLE, TRACK, PICTURES
    if not holds_only(out, ours):
        fresh_folder(out, ours)  # a folder that cannot be had is refused now, not after minutes
    found = diagnose(recordings, vehicle, print, arguments.seed)
    track = track or track_of(found, recordings)
    write(found, content, vehicle, Path(source), [described(one) for one in recordings], fresh_folder(out, ours), track)
    return 0


def refuse_weak(vehicle, source) -> None:
    """Raise UsageError for a vehicle that cannot hover by its motor map: no twin of it flies."""
    from swift_ros.errors import UsageError

    full, hover, volts = vehicle.full_speed, vehicle.hover_speed, vehicle.battery.reference_voltage
    if full <= hover:
        raise UsageError(
            f"{source}: this vehicle cannot hover: at full command and {volts:g} V its motor map gives "
            f"{full:.0f} rad/s, hover takes {hover:.0f}; correct 'motor.map', 'thrust_coefficient' or "
            "'mass'"
        )


def refuse_within(out: Path, inputs) -> None:
    """Raise UsageError when an input, a path or None, lies in the folder of the results, which is emptied."""
    from swift_ros.errors import UsageError

    for path in filter(None, inputs):
        if out.resolve() in (path.resolve(), *path.resolve().parents):
            raise UsageError(f"{path} lies in {out}, which is emptied for the results; give another --out")


def refuse_twice(paths: list[Path]) -> None:
    """Raise UsageError when a recording is given twice: its samples would count twice."""
    from swift_ros.errors import UsageError

    known = set()
    for path in paths:
        if path.resolve() in known:
            raise UsageError(f"{path} is given twice; give each recording once")
        known.add(path.resolve())


def holds_only(out: Path, ours: tuple[str, ...]) -> bool:
    """Return whether there is a folder with what an earlier run left, and nothing else: it stays until there is
    something to write."""
    return out.is_dir() and all(any(path.match(pattern) for pattern in ours) for path in out.iterdir())


def by_map(table, track):
    """Return a recording whose gates in images are those of another map, if one is given."""
    from dataclasses import replace

    return replace(table, detected_gates=replace(table.detected_gates, track=track)) if table.detected_gates and track else table


def told_apart(recordings: list, paths: list[Path]) -> list:
    """Return the recordings, of which no two have one name: where some do, each has its path from where they part."""
    from dataclasses import replace

    if len({one.name for one in recordings}) == len(recordings):
        return recordings
    shared = os.path.commonpath([path.resolve().parent for path in paths])
    return [
        replace(one, name=path.resolve().relative_to(shared).as_posix())
        for one, path in zip(recordings, paths, strict=True)
    ]


def track_of(found, recordings):
    """Return the map that a recording noted, or else the configured track where the flights pass all its gates."""
    from swift_ros.configuration import configuration_folder, load
    from swift_ros.track import Track
    from swift_sim_bridge.gap.validation import localization

    if noted := next((one.detected_gates.track for one in recordings if one.detected_gates), None):
        return noted
    track = load(Track, configuration_folder() / "track.yaml")
    flown = {gate for one in found.evidence.residual_models for _, gate in localization.passages(one.recording, track)}
    return track if len(flown) == len(track.gates) else None


def self_test(vehicle, out: Path) -> int:
    """Print what came of each flight of the self-test, write self_test.json, return 0 when all are understood."""
    from dataclasses import asdict

    from swift_sim_bridge.gap import self_test as test

    found = []
    print(f"{test.NOMINAL} nominal flights, then {len(test.PLANTED)} with a planted effect each")
    for number, case in enumerate(test.cases(vehicle), start=1):
        print(f"{number:3} {case}", flush=True)
        found.append(case)
        result = {"vehicle": vehicle.name, "cases": [asdict(one) for one in found]}
        (out / SELF_TEST).write_text(json.dumps(result, indent=1) + "\n")
    wrong = sum(not case.good for case in found)
    print(
        f"{len(found) - wrong} of {len(found)} understood, {sum(case.seconds for case in found):.0f} s; "
        f"{out / SELF_TEST}"
    )
    return 1 if wrong else 0


def described(table) -> str:
    """Return what a recording holds, in a line."""
    from swift_sim_bridge.gap.recording.channel_names import names_with_columns

    begin, end = table.span_s
    gates = f", {len(table.detected_gates.t)} gates in images" if table.detected_gates else ""
    return f"{table.name}: {end - begin:.1f} s, {names_with_columns(table.channels)}{gates}"


def write(found, content: dict, vehicle, source: Path, recordings: list[str], out: Path, track=None) -> None:
    """Print a diagnosis and write its files. content, vehicle: of the file `source`; recordings: a line about each;
    track: whose gates the flights pass, or None."""
    import jax

    from swift_sim_bridge.gap.recording.betaflight_log import with_pid_gains
    from swift_sim_bridge.gap.report import effect_help, figures, html, repaired_files
    from swift_sim_bridge.gap.validation import localization, mismatch

    with jax.enable_x64(True):
        before = with_pid_gains(vehicle)  # as it was diagnosed
        report, shown = localization.locate_findings(found, before, track), mismatch.mismatches_of(found, before)
    print(html.text(report))
    (out / REPORT).write_text(json.dumps(report, indent=1) + "\n")
    (out / VEHICLE).write_text(repaired_files.text(content, found, source))
    written = [REPORT, PAGE, VEHICLE]
    if mended := repaired_files.track_text(found):
        (out / TRACK).write_text(mended)
        written.append(TRACK)
    pictures = figures.draw(shown, found.proof, out, track)
    (out / PAGE).write_text(html.html(report, source, recordings, pictures, effect_help.parameters(vehicle)))
    print(", ".join(str(out / name) for name in written))
