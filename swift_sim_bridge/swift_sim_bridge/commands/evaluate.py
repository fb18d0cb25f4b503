"""Measure the gate detector on held-out images, the simulated firmware against the real one, the vehicle against the
paper's, the state estimate in races, what a pilot withstands, and a diagnosis against black-box models on unseen
flights."""

import json
import sys
from pathlib import Path

SHIPPED_POSES = 4000  # largest number of poses in poses.npz, so that the file is small enough to ship
PROGRESS_EVERY = 50  # images


def command(subparsers):
    """Add `evaluate` with all that can be measured."""
    text = "measure a network, the simulated firmware or vehicle, the state estimate, a diagnosis"
    parser = subparsers.add_parser("evaluate", help=text)
    kinds = parser.add_subparsers(required=True, metavar="detector|firmware|vehicle|estimate|pilot|gap")
    for add in (_add_detector, _add_firmware, _add_vehicle, _add_estimate, _add_pilot, _add_gap):
        add(kinds)


def _add_detector(kinds) -> None:
    kind = kinds.add_parser("detector", help="corner recall and precision on held-out rendered or on labelled images")
    kind.add_argument("--config", metavar="DIR", help="configuration folder")
    kind.add_argument(
        "--poses",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="bags, .npz or .csv of flown poses (default: models/race_poses.npz of the configuration)",
    )
    kind.add_argument(
        "--images", type=Path, metavar="DIR", help="labelled images (`swiftros label`) instead of rendered"
    )
    kind.add_argument("--fov-deg", type=float, metavar="DEG", help="horizontal field of view, without a camera.yaml")
    kind.add_argument("--inner-side", type=float, metavar="M", help="of the gates of --images, for errors of the pose")
    kind.add_argument("--level", action="store_true", help="take cameras of --images without attitude to be level")
    kind.add_argument("--rendered", type=int, default=500, metavar="N", help="images with gates (default 500)")
    kind.add_argument("--empty", type=int, default=300, help="images of scenes without gates (default 300)")
    kind.add_argument("--seed", type=int, default=1000, help="of looks and poses, 1000 or more (default 1000)")
    kind.add_argument("--out", type=Path, default=Path("runs/evaluate-detector"), help="folder of result and pictures")
    kind.set_defaults(run=run_detector)


def _add_firmware(kinds) -> None:
    kind = kinds.add_parser("firmware", help="motor commands against Betaflight SITL's, on the same gyro and sticks")
    kind.add_argument("--sitl", required=True, metavar="PATH", help="Betaflight 4.5 SITL binary with gyro sync")
    kind.add_argument("--repeats", type=int, default=10, help="runs of the firmware a set-up (default 10)")
    kind.add_argument("--race", metavar="FLIGHT", help="bag or table of a recorded race, as another sequence")
    kind.add_argument(
        "--out",
        type=Path,
        default=Path("runs/evaluate-firmware"),
        metavar="DIR",
        help="folder of result.json and the firmware runs; an interrupted comparison resumes",
    )
    kind.set_defaults(run=run_firmware)


def _add_vehicle(kinds) -> None:
    kind = kinds.add_parser("vehicle", help="hover, full thrust, and a race's thrust and power, beside the paper's")
    kind.add_argument("races", nargs="*", metavar="DIR", help="what `swiftros race` wrote (default: the model alone)")
    kind.add_argument("--config", metavar="DIR", help="configuration folder")
    kind.add_argument("--out", type=Path, default=Path("runs/evaluate-vehicle"), help="folder of result.json")
    kind.set_defaults(run=run_vehicle)


def _add_estimate(kinds) -> None:
    text = "errors of the state estimate and delay of commands in races, for the training of a pilot"
    kind = kinds.add_parser("estimate", help=text)
    kind.add_argument("races", nargs="+", type=Path, metavar="DIR", help="what `swiftros race` wrote")
    kind.set_defaults(run=run_estimate)


def _add_pilot(kinds) -> None:
    kind = kinds.add_parser(
        "pilot", help="what a pilot withstands: another mass, thrust, drag, delay, estimate, battery"
    )
    kind.add_argument("--config", metavar="DIR", help="configuration folder")
    kind.add_argument("--pilot", type=Path, metavar="FILE", help="another pilot.onnx")
    kind.add_argument("--track", type=Path, metavar="FILE", help="another track.yaml")
    kind.add_argument("--vehicle", type=Path, metavar="FILE", help="another drone.yaml")
    kind.add_argument("--races", type=int, default=100, metavar="N", help="of each row (default %(default)s)")
    kind.add_argument("--seed", type=int, default=0, metavar="S", help="of the races (default %(default)s)")
    kind.add_argument("--out", type=Path, default=Path("runs/evaluate-pilot"), help="folder of result.json")
    kind.set_defaults(run=run_pilot)


def _add_gap(kinds) -> None:
    kind = kinds.add_parser("gap", help="a diagnosis of one flight against kNN and GP, on unseen flights")
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
    """Evaluate, print the table, write result.json, pictures.png and poses.npz (the poses, for another evaluation).

    Returns 0. Raises UsageError on bad input.
    """
    from swift_ros import configuration
    from swift_ros.errors import UsageError

    if arguments.images:
        return run_labelled_images(arguments)
    from swift_sim_bridge.gate_detector.evaluation import evaluate, flown_poses, report
    from swift_sim_bridge.gate_detector.evaluation.setup import load_setup

    if arguments.seed < 1000:
        raise UsageError(f"--seed {arguments.seed} belongs to training; give 1000 or more")
    folder = configuration.configuration_folder(arguments.config)
    setup = load_setup(folder)
    poses = flown_poses.read_all(arguments.poses or [folder / "models" / "race_poses.npz"])
    sample = evaluate.ImageSample(arguments.rendered, arguments.empty, arguments.seed)
    tally = evaluate.evaluate(setup, poses, sample, progress=_print_images_done)
    result = evaluate.figures(tally) | {"models": setup.models, "seed": arguments.seed, "poses": len(poses)}
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    poses.thinned(SHIPPED_POSES).save(arguments.out / "poses.npz")
    report.write_pictures(tally, arguments.out / "pictures.png")
    print(report.table(result))
    print(f"{arguments.out / 'result.json'}, {arguments.out / 'pictures.png'}")
    return 0


def run_labelled_images(arguments) -> int:
    """Evaluate on labelled images, print the table, write result.json and worst.png.

    Returns 0. Raises UsageError on bad input.
    """
    from swift_ros import configuration
    from swift_ros.errors import UsageError
    from swift_sim_bridge.gate_detector.evaluation import image_report
    from swift_sim_bridge.gate_detector.evaluation.image_scores import ImageEvaluation, figures
    from swift_sim_bridge.gate_detector.evaluation.setup import load_setup
    from swift_sim_bridge.labels import folder

    if arguments.inner_side is not None and not 0.0 < arguments.inner_side < 100.0:
        raise UsageError(f"--inner-side {arguments.inner_side:g} is no side of a gate in metres")
    images = folder.read(arguments.images, arguments.fov_deg)
    setup = load_setup(configuration.configuration_folder(arguments.config))
    least_px = setup.limits.least_side_px
    evaluation = ImageEvaluation(images, setup.detector, least_px, arguments.inner_side, arguments.level)
    for number, image in enumerate(images.images, start=1):
        evaluation.add(image)
        _print_images_done(number, len(images.images))
    result = figures(evaluation.tally) | {"models": setup.models, "folder": str(arguments.images)}
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    image_report.write_worst(images, evaluation.tally, arguments.out / "worst.png")
    print(image_report.table(result, images, least_px, arguments.level))
    print(f"{arguments.out / 'result.json'}, {arguments.out / 'worst.png'}")
    return 0


def run_firmware(arguments) -> int:
    """Compare, print the table and write result.json after each set-up.

    Returns 0 if every difference is within the limit, else 1. Raises UsageError on bad input, or if the firmware does
    not run.
    """
    from dataclasses import asdict
    from functools import partial

    import numpy as np

    from swift_ros.errors import UsageError
    from swift_ros.recording import flight_files
    from swift_sim_bridge.benchmarks import against_firmware, firmware_runs, firmware_sequences

    if arguments.repeats < 1:
        raise UsageError(f"--repeats {arguments.repeats} is no number of runs; give 1 or more")
    sequences = firmware_sequences.sequences(seed=0)
    if arguments.race:
        flight = flight_files.read(arguments.race)
        sequences["recorded race"] = firmware_sequences.recorded(flight, np.radians(600.0), start_s=1.0, seconds=3.0)
    rows, saved = [], arguments.out / "runs"
    progress = partial(print, file=sys.stderr, flush=True)
    for set_up in firmware_sequences.SET_UPS:
        runs = firmware_runs.firmware_runs(arguments.sitl, set_up, sequences, arguments.repeats, saved, progress)
        rows += against_firmware.compare(runs, set_up, sequences, progress)
        result = [asdict(row) | {"excess": row.excess} for row in rows]
        (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    print(against_firmware.table(rows))
    return 0 if all(row.excess <= against_firmware.LIMIT for row in rows) else 1


def run_vehicle(arguments) -> int:
    """Print the table and write result.json. Returns 0. Raises UsageError on bad input."""
    from swift_ros import configuration
    from swift_ros.vehicle import Vehicle
    from swift_sim_bridge.benchmarks import vehicle_figures

    vehicle = configuration.load(Vehicle, configuration.configuration_folder(arguments.config) / "drone.yaml")
    races = [vehicle_figures.race_means(bag, vehicle) for folder in arguments.races for bag in _bags(Path(folder))]
    result = vehicle_figures.figures(vehicle, races)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    print(vehicle_figures.table(result))
    return 0


def run_estimate(arguments) -> int:
    """Print a settings file of `swiftros train policy`. Returns 0. Raises UsageError on bad input."""
    import yaml

    from swift_ros import configuration
    from swift_sim_bridge.benchmarks import command_delay, estimate_errors

    bags = [bag for folder in arguments.races for bag in _bags(folder)]
    found = {"estimate_errors": configuration.content(estimate_errors.measure(bags))}
    print(f"# of {len(bags)} races; a file for `swiftros train policy --settings`, or lines of training.yaml")
    if delay_s := command_delay.measure(bags):
        found["environment"] = {"command_delay_s": delay_s}
    else:
        print("# commands take no time in lockstep; races in real time show environment.command_delay_s, too")
    print(yaml.safe_dump({"policy": found}, sort_keys=False), end="")
    return 0


def run_pilot(arguments) -> int:
    """Fly races, print the table, write result.json. Returns 0. Raises UsageError on bad input."""
    from functools import partial

    from swift_ros import configuration
    from swift_ros.errors import UsageError
    from swift_ros.text import align
    from swift_sim_bridge.parallel import use_all_cores
    from swift_sim_bridge.pilot import robustness

    if arguments.races < 1:
        raise UsageError(f"--races {arguments.races} is no number of races; give 1 or more")
    use_all_cores()
    folder = configuration.configuration_folder(arguments.config)
    files = robustness.Files(
        folder=folder,
        pilot=arguments.pilot or folder / "models" / "pilot.onnx",
        track=arguments.track or folder / "track.yaml",
        vehicle=arguments.vehicle or folder / "drone.yaml",
    )
    result = robustness.measure(files, arguments.races, arguments.seed, partial(print, file=sys.stderr, flush=True))
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    print(align(robustness.table(result)))
    return 0


def _bags(folder: Path) -> list[Path]:
    """Return the bags of the races in a folder. Raises UsageError without one."""
    from swift_ros.errors import UsageError

    found = sorted(bag for bag in folder.rglob("bag") if bag.is_dir())
    if not found:
        raise UsageError(f"{folder} holds no bag of a race; give what `swiftros race` wrote")
    return found


def run_gap(arguments) -> int:
    """Evaluate, print the table, write result.json after each seed, and rollouts.png.

    Returns 0 if the ratios reach their targets, else 1. Raises UsageError on bad input.
    """
    from functools import partial

    from swift_ros.errors import UsageError
    from swift_sim_bridge.benchmarks import unseen_flights, unseen_flights_picture
    from swift_sim_bridge.referee.families import check_seed

    if arguments.seeds < 1:
        raise UsageError(f"--seeds {arguments.seeds} is no number of vehicles; give 1 or more")
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    for seed in seeds:
        check_seed(seed, arguments.review)
    arguments.out.mkdir(parents=True, exist_ok=True)
    result, picture, records = arguments.out / "result.json", arguments.out / "rollouts.png", []
    for seed in seeds:
        print(f"seed {seed}", file=sys.stderr)
        records.append(unseen_flights.evaluate(seed, partial(print, file=sys.stderr, flush=True)))
        result.write_text(json.dumps(records, indent=1) + "\n")
    unseen_flights_picture.draw(records, picture)
    print(unseen_flights.table(records))
    print(f"{result}, {picture}")
    return 0 if unseen_flights.met(records) else 1


def _print_images_done(done: int, total: int) -> None:
    if done % PROGRESS_EVERY == 0 or done == total:
        print(f"\r{done} of {total} images", end="\n" if done == total else "", file=sys.stderr, flush=True)
