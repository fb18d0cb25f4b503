"""Convert foreign recordings: Blackbird, NanoBench and Betaflight blackbox to bags, other logs to flight tables.

Other logs are those of PX4 (.ulg) and ArduPilot (.bin, .log), bags of other graphs, and tables of other columns.
"""

import importlib
import json
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.recording.log_formats.log import BAGS, DATAFLASH, ROS1_BAGS, SQLITE_BAGS, TABLES, ULOG

FORMATS = ("blackbird", "nanobench", "blackbox")
OUT = Path("recordings/imported")


def command(subparsers) -> None:
    """Add the parser of `swiftros import`."""
    parser = subparsers.add_parser("import", help=__doc__, description=__doc__)
    parser.add_argument("path", help="a recording, or a folder of recordings")
    parser.add_argument("--format", choices=("auto", *FORMATS), default="auto", help="(default: from the file names)")
    parser.add_argument(
        "--align",
        type=Path,
        metavar="BAG",
        help="align a blackbox log to the clock of this bag of the same flight, and merge both into one bag",
    )
    parser.add_argument(
        "--mapping",
        type=Path,
        metavar="FILE",
        help="which columns of a log are which channel, in which unit and frame (default: a guess, which is printed)",
    )
    parser.add_argument(
        "--write-mapping", type=Path, metavar="FILE", help="write the mapping of a log for correction, and stop"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="PATH",
        default=OUT,
        help="folder of the new bags and tables, or the .csv or .parquet file of a log (default: %(default)s)",
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Import all recordings at the path. Return 0. Raises UsageError on bad input."""
    from swift_ros.recording.replay import find_bag  # imports ROS

    path = Path(arguments.path)
    bag = arguments.align and find_bag(arguments.align)
    if arguments.format == "auto" and not bag and is_other_log(path):
        return convert_log(path, arguments)
    if arguments.mapping or arguments.write_mapping:
        raise UsageError(f"{path} has a format of its own; leave out --mapping and --write-mapping")
    sources = find(path, "blackbox" if bag else arguments.format)
    if bag and len(sources) > 1:
        raise UsageError(f"--align takes one log, {arguments.path} holds {len(sources)}; give one log per file")
    out, rows = arguments.out, []
    for count, (module, source) in enumerate(sources):
        print((f"{count + 1} of {len(sources)}: " if len(sources) > 1 else "") + f"{source}", flush=True)
        rows.append(convert(module, source, out, bag))
        (out / "result.json").write_text(json.dumps(summary(rows), indent=1) + "\n")
    return 0


def is_other_log(path: Path) -> bool:
    """Return whether a path is a log, a bag or a table, and no recording of one of FORMATS."""
    if path.is_dir():
        return any(file.suffix in (*BAGS, *SQLITE_BAGS) for file in path.iterdir())
    return path.is_file() and path.suffix.lower() in (*TABLES, *BAGS, *SQLITE_BAGS, *ROS1_BAGS, *ULOG, *DATAFLASH)


def convert_log(path: Path, arguments) -> int:
    """Write the flight table of a log, or its mapping; return 0. Raises UsageError on bad input."""
    from swift_ros.recording import flight_files
    from swift_ros.recording.log_mapping import mapping_file, reading

    if arguments.write_mapping:
        log, mapping = flight_files.open_log(path, arguments.mapping)
        mapping_file.write(mapping, arguments.write_mapping, reading.comments(log))
        print("\n".join(mapping_file.lines(mapping)))
        print(
            f"{arguments.write_mapping}: correct it, then `swiftros import {path} --mapping {arguments.write_mapping}`"
        )
        return 0
    table = flight_files.read(path, arguments.mapping)
    out = arguments.out if arguments.out.suffix in TABLES else arguments.out / f"{path.stem}.csv"
    if out.resolve() == path.resolve():
        raise UsageError(f"{out} is the log itself; give another --out")
    for line in (*table.notes, *(f"left out {rejection}" for rejection in table.rejections)):
        print(f"  {line}")
    out.parent.mkdir(parents=True, exist_ok=True)
    flight_files.write(table, out)
    begin, end = table.span_s
    print(f"{end - begin:.2f} s, {', '.join(table.channels)} -> {out}")
    return 0


def find(path: Path, format_name: str) -> list:
    """Return (importer module, recording) of all recordings at a path. Raises UsageError when there is none."""
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a recording or a folder of recordings")
    names = FORMATS if format_name == "auto" else (format_name,)
    modules = [importlib.import_module(f"swift_ros.importers.{name}") for name in names]
    sources = [(module, source) for module in modules for source in module.find(path)]
    if not sources:
        raise UsageError(
            f"{path} holds no recording of {', '.join(names)}; docs/recordings.md lists the files of each format"
        )
    return sources


def convert(module, source, out: Path, aligned_bag: Path | None = None) -> dict:
    """Write the bag of one recording, print a summary, and return it as its entry of `result.json`.

    Args:
        module: importer of the recording's format.
        source: path of the recording.
        out: folder of the new bags.
        aligned_bag: bag of the same flight to which a blackbox log is aligned, None without.
    """
    flight = module.read(source, aligned_bag) if aligned_bag else module.read(source)
    bag = out / flight.name
    counts = flight.write(bag)
    print(f"  {flight.t[-1] - flight.t[0]:.2f} s -> {bag}")
    print("  " + ", ".join(f"{count} {topic}" for topic, count in counts.items()))
    for note in ("aligned", "vio/odometry", "betaflight/rotors"):
        if note in flight.notes:
            print(f"  {note}: {flight.notes[note]}")
    for rejection in flight.rejections:
        print(f"  rejected {rejection}")
    noted = ("source", "frames", "aligned", *counts)
    return {
        "recording": flight.name,
        "bag": str(bag),
        "duration_s": float(flight.t[-1] - flight.t[0]),
        "messages": counts,
        "notes": {name: flight.notes[name] for name in noted if name in flight.notes},
        "rejected_data": [rejection.as_json() for rejection in flight.rejections],
    }


def summary(rows: list[dict]) -> dict:
    """Return the content of `result.json`; times of `rejected_data` are in s from the recording's first row."""
    rejected = [{"recording": row["recording"], **entry} for row in rows for entry in row["rejected_data"]]
    return {"recordings": rows, "rejected_data": rejected}
