"""Find the physics that a simulation lacks, from recordings and the vehicle file, layer by layer."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

REPORT, PAGE, VEHICLE, TRACK, PICTURES = "report.json", "report.html", "vehicle.yaml", "track.yaml", "*.png"
RESIDUALS = "residuals.npz"
OUTPUTS = REPORT, PAGE, VEHICLE, TRACK, PICTURES, RESIDUALS
SELF_TEST = "self_test.json"
OUT, SELF_TEST_OUT = Path("runs/gap"), Path("runs/gap-self-test")
SEEDS = 2**32  # a seed of the reference flights has 32 bits


@dataclass(frozen=True)
class DiagnosedFile:
    """The vehicle file of a diagnosis.

    Attributes:
        path: the file.
        content: its content, read before the diagnosis: minutes later the file may have changed.
        vehicle: the vehicle that it describes.
    """

    path: Path
    content: dict
    vehicle: object


@dataclass(frozen=True)
class Diagnosed:
    """The recordings of a diagnosis.

    Attributes:
        tables: the flights.
        paths: where they were read from.
    """

    tables: list
    paths: list[Path]


def command(subparsers) -> None:
    """Add the parser of `swiftros gap`."""
    parser = subparsers.add_parser("gap", help=__doc__, description=__doc__)
    parser.add_argument(
        "recordings",
        type=Path,
        nargs="*",
        metavar="RECORDING",
        help="a .csv or .parquet table, a bag, or a log of PX4 (.ulg) or ArduPilot (.bin); several recordings of one "
        "vehicle are diagnosed together",
    )
    parser.add_argument(
        "--unseen",
        type=Path,
        nargs="+",
        default=[],
        metavar="FLIGHT",
        help="other flights of the vehicle, on which the repaired file is compared with black-box models",
    )
    parser.add_argument("--mapping", type=Path, metavar="FILE", help="mapping of logs (default: a guess)")
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="vehicle file (default: drone.yaml)")
    parser.add_argument(
        "--track",
        type=Path,
        metavar="FILE",
        help="track file, the map of the gates (default: the bag's own, or track.yaml if the flights pass all its "
        "gates)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the reference flights (default: %(default)s)")
    parser.add_argument("--list-effects", action="store_true", help="print the effects of the catalogue, and stop")
    parser.add_argument(
        "--explain", metavar="EFFECT", help="print the equation of an effect and the flight that shows it, and stop"
    )
    parser.add_argument(
        "--self-test",
        action="store_true",
        help="test the installation: nominal flights give no finding, planted effects are identified",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"(default: {OUT}; with --self-test {SELF_TEST_OUT})")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Diagnose the recordings, print the findings, and write the report and the repaired files.

    The files are report.json, report.html with its pictures, residuals.npz, vehicle.yaml, and track.yaml if the map has
    errors.

    Returns:
        0 for every verdict; with --self-test 1 if a flight of the self-test fails.

    Raises:
        UsageError: the input cannot be used.
    """
    from swift_ros.configuration import configuration_folder, load_unchecked, read_yaml
    from swift_ros.errors import UsageError
    from swift_ros.results import fresh_folder
    from swift_ros.vehicle import Vehicle
    from swift_sim_bridge.compiled_code import keep_compiled_code
    from swift_sim_bridge.gap.report import effect_help

    source = arguments.vehicle or configuration_folder() / "drone.yaml"
    vehicle = load_unchecked(Vehicle, source)  # what is wrong in it is for the tool to find
    if arguments.explain:
        print(effect_help.describe_effect(arguments.explain, vehicle))
        return 0
    if arguments.list_effects:
        print(effect_help.effect_table(vehicle))
        return 0
    if not 0 <= arguments.seed < SEEDS:
        raise UsageError(f"--seed is {arguments.seed}; give a whole number from 0 to {SEEDS - 1}")
    refuse_weak(vehicle, source)
    keep_compiled_code()
    file = DiagnosedFile(Path(source), read_yaml(source), vehicle)
    out = arguments.out or (SELF_TEST_OUT if arguments.self_test else OUT)
    refuse_within(out, (source, arguments.track, arguments.mapping, *arguments.recordings, *arguments.unseen))
    if arguments.self_test:
        if arguments.recordings or arguments.unseen or arguments.track or arguments.seed:
            raise UsageError("--self-test flies its own flights; leave out RECORDING, --unseen, --track and --seed")
        return self_test(vehicle, fresh_folder(out, (SELF_TEST,)))
    return diagnose_recordings(arguments, file, out)


def diagnose_recordings(arguments, file: DiagnosedFile, out: Path) -> int:
    """Read the recordings, diagnose them and write the results to `out`; return 0."""
    from dataclasses import replace

    from swift_ros.configuration import load
    from swift_ros.errors import UsageError
    from swift_ros.recording import flight_files
    from swift_ros.recording.log_mapping.motor_order import refuse_another_order
    from swift_ros.results import fresh_folder
    from swift_ros.track import Track
    from swift_sim_bridge.gap.api import diagnose, predict_unseen

    if not arguments.recordings:
        raise UsageError("no recording is given; name one or more .csv or .parquet tables or bags")
    paths = [*arguments.recordings, *arguments.unseen]
    refuse_twice(paths)
    track = load(Track, arguments.track) if arguments.track else None
    flights = [with_map(flight_files.read(path, arguments.mapping), track) for path in paths]
    flights = with_unique_names(flights, paths)
    recordings, unseen = flights[: len(arguments.recordings)], flights[len(arguments.recordings) :]
    for one in flights:
        print(summary(one))
        for line in (*one.notes, *(f"left out {rejection}" for rejection in one.rejections)):
            print(f"  {line}")
        if one.motor_order:
            refuse_another_order(one.name, one.motor_order, file.vehicle, one.motor_columns)
    if not holds_only(out, OUTPUTS):
        fresh_folder(out, OUTPUTS)  # a folder that cannot be written is refused now, not after minutes
    diagnosis = diagnose(recordings, file.vehicle, print, arguments.seed)
    if unseen:
        predicted = predict_unseen(diagnosis, file.vehicle, unseen)
        diagnosis = replace(diagnosis, report={**diagnosis.report, "unseen_flights": predicted})
    track = track or track_of(diagnosis, recordings)
    write(diagnosis, file, Diagnosed(recordings, arguments.recordings), fresh_folder(out, OUTPUTS), track)
    return 0


def refuse_weak(vehicle, source) -> None:
    """Raise UsageError for a vehicle that cannot hover by its motor map: it cannot fly reference flights."""
    from swift_ros.errors import UsageError

    full, hover, volts = vehicle.full_speed, vehicle.hover_speed, vehicle.battery.reference_voltage
    if full <= hover:
        raise UsageError(
            f"{source}: this vehicle cannot hover: at full command and {volts:g} V its motor map gives "
            f"{full:.0f} rad/s, hover takes {hover:.0f}; correct 'motor.map', 'thrust_coefficient' or "
            "'mass'"
        )


def refuse_within(out: Path, inputs) -> None:
    """Raise UsageError if an input, a path or None, lies in the folder of the results, which is emptied."""
    from swift_ros.errors import UsageError

    for path in filter(None, inputs):
        if out.resolve() in (path.resolve(), *path.resolve().parents):
            raise UsageError(f"{path} lies in {out}, which is emptied for the results; give another --out")


def refuse_twice(paths: list[Path]) -> None:
    """Raise UsageError if a recording is given twice: its samples would count twice, or not be unseen."""
    from swift_ros.errors import UsageError

    known = set()
    for path in paths:
        if path.resolve() in known:
            raise UsageError(f"{path} is given twice; give each recording once")
        known.add(path.resolve())


def holds_only(out: Path, outputs: tuple[str, ...]) -> bool:
    """Return whether a folder exists that holds the results of an earlier run and nothing else.

    Such a folder stays unchanged until there are new results.
    """
    return out.is_dir() and all(any(path.match(pattern) for pattern in outputs) for path in out.iterdir())


def with_map(table, track):
    """Return a recording with another map of the gates, if a track is given and the recording has gates in images."""
    from dataclasses import replace

    gates = table.detected_gates
    return replace(table, detected_gates=replace(gates, track=track)) if gates and track else table


def with_unique_names(recordings: list, paths: list[Path]) -> list:
    """Return the recordings with unique names: where two have the same, all are named by their different paths."""
    from dataclasses import replace

    if len({one.name for one in recordings}) == len(recordings):
        return recordings
    shared = os.path.commonpath([path.resolve().parent for path in paths])
    return [
        replace(one, name=path.resolve().relative_to(shared).as_posix())
        for one, path in zip(recordings, paths, strict=True)
    ]


def track_of(diagnosis, recordings):
    """Return the map in a recording, else the configured track if the flights pass all its gates, else None."""
    from swift_ros.configuration import configuration_folder, load
    from swift_ros.track import Track
    from swift_sim_bridge.gap.validation import flight_regimes

    if recorded := next((one.detected_gates.track for one in recordings if one.detected_gates), None):
        return recorded
    track = load(Track, configuration_folder() / "track.yaml")
    flights = [one.recording for one in diagnosis.evidence.residual_models]
    passed = {gate for flight in flights for _, gate in flight_regimes.passages(flight, track)}
    return track if len(passed) == len(track.gates) else None


def self_test(vehicle, out: Path) -> int:
    """Print the result of each flight of the self-test, write self_test.json, and return 0 if all pass, else 1."""
    from dataclasses import asdict

    from swift_sim_bridge.gap import self_test as test

    cases = []
    print(f"{test.NOMINAL} nominal flights, then {len(test.PLANTED)} with a planted effect each")
    for number, case in enumerate(test.cases(vehicle), start=1):
        print(f"{number:3} {case}", flush=True)
        cases.append(case)
        result = {"vehicle": vehicle.name, "cases": [asdict(one) for one in cases]}
        (out / SELF_TEST).write_text(json.dumps(result, indent=1) + "\n")
    failed = sum(not case.good for case in cases)
    seconds = sum(case.seconds for case in cases)
    print(f"{len(cases) - failed} of {len(cases)} passed, {seconds:.0f} s; {out / SELF_TEST}")
    return 1 if failed else 0


def summary(table) -> str:
    """Return name, duration and channels of a recording in a line."""
    from swift_sim_bridge.gap.recording.channel_names import names_with_columns

    begin, end = table.span_s
    gates = f", {len(table.detected_gates.t)} gates in images" if table.detected_gates else ""
    return f"{table.name}: {end - begin:.1f} s, {names_with_columns(table.channels)}{gates}"


def write(diagnosis, file: DiagnosedFile, recordings: Diagnosed, out: Path, track=None) -> None:
    """Print a diagnosis and write its files.

    Args:
        diagnosis: a `gap.pipeline.diagnosis.Diagnosis`.
        file: the vehicle file that was diagnosed.
        recordings: the recordings.
        out: folder of the results.
        track: track whose gates the flights pass, or None.
    """
    import jax

    from swift_sim_bridge.gap.recording.betaflight_log import with_pid_gains
    from swift_sim_bridge.gap.report import (
        changes,
        effect_help,
        figures,
        html,
        next_steps,
        repaired_files,
        residual_file,
        terminal,
    )
    from swift_sim_bridge.gap.validation import localization, mismatch

    with jax.enable_x64(True):
        before = with_pid_gains(file.vehicle)  # the vehicle as `diagnose` compares it
        report = localization.locate_findings(diagnosis, before, track)
        mismatches = mismatch.mismatches_of(diagnosis, before)
    report = changes.with_changes(report, diagnosis, file.vehicle, recordings.tables)
    inputs = next_steps.Inputs(file.path, recordings.paths, out)
    report["next_steps"] = next_steps.next_steps(report, diagnosis, before, inputs)
    (out / REPORT).write_text(json.dumps(report, indent=1) + "\n")
    (out / VEHICLE).write_text(repaired_files.vehicle_text(file.content, diagnosis, file.path))
    written = [PAGE, REPORT, VEHICLE]
    if repaired := repaired_files.track_text(diagnosis):
        (out / TRACK).write_text(repaired)
        written.append(TRACK)
    residual_file.write(out / RESIDUALS, [residual_file.curves_of(one) for one in mismatches])
    pictures = figures.draw(mismatches, diagnosis.holdout_result, out, track)
    page = html.html_page(report, file.path, effect_help.parameters(file.vehicle), pictures, out)
    (out / PAGE).write_text(page)
    print(terminal.terminal_text(report))
    print(", ".join(str(out / name) for name in written))
