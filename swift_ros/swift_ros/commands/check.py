"""Check files of vehicle, track, camera and what networks were trained for; or recompute a result.json from bags."""

import json
from pathlib import Path

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_ros.plausibility.finding import IMPOSSIBLE, Finding
from swift_ros.plausibility.of_track import findings_with
from swift_ros.race.result import BAG, RESULT, disagreements, summary

VEHICLE, TRACK, CAMERA = "rotors", "gates", "fx"  # a key that only this kind of file has
NAMES = ("drone.yaml", "track.yaml", "camera.yaml")


def command(subparsers) -> None:
    """Add the parser of `swiftros check`."""
    parser = subparsers.add_parser("check", help=__doc__, description=__doc__)
    parser.add_argument(
        "path", metavar="PATH", help="file of a vehicle, track or camera; folder of them; or folder that --out wrote"
    )
    parser.add_argument("--out", metavar="DIR", help="write the recomputed result.json there")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Check. Return 0 when nothing is wrong, 1 otherwise. Raises UsageError on bad input."""
    path = Path(arguments.path)
    if path.is_file() and path.suffix in (".yaml", ".yml"):
        return check_files([path])
    files = [path / name for name in NAMES if (path / name).is_file()]
    return check_files(files) if files and not (path / RESULT).is_file() else check_result(path, arguments.out)


def check_files(paths: list[Path]) -> int:
    """Print the findings about files, alone and together; return 1 when one of them is impossible."""
    records, worst = {}, 0
    for path in paths:
        kind, record = read(path)
        records[kind] = record
        worst |= _print(path, record.findings())
    if {VEHICLE, TRACK} <= set(records) and not worst:
        worst |= _print(paths[0].parent, findings_with(records[TRACK], records[VEHICLE]))
    if len(records) == len(NAMES) and not worst:
        _print_warnings(paths[0].parent)
    return worst


def _print_warnings(folder: Path) -> None:
    """Print what the networks of a whole configuration folder were not trained for."""
    from swift_ros.trained_for.folder import warnings

    if (folder / "nodes.yaml").is_file():
        for sentence in warnings(folder):
            print(f"{folder}: warning: {sentence}")


def _print(path: Path, findings: list[Finding]) -> int:
    for finding in findings:
        print(f"{path}: {finding.level}: {finding.sentence}")
    if not findings:
        print(f"{path}: nothing is impossible or odd")
    return int(any(finding.level == IMPOSSIBLE for finding in findings))


def read(path: Path):
    """Return (kind, record) of the file of a vehicle, a track or a camera. Raises UsageError."""
    from swift_ros.camera.model import Camera
    from swift_ros.track import Track
    from swift_ros.vehicle import Vehicle

    content = configuration.read_yaml(path)
    for kind, record_type in ((VEHICLE, Vehicle), (TRACK, Track), (CAMERA, Camera)):
        if kind in content:
            return kind, configuration.load_unchecked(record_type, path)
    raise UsageError(f"{path} has none of the keys '{VEHICLE}' (vehicle), '{TRACK}' (track) and '{CAMERA}' (camera)")


def check_result(folder: Path, out: str | None) -> int:
    """Compare a result with its bags; return 0 when all values agree, 1 otherwise. Raises UsageError on bad input."""
    stored = read_result(folder)
    computed = recompute(folder)
    if out:
        Path(out).mkdir(parents=True, exist_ok=True)
        (Path(out) / RESULT).write_text(json.dumps(computed, indent=1) + "\n")
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
