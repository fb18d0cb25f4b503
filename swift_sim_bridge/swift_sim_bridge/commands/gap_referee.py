"""Judge the gap tool by sealed cases: conceal effects in flights of other simulators, let it name them, score it."""

import json
from collections import Counter
from pathlib import Path

RESULT, PICTURE, TABLE = "result.json", "detection.png", "score.txt"


def command(subparsers) -> None:
    """Add the parser of `swiftros gap-referee`."""
    parser = subparsers.add_parser("gap-referee", help=__doc__, description=__doc__)
    parser.add_argument("--batch", choices=("small", "full"), default="small", help="(default: %(default)s)")
    parser.add_argument("--families", nargs="+", default=[], metavar="FAMILY", help="these in place of a batch")
    parser.add_argument("--count", type=int, default=10, metavar="N", help="of each family (default: %(default)s)")
    parser.add_argument(
        "--generator", choices=("own", "rotorpy", "both"), default="both", help="whose flights (default: %(default)s)"
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="S",
        help="first seed: 0 to 999 to develop, 1000 to 9999 to test (default: %(default)s)",
    )
    parser.add_argument("--review", action="store_true", help="allow seeds from 10000 up")
    parser.add_argument("--keep", action="store_true", help="keep the recordings, 6 MB each")
    parser.add_argument("--score", action="store_true", help="judge nothing, score what DIR holds so far")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="goes on where an earlier run with the same options stopped (default: "
        "runs/gap-referee-BATCH-S, with --families runs/gap-referee-FAMILY-FAMILY-S)",
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Judge, print the score table and the targets that were missed, write result.json, score.txt and detection.png.
    Return 0, or 1 when a target was missed. Raises UsageError on bad input."""
    from swift_ros.errors import UsageError
    from swift_sim_bridge.referee import records as judged

    out = arguments.out or default_out(arguments)
    if not arguments.score:
        records = _judge(arguments, out)
    else:
        entries, held = judged.plan(out), judged.records(out)
        if not held:
            raise UsageError(f"{out} holds no case that was judged")
        print(f"{len(held)} of {len(entries)} cases judged")
        records = [held[entry.name] for entry in entries if entry.name in held]
    return _scored(records, out)


def default_out(arguments) -> Path:
    """Return the folder of a batch, which none of other families, size or seed has."""
    what = "-".join(arguments.families) or arguments.batch
    return Path("runs") / f"gap-referee-{what}-{arguments.seed}"


def _judge(arguments, out: Path) -> list[dict]:
    """Return the records of the batch that was asked for."""
    from swift_sim_bridge.referee import plan, runner
    from swift_sim_bridge.referee.simulator import rotorpy_flight

    generators = plan.GENERATORS if arguments.generator == "both" else (arguments.generator,)
    counts = {name: plan.BATCHES[arguments.batch][name] for name in generators}
    if arguments.families:
        counts = {name: dict.fromkeys(arguments.families, arguments.count) for name in generators}
    entries = plan.plan(counts, arguments.seed, arguments.review)
    if any(counts.get("rotorpy", {}).values()):
        rotorpy_flight.package()  # before the first flight, not at its turn
    return runner.run(entries, out, keep=arguments.keep)


def _scored(records: list[dict], out: Path) -> int:
    """Print and write the score of records; return 0, or 1 when a target was missed."""
    from swift_sim_bridge.referee import picture, plan, tables
    from swift_sim_bridge.referee import records as judged
    from swift_sim_bridge.referee.scoring import missed, summary

    groups = {name: [record for record in records if record["generator"] == name] for name in plan.GENERATORS}
    result = {
        "seed": min(entry.seed for entry in judged.plan(out)),
        "judged_by": Counter(record["judged_by"] for record in records),
        "score": {name: summary(own, name) for name, own in groups.items() if own},
        "cases": records,
    }
    (out / RESULT).write_text(json.dumps(result, indent=1) + "\n")
    (out / TABLE).write_text(tables.text(result) + "\n")
    picture.draw(records, out / PICTURE)
    print(tables.text(result))
    print(", ".join(str(out / name) for name in (RESULT, TABLE, PICTURE, judged.LOG)))
    targets = missed(result)
    if targets:
        print(f"missed their targets: {'; '.join(targets)}")
    return 1 if targets else 0
