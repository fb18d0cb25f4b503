"""Write the readable rest of a damaged bag as a sound bag, and name what is lost."""

from pathlib import Path


def command(subparsers) -> None:
    """Add the parser of `swiftros recover`."""
    parser = subparsers.add_parser("recover", help=__doc__, description=__doc__)
    parser.add_argument("bag", metavar="BAG", help="a bag folder, a folder with one bag below, or an .mcap file")
    parser.add_argument(
        "--out", metavar="DIR", default="recordings/recovered", help="folder of the new bag (default: %(default)s)"
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Recover a bag. Return 0. Raises UsageError on bad input."""
    from swift_ros.recording.recovery import recover  # imports ROS
    from swift_ros.recording.replay import find_bag

    bag, out = find_bag(Path(arguments.bag)), Path(arguments.out)
    recovered = recover(bag, out)
    for name, count in recovered.counts.items():
        print(f"{count:8d}  {name}")
    for part in recovered.damage:
        print(part)
    lost = f"damaged parts left out: {len(recovered.damage)}" if recovered.damage else "nothing is damaged"
    print(f"{bag}: {sum(recovered.counts.values())} messages are written to {out}; {lost}")
    return 0
