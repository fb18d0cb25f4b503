"""Measure the gate detector on held-out images, the simulated firmware against the real one, the vehicle against the
paper's, a diagnosis against black boxes on unseen flights."""

import json
import sys
from pathlib import Path

SHIPPED_POSES = 4000  # as many as make a file small enough to ship


def command(subparsers):
    """Add `evaluate detector`, `evaluate firmware`, `evaluate vehicle` and `evaluate gap`."""
    parser = subparsers.add_parser("evaluate", help="measure a network, the simulated firmware or vehicle, a diagnosis")
    kinds = parser.add_subparsers(required=True, metavar="detector|firmware|vehicle|gap")
    kind = kinds.add_parser("detector", help="corner recall and precision on held-out images from flown poses")
    kind.add_argument("--config", metavar="DIR", help="configuration folder")
    kind.add_argument(
        "--poses",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="bags, .npz or .csv of flown poses (default: models/race_poses.npz of the configuration)",
    )
    kind.add_argument("--images", type=int, default=500, help="images with gates (default 500)")
    kind.add_argument("--empty", type=int, default=300, help="images of scenes without gates (default 300)")
    kind.add_argument("--seed", type=int, default=1000, help="of looks and poses, 1000 or more (default 1000)")
    kind.add_argument("--out", type=Path, default=Path("runs/evaluate-detector"), help="folder of result and pictures")
    kind.set_defaults(run=run_detector)
    kind = kinds.add_parser("firmware", help="motor commands against Betaflight SITL's, on the same gyro and sticks")
    kind.add_argument("--sitl", required=True, metavar="PATH", help="your binary of Betaflight 4.5 with gyro sync")
    kind.add_argument("--repeats", type=int, default=10, help="lives of the firmware a set-up (default 10)")
    kind.add_argument("--race", metavar="FLIGHT", help="bag or table of a recorded race, another sequence to feed both")
    kind.add_argument(
        "--out",
        type=Path,
        default=Path("runs/evaluate-firmware"),
        metavar="DIR",
        help="folder of result.json and the lives; goes on where an earlier run stopped",
    )
    kind.set_defaults(run=run_firmware)
    kind = kinds.add_parser("vehicle", help="hover, full thrust, and a race's thrust and power, beside the paper's")
    kind.add_argument("races", nargs="*", metavar="DIR", help="what `swiftros race` wrote (default: the model alone)")
    kind.add_argument("--config", metavar="DIR", help="configuration folder")
    kind.add_argument("--out", type=Path, default=Path("runs/evaluate-vehicle"), help="folder of result.json")
    kind.set_defaults(run=run_vehicle)
    kind = kinds.add_parser("gap", help="a diagnosis of one flight against kNN and GP, on flights that none has seen")
    kind.add_argument("--seeds", type=int, default=5, metavar="N", help="vehicles (default %(default)s)")
    kind.add_argument(
        "--seed",
        type=int,
        default=1000,
        metavar="S",
        help="the first: 0 to 999 to develop, 1000 to 9999 to test (default %(default)s)",
    )
    kind.add_argument("--review", action="store_true", help="allow seeds from 10000 up")
    kind.add_argument("--out", type=Path, default=Path("runs/evaluate-gap"), help="folder of result.json and picture")
    kind.set_defaults(run=run_gap)


def run_detector(arguments) -> int:
    """Evaluate, print the table, write result.json, pictures.png and poses.npz (what the images were drawn from, to be
    given again). Return 0. Raises UsageError on bad input."""
    from swift_ros import configuration
    from swift_ros.errors import UsageError
    from swift_sim_bridge.gate_detector import evaluate as evaluation
    from swift_sim_bridge.gate_detector import flown_poses, report

    if arguments.seed < 1000:
        raise UsageError(f"--seed {arguments.seed} belongs to training; give 1000 or more")
    folder = configuration.configuration_folder(arguments.config)
    stage = report.load(folder)
    poses = flown_poses.read_all(arguments.poses or [folder / "models" / "race_poses.npz"])
    tally = evaluation.evaluate(
        stage.detector,
        stage.camera,
        stage.track,
        stage.looks,
        stage.judged,
        poses,
        images=arguments.images,
        empty=arguments.empty,
        seed=arguments.seed,
        tell=_tell,
    )
    result = evaluation.figures(tally) | {"models": stage.models, "seed": arguments.seed, "poses": len(poses)}
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    poses.thinned(SHIPPED_POSES).save(arguments.out / "poses.npz")
    report.write_pictures(tally, arguments.out / "pictures.png")
    print(report.table(result))
    print(f"{arguments.out / 'result.json'}, {arguments.out / 'pictures.png'}")
    return 0


def run_firmware(arguments) -> int:
    """Compare, print the table and write result.json, that of the set-ups so far after each. Return 0 when every
    difference is within the limit, else 1. Raises UsageError on bad input, or when the firmware does not run."""
    from dataclasses import asdict
    from functools import partial

    import numpy as np

    from swift_ros.errors import UsageError
    from swift_ros.recording import flight_files
    from swift_sim_bridge.benchmarks import against_firmware, firmware_lives, firmware_sequences

    if arguments.repeats < 1:
        raise UsageError(f"--repeats {arguments.repeats} is no number of lives; give 1 or more")
    fed = firmware_sequences.sequences(seed=0)
    if arguments.race:
        flight = flight_files.read(arguments.race)
        fed["recorded race"] = firmware_sequences.recorded(flight, np.radians(600.0), start_s=1.0, seconds=3.0)
    rows, kept = [], arguments.out / "lives"
    tell = partial(print, file=sys.stderr, flush=True)
    for set_up in firmware_sequences.SET_UPS:
        lives = firmware_lives.lives(arguments.sitl, set_up, fed, arguments.repeats, kept, tell)
        rows += against_firmware.compare(lives, set_up, fed, tell)
        result = [asdict(row) | {"excess": row.excess} for row in rows]
        (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    print(against_firmware.table(rows))
    return 0 if all(row.excess <= against_firmware.LIMIT for row in rows) else 1


def run_vehicle(arguments) -> int:
    """Print the table and write result.json. Return 0. Raises UsageError on bad input."""
    from swift_ros import configuration
    from swift_ros.errors import UsageError
    from swift_ros.vehicle import Vehicle
    from swift_sim_bridge.benchmarks import vehicle_figures

    vehicle = configuration.load(Vehicle, configuration.configuration_folder(arguments.config) / "drone.yaml")
    races = []
    for folder in arguments.races:
        found = sorted(bag for bag in Path(folder).rglob("bag") if bag.is_dir())
        if not found:
            raise UsageError(f"{folder} holds no bag of a race; give what `swiftros race` wrote")
        races += [vehicle_figures.raced(bag, vehicle) for bag in found]
    result = vehicle_figures.figures(vehicle, races)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    print(vehicle_figures.table(result))
    return 0


def run_gap(arguments) -> int:
    """Judge, print the table, write result.json, after each seed, and rollouts.png. Return 0 when the ratios reach
    their targets, else 1. Raises UsageError on bad input."""
    from functools import partial

    from swift_ros.errors import UsageError
    from swift_sim_bridge.benchmarks import unseen_flights, unseen_flights_picture
    from swift_sim_bridge.referee.cases import check_seed

    if arguments.seeds < 1:
        raise UsageError(f"--seeds {arguments.seeds} is no number of vehicles; give 1 or more")
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    for seed in seeds:
        check_seed(seed, arguments.review)
    arguments.out.mkdir(parents=True, exist_ok=True)
    result, picture, records = arguments.out / "result.json", arguments.out / "rollouts.png", []
    for seed in seeds:
        print(f"seed {seed}", file=sys.stderr)
        records.append(unseen_flights.judge(seed, partial(print, file=sys.stderr, flush=True)))
        result.write_text(json.dumps(records, indent=1) + "\n")
    unseen_flights_picture.draw(records, picture)
    print(unseen_flights.table(records))
    print(f"{result}, {picture}")
    return 0 if unseen_flights.met(records) else 1


def _tell(done, of):
    if done % 50 == 0 or done == of:
        print(f"\r{done} of {of} images", end="\n" if done == of else "", file=sys.stderr, flush=True)
