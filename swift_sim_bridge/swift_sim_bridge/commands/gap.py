"""Find what the simulation left out: recordings against the vehicle file, layer by layer."""

import json
from pathlib import Path

REPORT, PAGE, VEHICLE, PICTURES = "report.json", "report.html", "vehicle.yaml", "*.png"


def command(subparsers) -> None:
    """Add the parser of `swiftros gap`."""
    parser = subparsers.add_parser("gap", help=__doc__, description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="*", metavar="RECORDING",
                        help="a .csv or .parquet table, or a bag; several of one vehicle are one diagnosis")
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="vehicle file (default: drone.yaml)")
    parser.add_argument("--seed", type=int, default=0, help="of the twins' chance (default: %(default)s)")
    parser.add_argument("--list-effects", action="store_true", help="print the effects that are known, and stop")
    parser.add_argument("--explain", metavar="EFFECT", help="print what an effect is and what to fly, and stop")
    parser.add_argument("--out", type=Path, default=Path("runs/gap"), metavar="DIR", help="(default: %(default)s)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Diagnose, print what was found, write report.json, report.html with its pictures, and vehicle.yaml. Return 0 for
    every verdict.

    Raises UsageError on bad input.
    """
    from swift_ros import flight_files
    from swift_ros.configuration import configuration_folder, load
    from swift_ros.errors import UsageError
    from swift_ros.results import fresh_folder
    from swift_ros.vehicle import Vehicle
    from swift_sim_bridge.gap import explain
    from swift_sim_bridge.gap.diagnose import diagnose

    source = arguments.vehicle or configuration_folder() / "drone.yaml"
    vehicle = load(Vehicle, source)
    if arguments.list_effects or arguments.explain:
        print(explain.one(arguments.explain, vehicle) if arguments.explain else explain.table(vehicle))
        return 0
    if not arguments.recordings:
        raise UsageError("no recording is given; name one or more .csv or .parquet tables or bags")
    recordings = [flight_files.read(path) for path in arguments.recordings]
    for one in recordings:
        print(described(one))
        for rejection in one.rejections:
            print(f"  left out {rejection}")
    found = diagnose(recordings, vehicle, print, arguments.seed)
    out = fresh_folder(arguments.out, (REPORT, PAGE, VEHICLE, PICTURES))
    write(found, vehicle, Path(source), [described(one) for one in recordings], out)
    return 0


def described(table) -> str:
    """Return what a recording holds, in a line."""
    begin, end = table.span_s
    return f"{table.name}: {end - begin:.1f} s, {', '.join(table.channels)}"


def write(found, vehicle, source: Path, recordings: list[str], out: Path) -> None:
    """Print a diagnosis and write its files. vehicle: of the file `source`; recordings: a line about each."""
    import jax

    from swift_ros.configuration import read_yaml
    from swift_sim_bridge.gap import figures, mismatch, page, repair

    print(page.text(found.report))
    (out / REPORT).write_text(json.dumps(found.report, indent=1) + "\n")
    (out / VEHICLE).write_text(repair.text(read_yaml(source), found, source))
    with jax.enable_x64(True):
        pictures = figures.draw(mismatch.of(found, vehicle), found.proof, out)
    (out / PAGE).write_text(page.html(found.report, source, recordings, pictures))
    print(", ".join(str(out / name) for name in (REPORT, PAGE, VEHICLE)))
