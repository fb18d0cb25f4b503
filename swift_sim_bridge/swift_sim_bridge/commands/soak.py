"""Run the simulator or races for a long time, and watch memory and late commands."""

from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.results import fresh_folder

PICTURE = "soak.png"


def command(subparsers) -> None:
    """Add the parser of `swiftros soak`."""
    parser = subparsers.add_parser("soak", help=__doc__, description=__doc__)
    parser.add_argument("kind", choices=("sim", "races"), help="the simulator, flown by topics, or races in real time")
    parser.add_argument("--minutes", type=int, default=60, metavar="M", help="how long (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", help="for results (default: results/soak-KIND)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Soak. Returns 0, or 1 when the memory grows or a command is late without a stall. Raises UsageError."""
    from swift_sim_bridge.soak import picture, run  # rclpy and matplotlib take a second to import

    if arguments.minutes < 1:
        raise UsageError(f"--minutes {arguments.minutes} is too short; give 1 or more")
    out = fresh_folder(
        Path(arguments.out or f"results/soak-{arguments.kind}"), (run.RESULT, PICTURE, "command.log", "sim", "races")
    )
    minutes = run.soak(arguments.kind, arguments.minutes, out, lambda line: print(line, flush=True))
    growth, unexplained = run.growth(minutes), sum(len(minute.unexplained) for minute in minutes)
    commands, late = sum(minute.commands for minute in minutes), sum(len(minute.late) for minute in minutes)
    title = (
        f"{arguments.kind}, {len(minutes)} min: memory grows by {100 * growth.share:.1f} % "
        f"({100 * growth.low:.1f} to {100 * growth.high:.1f} %) after {run.SETTLED_MIN} min; "
        f"{commands} commands, late with a stall of the machine {late}, without {unexplained}"
    )
    picture.draw(minutes, title, out / PICTURE)
    print(title)
    print(f"picture: {out / PICTURE}")
    return 1 if growth.share > run.MAX_GROWTH or unexplained else 0
