"""Judge the gap tool by sealed cases: conceal effects in flights of other simulators, let it name them, score it."""

import json
from pathlib import Path

RESULT, PICTURE, TABLE = "result.json", "detection.png", "score.txt"


def command(subparsers) -> None:
    """Add the parser of `swiftros gap-referee`."""
    parser = subparsers.add_parser("gap-referee", help=__doc__, description=__doc__)
    parser.add_argument("--batch", choices=("small", "full"), default="small", help="(default: %(default)s)")
    parser.add_argument("--families", nargs="+", default=[], metavar="FAMILY", help="these in place of a batch")
    parser.add_argument("--count", type=int, default=10, metavar="N", help="of each family (default: %(default)s)")
    parser.add_argument("--generator", choices=("own", "rotorpy", "both"), default="both",
                        help="whose flights (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="S",
                        help="first seed: 0 to 999 to develop, 1000 to 9999 to test (default: %(default)s)")
    parser.add_argument("--review", action="store_true", help="allow seeds from 10000 up")
    parser.add_argument("--keep", action="store_true", help="keep the recordings, 6 MB each")
    parser.add_argument("--out", type=Path, default=Path("runs/gap-referee"), metavar="DIR",
                        help="goes on where an earlier run with the same options stopped (default: %(default)s)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Judge, print the score table and the targets that were missed, write result.json, score.txt and detection.png.
    Return 0, or 1 when a target was missed. Raises UsageError on bad input."""
    from swift_sim_bridge.referee import picture, plan, rotorpy_flight, runner, tables
    from swift_sim_bridge.referee.scoring import missed, summary

    generators = plan.GENERATORS if arguments.generator == "both" else (arguments.generator,)
    counts = {name: plan.BATCHES[arguments.batch][name] for name in generators}
    if arguments.families:
        counts = {name: dict.fromkeys(arguments.families, arguments.count) for name in generators}
    entries = plan.plan(counts, arguments.seed, arguments.review)
    if any(counts.get("rotorpy", {}).values()):
        rotorpy_flight.package()  # before the first flight, not at its turn
    records = runner.run(entries, arguments.out, keep=arguments.keep)
    groups = {name: [record for record in records if record["generator"] == name] for name in generators}
    result = {"seed": arguments.seed, "score": {name: summary(own, name) for name, own in groups.items() if own},
              "cases": records}  # fmt: skip
    (arguments.out / RESULT).write_text(json.dumps(result, indent=1) + "\n")
    (arguments.out / TABLE).write_text(tables.text(result) + "\n")
    picture.draw(records, arguments.out / PICTURE)
    print(tables.text(result))
    print(", ".join(str(arguments.out / name) for name in (RESULT, TABLE, PICTURE, runner.LOG)))
    targets = missed(result)
    if targets:
        print(f"missed their targets: {'; '.join(targets)}")
    return 1 if targets else 0
