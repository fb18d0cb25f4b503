"""Fly races with faults drawn at random, and say how each of them ended."""

import os
from pathlib import Path

from swift_ros.configuration import configuration_folder
from swift_ros.errors import UsageError
from swift_sim_bridge.commands.race import chosen_files
from swift_sim_bridge.seeds import check_seeds

TABLE, PICTURE = "faults.txt", "faults.png"
CLOCK_SEEDS = {"both": (0, 1), "lockstep": (0,), "real-time": (1,)}  # remainders of the seeds by 2
COMPILED = "compiled"  # what JAX compiles, which each race would compile again


def command(subparsers) -> None:
    """Add the parser of `swiftros faults`."""
    parser = subparsers.add_parser("faults", help=__doc__, description=__doc__)
    parser.add_argument("--draws", type=int, default=10, metavar="N", help="number of faults (default: %(default)s)")
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="first seed; even seeds fly in lockstep, odd ones in real time"
    )
    parser.add_argument(
        "--clock", choices=CLOCK_SEEDS, default="both", help="fly only the draws on this clock (default: %(default)s)"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="races at the same time, which share the cores; in real time each needs three (default: %(default)s)",
    )
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument(
        "--out",
        metavar="DIR",
        default="results/faults",
        help="for results; draws in it are kept (default: %(default)s)",
    )
    parser.add_argument(
        "--keep", action="store_true", help="keep the bags of all draws, not of undefined endings alone"
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Fly the draws. Returns 0 if all endings are defined, else 1. Raises UsageError on bad input."""
    from swift_sim_bridge.faults import batch, picture, tables  # rclpy and matplotlib take a second to import

    if arguments.draws < 1:
        raise UsageError(f"--draws {arguments.draws} leaves nothing to fly; give 1 or more")
    if arguments.jobs < 1:
        raise UsageError(f"--jobs {arguments.jobs} flies nothing; give 1 or more")
    chosen = CLOCK_SEEDS[arguments.clock]
    seeds = [seed for seed in range(arguments.seed, arguments.seed + 2 * arguments.draws) if seed % 2 in chosen]
    seeds = seeds[: arguments.draws]
    check_seeds(seeds[0], seeds[-1])
    chosen_files(arguments.config)
    out = Path(arguments.out)
    config = batch.short_race(configuration_folder(arguments.config), out)
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str((out / COMPILED).resolve()))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    endings = batch.endings(batch.Batch(out, config, arguments.keep, arguments.jobs), seeds)
    parts = [tables.by_kind(endings), tables.by_target(endings), *tables.undefined(endings), tables.totals(endings)]
    (out / TABLE).write_text("\n\n".join(parts) + "\n")
    picture.draw(endings, out / PICTURE)
    print("\n\n".join(parts))
    print(f"picture: {out / PICTURE}")
    return 1 if tables.undefined(endings) else 0
