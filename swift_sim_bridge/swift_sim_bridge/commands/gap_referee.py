"""Evaluate the gap tool on sealed cases: hidden effects in flights of other simulators, diagnosed and then scored."""

import json
from collections import Counter
from pathlib import Path

RESULT, PICTURE, TABLE = "result.json", "detection.png", "score.txt"


def command(subparsers) -> None:
    """Add the parser of `swiftros gap-referee`."""
    parser = subparsers.add_parser("gap-referee", help=__doc__, description=__doc__)
    parser.add_argument("--batch", choices=("small", "full", "foreign"), default="small", help="(default: %(default)s)")
    parser.add_argument("--families", nargs="+", default=[], metavar="FAMILY", help="these families instead of a batch")
    parser.add_argument(
        "--count", type=int, default=10, metavar="N", help="cases of each family (default: %(default)s)"
    )
    parser.add_argument(
        "--generator",
        choices=("own", "rotorpy", "both"),
        default="both",
        help="simulator of the flights (default: %(default)s)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="S",
        help="first seed: 0 to 999 for development, 1000 to 9999 for tests (default: %(default)s)",
    )
    parser.add_argument("--review", action="store_true", help="allow seeds from 10000 up")
    parser.add_argument("--keep", action="store_true", help="keep the recordings, 6 MB each")
    parser.add_argument("--score", action="store_true", help="evaluate no further case, score those in DIR")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the batch; a run with the same options continues an earlier one (default: "
        "runs/gap-referee-BATCH-S, with --families runs/gap-referee-FAMILY-FAMILY-S)",
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Evaluate a batch, print the score table and the missed targets, write result.json, score.txt and detection.png.

    Returns:
        0, or 1 if a target is missed.

    Raises:
        UsageError: the input cannot be used.
    """
    from swift_ros.errors import UsageError
    from swift_sim_bridge.referee.records import read_plan, read_records

    out = arguments.out or default_out(arguments)
    if not arguments.score:
        records = _evaluate(arguments, out)
    else:
        entries, done = read_plan(out), read_records(out)
        if not done:
            raise UsageError(f"{out} holds no case that was evaluated")
        print(f"{len(done)} of {len(entries)} cases evaluated")
        records = [done[entry.name] for entry in entries if entry.name in done]
    return _write_score(records, out)


def default_out(arguments) -> Path:
    """Return the default folder of a batch, a different one for other families, sizes or seeds."""
    batch = "-".join(arguments.families) or arguments.batch
    return Path("runs") / f"gap-referee-{batch}-{arguments.seed}"


def _evaluate(arguments, out: Path) -> list[dict]:
    """Evaluate the batch of the command line and return its records."""
    from swift_sim_bridge.compiled_code import keep_compiled_code
    from swift_sim_bridge.referee import plan, runner
    from swift_sim_bridge.referee.simulator import rotorpy_flight

    keep_compiled_code()
    generators = plan.GENERATORS if arguments.generator == "both" else (arguments.generator,)
    counts = {name: plan.BATCHES[arguments.batch][name] for name in generators}
    if arguments.families:
        counts = {name: dict.fromkeys(arguments.families, arguments.count) for name in generators}
    entries = plan.make_plan(counts, arguments.seed, arguments.review)
    if any(counts.get("rotorpy", {}).values()):
        rotorpy_flight.package()  # if it is missing, fail before the first flight
    return runner.run(entries, out, keep=arguments.keep)


def _write_score(records: list[dict], out: Path) -> int:
    """Print and write the score of records; return 0, or 1 if a target is missed."""
    from swift_sim_bridge.referee import picture, plan
    from swift_sim_bridge.referee.records import LOG, read_plan
    from swift_sim_bridge.referee.summary import missed_targets, summarise
    from swift_sim_bridge.referee.tables import score_table

    groups = {name: [record for record in records if record["generator"] == name] for name in plan.GENERATORS}
    result = {
        "seed": min(entry.seed for entry in read_plan(out)),
        "judged_by": Counter(record["judged_by"] for record in records),
        "score": {name: summarise(group, name) for name, group in groups.items() if group},
        "cases": records,
    }
    (out / RESULT).write_text(json.dumps(result, indent=1) + "\n")
    (out / TABLE).write_text(score_table(result) + "\n")
    picture.draw_detection(records, out / PICTURE)
    print(score_table(result))
    print(", ".join(str(out / name) for name in (RESULT, TABLE, PICTURE, LOG)))
    missed = missed_targets(result)
    if missed:
        print(f"missed targets: {'; '.join(missed)}")
    return 1 if missed else 0
