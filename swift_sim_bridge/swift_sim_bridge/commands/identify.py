"""Identify a vehicle's coefficients from its flights, with standard errors: thrust, drag, moments, motors, battery."""

import json
from pathlib import Path

RESULT, VEHICLE, PICTURE = "result.json", "vehicle.yaml", "fit.png"


def command(subparsers) -> None:
    """Add the parser of `swiftros identify`."""
    parser = subparsers.add_parser("identify", help=__doc__, description=__doc__)
    parser.add_argument(
        "flights",
        type=Path,
        nargs="+",
        metavar="FLIGHT",
        help="a .csv or .parquet table, a bag, or a log of PX4 (.ulg) or ArduPilot (.bin)",
    )
    parser.add_argument("--mapping", type=Path, metavar="FILE", help="mapping of logs (default: a guess)")
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="vehicle file (default: drone.yaml)")
    parser.add_argument(
        "--with",
        dest="more",
        nargs="+",
        default=[],
        metavar="TERM",
        help="forces and moments to fit besides those of the file",
    )
    parser.add_argument(
        "--without", dest="less", nargs="+", default=[], metavar="TERM", help="terms of the file to remove"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/identify"), metavar="DIR", help="(default: %(default)s)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Identify, print the tables, write result.json, vehicle.yaml and fit.png.

    Returns:
        0, or 1 when the flights determine no coefficient.

    Raises:
        UsageError: the input is bad.
    """
    from swift_ros.configuration import configuration_folder, load_unchecked, read_yaml
    from swift_ros.recording import flight_files
    from swift_ros.recording.log_mapping.motor_order import refuse_another_order
    from swift_ros.results import fresh_folder
    from swift_ros.vehicle import Vehicle
    from swift_sim_bridge.identification import identify as identification
    from swift_sim_bridge.identification import picture, repair, tables
    from swift_sim_bridge.identification.regular_stamps import with_regular_stamps

    source = arguments.vehicle or configuration_folder() / "drone.yaml"
    content = read_yaml(source)
    flights = [flight_files.read(path, arguments.mapping) for path in arguments.flights]
    for flight in flights:
        begin, end = flight.span_s
        print(f"{flight.name}: {end - begin:.1f} s, {', '.join(flight.channels)}")
        for line in (*flight.notes, *(f"left out {rejection}" for rejection in flight.rejections)):
            print(f"  {line}")
        if flight.motor_order:
            refuse_another_order(flight.name, flight.motor_order, load_unchecked(Vehicle, source), flight.motor_columns)
    out = fresh_folder(arguments.out, (RESULT, VEHICLE, PICTURE))
    flights = [with_regular_stamps(flight, print) for flight in flights]
    found = identification.identify(flights, content, str(source), arguments.more, arguments.less)
    result = {"vehicle": str(source)} | identification.as_result(found, flights)
    (out / RESULT).write_text(json.dumps(result, indent=1) + "\n")
    (out / VEHICLE).write_text(repair.text(found.content, found.changes, source))
    picture.draw([part.fit for part in found.parts if part.fit], out / PICTURE)
    print(tables.text(result))
    print(", ".join(str(out / name) for name in (RESULT, VEHICLE, PICTURE)))
    return 0 if found.changes else 1
