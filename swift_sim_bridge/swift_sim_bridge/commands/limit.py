"""Solve the time-optimal lap and race of a track and a vehicle, or compare flown races with them."""

import shlex
from pathlib import Path

import numpy as np

from swift_ros import configuration
from swift_ros.configuration import configuration_folder
from swift_ros.errors import UsageError
from swift_ros.plausibility.of_track import findings_with
from swift_ros.race import limit
from swift_ros.race.limit import Limit
from swift_ros.race.result import BAG
from swift_ros.results import fresh_folder
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle

PICTURE = "limit.png"
MOST_HEADROOM = 0.3  # above, a vehicle of little thrust cannot lift itself


def command(subparsers) -> None:
    """Add the parser of `swiftros limit`."""
    parser = subparsers.add_parser("limit", help=__doc__, description=__doc__)
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument("--track", type=Path, metavar="FILE", help="another track.yaml")
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="another drone.yaml, as `gap` repairs one")
    parser.add_argument("--out", type=Path, default=Path("runs/limit"), metavar="DIR", help="default: %(default)s")
    text = "share of the motor commands that is left to the rate loop, as flown (default: %(default)s)"
    parser.add_argument("--headroom", type=float, default=0.0, metavar="SHARE", help=text)
    text = "compare the races that `swiftros race` flew in this folder, by segment, with the limit in --out or --config"
    parser.add_argument("--race", type=Path, metavar="DIR", help=text)
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Solve or compare. Returns 0. Raises UsageError on bad input."""
    return compare(arguments) if arguments.race else solve(arguments)


def solve(arguments) -> int:
    """Solve the limit, and write it. Returns 0. Raises UsageError on bad input, or when no line is found."""
    from swift_sim_bridge.limit import picture, tables  # JAX and CasADi take seconds to import
    from swift_sim_bridge.limit.line import write_table
    from swift_sim_bridge.limit.models import TITLES
    from swift_sim_bridge.limit.race_rules import verdict
    from swift_sim_bridge.limit.solve import RACE, limit_of, solve_limit

    folder = configuration_folder(arguments.config)
    files = arguments.vehicle or folder / "drone.yaml", arguments.track or folder / "track.yaml"
    vehicle, track = (configuration.load(kind, file) for kind, file in zip((Vehicle, Track), files, strict=True))
    refuse(track, vehicle, files)
    if not 0.0 <= arguments.headroom <= MOST_HEADROOM:
        raise UsageError(
            f"--headroom {arguments.headroom:g} is no share from 0 to {MOST_HEADROOM:g}; give 0.05 for 5 %"
        )
    out = fresh_folder(arguments.out, (limit.FILE, PICTURE, "*.csv"))
    print(f"vehicle: {files[0]}; track: {files[1]}; results: {out}", flush=True)
    lines = solve_limit(vehicle, track, arguments.headroom, lambda line: print(line, flush=True))
    for course, by_model in lines.items():
        for model, line in by_model.items():
            write_table(line, out / f"{course}_{model}.csv")
    found = limit_of(lines, track, vehicle, arguments.headroom)
    limit.write(found, out / limit.FILE, command_line(arguments))
    picture.draw(out / PICTURE, lines, track, vehicle)
    print(tables.limit_table(found))
    print(tables.figures(lines, vehicle))
    for model, line in lines[RACE].items():
        print(f"race, {TITLES[model]}: {verdict(line, track, vehicle)}")
    print(f"it is {out / limit.FILE}; copy it to {limit.FOLDER}/ of the configuration folder to compare races with it")
    return 0


def command_line(arguments) -> str:
    """Return the command line that solves the same limit again."""
    chosen = {"--config": arguments.config, "--vehicle": arguments.vehicle, "--track": arguments.track}
    chosen |= {"--headroom": arguments.headroom or None}
    words = (word for option, value in chosen.items() if value is not None for word in (option, str(value)))
    return shlex.join(["swiftros", "limit", *words])


def refuse(track: Track, vehicle: Vehicle, files: tuple[Path, Path]) -> None:
    """Raise UsageError when the vehicle cannot be flown, or not on the track."""
    from swift_sim_bridge.limit.course import reach
    from swift_sim_bridge.simulation.checks import refuse_impossible

    refuse_impossible(vehicle)
    if found := findings_with(track, vehicle):
        raise UsageError(f"{files[1]}: {found[0].sentence}")
    if len(track.gates) < 2:
        raise UsageError(f"{files[1]} has one gate, to which no lap leads back; give two gates or more")
    tight = [i for i, side in enumerate(track.inner_sides, start=1) if 0.5 * side <= reach(vehicle)]
    if tight:
        raise UsageError(
            f"{files[1]}: the opening of gate {tight[0]} is {track.inner_sides[tight[0] - 1]:g} m wide, and the hull "
            f"of {files[0]} takes {2 * reach(vehicle):.2f} m when it is tilted; give a wider opening or a smaller hull"
        )


def compare(arguments) -> int:
    """Print the races in a folder against their limit, by segment. Returns 0. Raises UsageError without one."""
    from swift_ros.race.result import judge_again
    from swift_ros.recording.race_bag import read_record, recorded_configuration  # imports ROS
    from swift_sim_bridge.limit import tables

    races = sorted(path.parent for path in arguments.race.glob(f"seed-*/{BAG}"))
    if not races:
        raise UsageError(f"{arguments.race} holds no recorded race (seed-*/{BAG}); give a folder of `swiftros race`")
    track, vehicle = recorded_configuration(races[0] / BAG)
    found = limit_for(arguments, track, vehicle)
    flown = []
    for race in races:
        events = judge_again(read_record(race / BAG), *recorded_configuration(race / BAG))
        flown.append(np.array([event.split_s for event in events if event.is_passage]))
    print(f"{arguments.race} against the limit of {found.vehicle} on {found.track}, as flown")
    print(tables.flown_table(found, flown))
    return 0


def limit_for(arguments, track: Track, vehicle: Vehicle) -> Limit:
    """Return the limit in --out if it is of the track and the vehicle, else that of the configuration folder.

    Raises UsageError when there is none.
    """
    solved = arguments.out / limit.FILE
    if solved.is_file() and (found := configuration.load(Limit, solved)).key == limit.key_of(track, vehicle):
        return found
    found = limit.find(configuration_folder(arguments.config), track, vehicle)
    if found is None:
        raise UsageError(
            f"the limit of '{vehicle.name}' on '{track.name}' was not solved yet; call `swiftros limit --vehicle FILE "
            "--track FILE` with the files of the races"
        )
    return found
