"""Check files of a configuration, alone or in their folder, or a flight log, or recompute a result from its bags."""

import json
from pathlib import Path

from swift_ros.commands.checked_files import Checked, check_file, check_folder
from swift_ros.configuration import configuration_folder
from swift_ros.errors import UsageError
from swift_ros.plausibility.finding import IMPOSSIBLE
from swift_ros.race import limit
from swift_ros.race.result import BAG, RESULT, RaceResult, disagreements, summary
from swift_ros.recording.log_formats.log import BAGS, DATAFLASH, TABLES, ULOG


def command(subparsers) -> None:
    """Add the parser of `swiftros check`."""
    parser = subparsers.add_parser("check", help=__doc__, description=__doc__)
    parser.add_argument(
        "path",
        metavar="PATH",
        help="file of a vehicle, track, camera, nodes, simulation or training; configuration folder, with its "
        "tracks/ and vehicles/; folder of such files; folder that --out wrote; or a flight: a table, a bag, or a log "
        "of PX4 or ArduPilot",
    )
    parser.add_argument("--mapping", type=Path, metavar="FILE", help="mapping of a flight log (default: a guess)")
    parser.add_argument("--out", metavar="DIR", help="write the recomputed result.json there")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Check. Return 0 when nothing is wrong, 1 otherwise. Raises UsageError when there is nothing to check."""
    path = Path(arguments.path)
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a file or folder")
    if is_flight(path):
        return check_flight(path, arguments.mapping)
    if path.is_file():
        return report(check_file(path), path)
    results = (path / RESULT).is_file() or any(path.glob("seed-*"))
    return check_result(path, arguments.out) if results else report(check_folder(path), path)


def is_flight(path: Path) -> bool:
    """Return whether a path is a flight: a table, a bag or a log."""
    suffixes = (*TABLES, *BAGS, *ULOG, *DATAFLASH)
    return path.suffix.lower() in suffixes if path.is_file() else any(path.glob("*.mcap"))


def check_flight(path: Path, mapping: Path | None) -> int:
    """Print how a flight was read and what is wrong in it; return 1 when a check fails, 0 otherwise."""
    from swift_ros.recording import flight_files

    try:
        table = flight_files.read(path, mapping)
    except UsageError as error:
        print(f"{path}: {IMPOSSIBLE}: {str(error).removeprefix(str(path)).lstrip(':, ')}")
        return 1
    begin, end = table.span_s
    print(f"{path}: {end - begin:.1f} s, {', '.join(table.channels)}")
    for line in (*table.notes, *(f"left out {rejection}" for rejection in table.rejections)):
        print(f"  {line}")
    return int(table.contradicted)


def report(checked: Checked, path: Path) -> int:
    """Print the findings about files; return 1 when one of them is impossible."""
    for file, finding in checked.findings:
        print(f"{file}: {finding.level}: {finding.sentence}")
    if not checked.findings:
        names = ", ".join(str(file.relative_to(path)) for file in checked.files) if path.is_dir() else ""
        print(f"{path}: nothing is impossible or odd" + (f" ({names})" if names else ""))
    return int(any(finding.level == IMPOSSIBLE for _, finding in checked.findings))


def check_result(folder: Path, out: str | None) -> int:
    """Compare a result with its bags; return 0 when all values agree, 1 otherwise. Raises UsageError on bad input."""
    stored = read_result(folder)
    results, models = recompute(folder)
    computed = summary(results, models)
    if out:
        Path(out).mkdir(parents=True, exist_ok=True)
        (Path(out) / RESULT).write_text(json.dumps(computed, indent=1) + "\n")
    differences = disagreements(stored, computed)
    for sentence in differences:
        print(sentence)
    verdict = f"{len(differences)} values differ from the bags" if differences else "all values agree with the bags"
    print(f"{folder / RESULT}, {len(results)} races: {verdict}")
    print_limit(folder, results)
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


def recompute(folder: Path) -> tuple[list[RaceResult], dict[str, str]]:
    """Return results and networks of the races in `folder`, computed from the bags. Raises UsageError."""
    from swift_ros.recording.race_bag import read_race, recorded_configuration, recorded_models  # imports ROS

    races = sorted(path.parent for path in folder.glob(f"seed-*/{BAG}"))
    if not races:
        raise UsageError(f"{folder} holds no recorded race (seed-*/{BAG}); give a folder that `swiftros race` wrote")
    results = [read_race(race, *recorded_configuration(race / BAG))[0] for race in races]
    results.sort(key=lambda result: -1 if result.seed is None else result.seed)
    return results, recorded_models(races[0] / BAG)


def print_limit(folder: Path, results: list[RaceResult]) -> None:
    """Print the laps and races as multiples of the physical limit, where it is known for the track and the vehicle."""
    from swift_ros.recording.race_bag import recorded_configuration

    first = min(folder.glob(f"seed-*/{BAG}"))
    found = limit.find(configuration_folder(), *recorded_configuration(first))
    if found and (text := limit.sentence(found, results)):
        print(text)
