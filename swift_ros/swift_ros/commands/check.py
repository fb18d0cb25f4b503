"""Recompute a result.json from its recorded bags and compare both."""

import json
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.race.result import BAG, RESULT, disagreements, summary


def command(subparsers) -> None:
    """Add the parser of `swiftros check`."""
    parser = subparsers.add_parser("check", help=__doc__, description=__doc__)
    parser.add_argument("folder", metavar="DIR", help="folder that a command wrote with --out")
    parser.add_argument("--out", metavar="DIR", help="write the recomputed result.json there")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Compare. Return 0 when all values agree, 1 otherwise. Raises UsageError on bad input."""
    folder = Path(arguments.folder)
    stored = read_result(folder)
    computed = recompute(folder)
    if arguments.out:
        out = Path(arguments.out)
        out.mkdir(parents=True, exist_ok=True)
        (out / RESULT).write_text(json.dumps(computed, indent=1) + "\n")
    differences = disagreements(stored, computed)
    for sentence in differences:
        print(sentence)
    verdict = f"{len(differences)} values differ from the bags" if differences else "all values agree with the bags"
    print(f"{folder / RESULT}, {len(computed['races'])} races: {verdict}")
    return 1 if differences else 0


def read_result(folder: Path) -> dict:
    """Return the content of a folder's `result.json`. Raises UsageError."""
    path = folder / RESULT
    try:
        content = json.loads(path.read_text())
    except OSError as error:
        raise UsageError(
            f"{path} cannot be read: {error.strerror}; give a folder that `swiftros race` wrote"
        ) from error
    except ValueError as error:
        raise UsageError(f"{path} is not valid JSON") from error
    if "races" not in content:
        raise UsageError(f"{path} lists no races; give a folder that `swiftros race` wrote")
    return content


def recompute(folder: Path) -> dict:
    """Return the content of `result.json` computed from the bags in `folder`. Raises UsageError."""
    from swift_ros.recording.race_bag import read_race, recorded_configuration, recorded_models  # imports ROS

    races = sorted(path.parent for path in folder.glob(f"seed-*/{BAG}"))
    if not races:
        raise UsageError(f"{folder} holds no recorded race (seed-*/{BAG}); give a folder that `swiftros race` wrote")
    results = [read_race(race, *recorded_configuration(race / BAG))[0] for race in races]
    results.sort(key=lambda result: -1 if result.seed is None else result.seed)
    return summary(results, recorded_models(races[0] / BAG))
