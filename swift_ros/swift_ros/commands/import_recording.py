"""Turn public flight recordings (Blackbird, NanoBench) into bags of this graph; name what is corrupt, leave it out."""

import json
from pathlib import Path

from swift_ros.errors import UsageError

FORMATS = ("blackbird", "nanobench")


def command(subparsers) -> None:
    """Add the parser of `swiftros import`."""
    parser = subparsers.add_parser("import", help=__doc__, description=__doc__)
    parser.add_argument("path", help="a recording, or a folder of recordings")
    parser.add_argument("--format", choices=("auto", *FORMATS), default="auto", help="(default: what it looks like)")
    parser.add_argument("--out", metavar="DIR", default="recordings/imported",
                        help="where the bags go (default: %(default)s)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Import all recordings at the path. Returns 0. Raises UsageError on bad input."""
    sources = find(Path(arguments.path), arguments.format)
    out = Path(arguments.out)
    rows = []
    for count, (module, source) in enumerate(sources):
        print(f"{source}" + (f", {count + 1} of {len(sources)}" if len(sources) > 1 else ""), flush=True)
        rows.append(convert(module, source, out))
        (out / "result.json").write_text(json.dumps(summary(rows), indent=1) + "\n")
    return 0


def find(path: Path, format_name: str) -> list:
    """Return (importer module, recording) of all recordings at a path. Raises UsageError when there is none."""
    import importlib

    if not path.exists():
        raise UsageError(f"{path} does not exist; give a recording or a folder of recordings")
    names = FORMATS if format_name == "auto" else (format_name,)
    modules = [importlib.import_module(f"swift_ros.importers.{name}") for name in names]
    sources = [(module, source) for module in modules for source in module.find(path)]
    if not sources:
        raise UsageError(f"{path} holds no {' or '.join(names)} recording; see the README for what they consist of")
    return sources


def convert(module, source: Path, out: Path) -> dict:
    """Write the bag of one recording, tell what it holds and what was left out, and return that."""
    flight = module.read(source)
    bag = out / flight.name
    counts = flight.write(bag)
    print(f"  {flight.t[-1] - flight.t[0]:.2f} s -> {bag}")
    print("  " + ", ".join(f"{count} {topic}" for topic, count in counts.items()))
    for topic in ("vio/odometry", "betaflight/rotors"):
        print(f"  {topic}: {flight.notes[topic]}")
    for rejection in flight.rejections:
        print(f"  left out {rejection}")
    return {
        "recording": flight.name,
        "bag": str(bag),
        "duration_s": float(flight.t[-1] - flight.t[0]),
        "messages": counts,
        "notes": {topic: flight.notes[topic] for topic in ("source", "frames", *counts) if topic in flight.notes},
        "rejected_data": [rejection.as_json() for rejection in flight.rejections],
    }


def summary(rows: list[dict]) -> dict:
    """Return the whole of `result.json`; times of `rejected_data` count from the recording's first row, s."""
    rejected = [{"recording": row["recording"], **entry} for row in rows for entry in row["rejected_data"]]
    return {"recordings": rows, "rejected_data": rejected}
