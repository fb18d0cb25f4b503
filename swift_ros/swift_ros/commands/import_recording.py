"""Convert foreign recordings (Blackbird, NanoBench, Betaflight blackbox) to bags, without their corrupt data."""

import importlib
import json
from pathlib import Path

from swift_ros.errors import UsageError

FORMATS = ("blackbird", "nanobench", "blackbox")


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
        "--out", metavar="DIR", default="recordings/imported", help="folder of the new bags (default: %(default)s)"
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Import all recordings at the path. Return 0. Raises UsageError on bad input."""
    from swift_ros.recording.replay import find_bag  # imports ROS

    bag = arguments.align and find_bag(arguments.align)
    sources = find(Path(arguments.path), "blackbox" if bag else arguments.format)
    if bag and len(sources) > 1:
        raise UsageError(f"--align takes one log, {arguments.path} holds {len(sources)}; give one log per file")
    out = Path(arguments.out)
    rows = []
    for count, (module, source) in enumerate(sources):
        print((f"{count + 1} of {len(sources)}: " if len(sources) > 1 else "") + f"{source}", flush=True)
        rows.append(convert(module, source, out, bag))
        (out / "result.json").write_text(json.dumps(summary(rows), indent=1) + "\n")
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
