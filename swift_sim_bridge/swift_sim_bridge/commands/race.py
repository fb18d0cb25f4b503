"""Fly whole races through the node graph and the simulator; write results, bags and pictures."""

import contextlib
import json
import os
import time
from pathlib import Path

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.configuration import configuration_folder
from swift_ros.errors import UsageError
from swift_ros.graph.discovery import DISCOVERY
from swift_ros.graph.domain import RunDomain
from swift_ros.plausibility.of_track import findings_with
from swift_ros.race import limit
from swift_ros.race.result import REPORT, RESULT, RaceResult, model_hashes, summary
from swift_ros.results import fresh_folder
from swift_ros.track import Track
from swift_ros.trained_for.folder import warnings
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.sitl.program import executable
from swift_sim_bridge.seeds import check_seeds

# of a configuration folder, which the nodes of a race read
FILES = ("camera.yaml", "drone.yaml", "models", "nodes.yaml", "simulation.yaml", "track.yaml")
# what the options of `race` and `sim` replace
OTHERS = {"track": "track.yaml", "vehicle": "drone.yaml", "camera": "camera.yaml"}


def command(subparsers) -> None:
    """Add the parser of `swiftros race`."""
    parser = subparsers.add_parser("race", help=__doc__, description=__doc__)
    parser.add_argument("--seed", type=int, help="fly one race with this seed")
    parser.add_argument("--seeds", type=int, metavar="K", help="fly K races with consecutive seeds (default: one)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N", help="first of the consecutive seeds")
    add_files(parser)
    add_flight_controller(parser)
    parser.add_argument("--out", metavar="DIR", default="recordings/race", help="for results (default: %(default)s)")
    parser.add_argument("--real-time", action="store_true", help="system clock: nothing waits for a late node")
    parser.add_argument("--land", action="store_true", help="fly and record until the vehicle stands on the ground")
    parser.add_argument(
        "--discovery", choices=DISCOVERY, default="local", help="who can reach the graph (default: %(default)s)"
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Fly races. Returns 0 if all finished, else 1. Raises UsageError on bad input."""
    from swift_sim_bridge.racing import race, tables  # rclpy and matplotlib take a second to import

    seeds = chosen_seeds(arguments)
    sitl = chosen_sitl(arguments)
    files = chosen_files(arguments.config, **other_files(arguments))
    RunDomain().close()  # one that is in use is refused before earlier results are removed
    out = fresh_folder(Path(arguments.out), (RESULT, "config", "seed-*"))
    folder = configure(out, files)
    print(f"configuration: {folder}; results: {out}")
    if not sitl:
        print_unmodelled(folder)
    print_warnings(folder)
    results, started_s = [], time.monotonic()
    for count, seed in enumerate(seeds):
        print(f"seed {seed}, race {count + 1} of {len(seeds)}{_remaining(count, len(seeds), started_s)}", flush=True)
        options = race.RaceOptions(
            config=folder,
            out=out / f"seed-{seed}",
            real_time=arguments.real_time,
            discovery=arguments.discovery,
            progress=lambda line: print(line, flush=True),
            sitl=sitl,
            land=arguments.land,
        )
        try:
            race.fly(seed, options)
        except KeyboardInterrupt:
            _keep(options.out, out, results, folder)
            raise
        results.append(conclude(options.out, folder))
        if arguments.real_time:
            print(f"  {lateness(options.out)}", flush=True)
        write_summary(out, results, folder)
    print(tables.races(results))
    print(tables.totals(results))
    print_limit(folder, results)
    return 0 if all(result.finished for result in results) else 1


def chosen_seeds(arguments) -> list[int]:
    """Return the seeds to fly. Raises UsageError if the options exclude each other or no race is left."""
    if arguments.seed is not None and arguments.seeds is not None:
        raise UsageError("--seed and --seeds exclude each other; give --seeds K --first-seed N for more than one")
    number = 1 if arguments.seeds is None else arguments.seeds
    first = arguments.first_seed if arguments.seed is None else arguments.seed
    if number < 1:
        raise UsageError(f"--seeds {number} leaves no race to fly; give 1 or more")
    check_seeds(first, first + number - 1)
    return list(range(first, first + number))


def add_files(parser) -> None:
    """Add the options of `race` and `sim` that choose the files to fly with."""
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    for option, name in OTHERS.items():
        parser.add_argument(f"--{option}", metavar="FILE", help=f"another {name}")
    parser.add_argument("--pilot", metavar="FILE", help="another pilot.onnx, with its .json beside it")


def other_files(arguments) -> dict[str, str | None]:
    """Return the files that replace those of the configuration folder, for `chosen_files`."""
    return {option: getattr(arguments, option) for option in (*OTHERS, "pilot")}


def add_flight_controller(parser) -> None:
    """Add the options of `race` and `sim` that choose the flight controller."""
    text = "simulated firmware (default), or Betaflight SITL"
    parser.add_argument("--flight-controller", choices=("simulated", "sitl"), default="simulated", help=text)
    parser.add_argument("--sitl", metavar="PATH", help="Betaflight SITL binary, for --flight-controller sitl")


def print_unmodelled(folder: Path) -> None:
    """Print the settings of the vehicle's flight controller (its CLI dump) that are not simulated."""
    from swift_sim_bridge.flight_controller.configuration.controller_section import unmodelled

    settings = unmodelled(configuration.load(Vehicle, folder / "drone.yaml"))
    if settings:
        print("not simulated of the flight controller's set-up: " + "; ".join(settings), flush=True)


def print_warnings(folder: Path) -> None:
    """Print what the networks of a configuration folder were not trained for."""
    for sentence in warnings(folder):
        print(f"warning: {sentence}", flush=True)


def print_limit(folder: Path, results: list[RaceResult]) -> None:
    """Print the laps and races as multiples of the physical limit, where it is known for the track and the vehicle."""
    track = configuration.load(Track, folder / "track.yaml")
    found = limit.find(folder, track, configuration.load(Vehicle, folder / "drone.yaml"))
    if found and (text := limit.sentence(found, results)):
        print(text)


def chosen_sitl(arguments) -> str:
    """Return the absolute path of the SITL binary to fly with, "" for none. Raises UsageError if it is missing."""
    if arguments.flight_controller != "sitl":
        if arguments.sitl:
            raise UsageError("--sitl goes with --flight-controller sitl; give both")
        return ""
    if not arguments.sitl:
        raise UsageError("--flight-controller sitl needs --sitl PATH, a Betaflight binary (docs/simulation/sitl.md)")
    return str(executable(arguments.sitl))


def chosen_files(config, **others) -> dict[str, Path]:
    """Return the files to fly with, by their path in a configuration folder.

    Args:
        config: the configuration folder; None: that of the repository.
        others: files in place of those of the folder, or None, by the names in OTHERS and "pilot".

    Raises:
        UsageError: a file cannot be read, or the track is impossible for the vehicle.
    """
    folder = configuration_folder(config)
    files = {path.name: path for path in folder.iterdir()}
    files |= {OTHERS[name]: Path(path) for name, path in others.items() if path and name in OTHERS}
    if missing := sorted(set(FILES) - set(files)):
        raise UsageError(f"{folder} has no {', '.join(missing)}; copy them from the folder config of the repository")
    track = configuration.load(Track, files["track.yaml"])
    configuration.load(Camera, files["camera.yaml"])
    if found := findings_with(track, configuration.load(Vehicle, files["drone.yaml"])):
        raise UsageError(f"{files['track.yaml']}: {found[0].sentence}")
    return files if others.get("pilot") is None else _with_pilot(files, Path(others["pilot"]))


def _with_pilot(files: dict[str, Path], pilot: Path) -> dict[str, Path]:
    """Return the files with another pilot and its provenance in place of those in the folder of models."""
    if not pilot.is_file() or pilot.suffix != ".onnx":
        raise UsageError(f"--pilot names {pilot}, which is no file .onnx; name the pilot.onnx of a training")
    name = Path(str(configuration.read_section(files["nodes.yaml"], "policy")["model"]))
    models = {f"models/{path.name}": path for path in files.pop("models").iterdir()}
    models.pop(str(name.with_suffix(".json")), None)
    new = {str(name): pilot}
    if (provenance := pilot.with_suffix(".json")).is_file():
        new[str(name.with_suffix(".json"))] = provenance
    return files | models | new


def configure(out: Path, files: dict[str, Path]) -> Path:
    """Return a folder that holds `files`: their common folder, or a new one in `out` with links to them."""
    folders = {path.parent for path in files.values()}
    if len(folders) == 1:
        return folders.pop()
    linked = out / "config"
    for name, path in files.items():
        (linked / name).parent.mkdir(parents=True, exist_ok=True)
        os.symlink(path.resolve(), linked / name)
    return linked


def conclude(folder: Path, config: Path) -> RaceResult:
    """Draw the picture of the race in `folder` and return its result."""
    from swift_ros.recording.race_bag import read_race
    from swift_sim_bridge.racing import picture

    track = configuration.load(Track, config / "track.yaml")
    vehicle = configuration.load(Vehicle, config / "drone.yaml")
    result, record = read_race(folder, track, vehicle)
    picture.draw(record, result, track, vehicle, folder / "flight.png")
    return result


def lateness(folder: Path) -> str:
    """Return what was late in a real-time race, by the simulator's report, as text."""
    path = folder / REPORT
    if not path.is_file():
        return "the simulator left no report"
    report = json.loads(path.read_text())
    parts = (f"{report[f'late_{what}']} {what}" for what in ("images", "commands", "ticks"))
    drift = report.get("firmware_drift_s")
    lag = "" if drift is None else f"; at most {drift:.3f} s behind the firmware's clock"
    return f"late: {', '.join(parts)} of {report['ticks']} ticks{lag}"


def _keep(flown: Path, out: Path, results: list[RaceResult], config: Path) -> None:
    """Write the result of an interrupted race beside those of the races before it, if it was recorded at all."""
    with contextlib.suppress(UsageError):
        write_summary(out, [*results, conclude(flown, config)], config)
        print(f"interrupted; {out / RESULT} has what was flown", flush=True)


def write_summary(out: Path, results: list[RaceResult], config: Path) -> None:
    """Write `result.json` of the races flown so far."""
    content = summary(results, model_hashes(config))
    (out / RESULT).write_text(json.dumps(content, indent=1) + "\n")


def _remaining(done: int, total: int, started_s: float) -> str:
    """Return the estimated time left as text, "" before the first race is done."""
    if not done:
        return ""
    left_s = (time.monotonic() - started_s) / done * (total - done)
    return f", about {left_s / 60:.0f} min left" if left_s > 90 else f", about {left_s:.0f} s left"
