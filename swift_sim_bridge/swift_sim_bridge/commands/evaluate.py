"""Measure what a trained network can do: the gate detector on held-out images."""

import json
import sys
from pathlib import Path

SHIPPED_POSES = 4000  # as many as make a file small enough to ship


def command(subparsers):
    """Add `evaluate detector`."""
    parser = subparsers.add_parser("evaluate", help="measure a trained network")
    kinds = parser.add_subparsers(dest="network", required=True)
    kind = kinds.add_parser("detector", help="corner recall and precision on held-out images from flown poses")
    kind.add_argument("--config", metavar="DIR", help="configuration folder")
    kind.add_argument("--poses", type=Path, nargs="+", metavar="FILE",
                      help="bags, .npz or .csv of flown poses (default: models/race_poses.npz of the configuration)")
    kind.add_argument("--images", type=int, default=500, help="images with gates (default 500)")
    kind.add_argument("--empty", type=int, default=300, help="images of scenes without gates (default 300)")
    kind.add_argument("--seed", type=int, default=1000, help="of looks and poses, 1000 or more (default 1000)")
    kind.add_argument("--out", type=Path, default=Path("runs/evaluate-detector"), help="folder of result and pictures")
    kind.set_defaults(run=run_detector)


def run_detector(arguments) -> int:
    """Evaluate, print the table, write result.json, pictures.png and poses.npz (what the images were drawn from, to be
    given again). Return 0. Raises UsageError on bad input."""
    from swift_ros import configuration
    from swift_ros.errors import UsageError
    from swift_sim_bridge.evaluation import detector as evaluation
    from swift_sim_bridge.evaluation import detector_report, flown_poses

    if arguments.seed < 1000:
        raise UsageError(f"--seed {arguments.seed} belongs to training; give 1000 or more")
    folder = configuration.configuration_folder(arguments.config)
    stage = detector_report.load(folder)
    poses = flown_poses.read_all(arguments.poses or [folder / "models" / "race_poses.npz"])
    tally = evaluation.evaluate(
        stage.detector, stage.camera, stage.track, stage.looks, stage.judged, poses,
        images=arguments.images, empty=arguments.empty, seed=arguments.seed, tell=_tell,
    )  # fmt: skip
    result = evaluation.figures(tally) | {"models": stage.models, "seed": arguments.seed, "poses": len(poses)}
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "result.json").write_text(json.dumps(result, indent=2) + "\n")
    poses.thinned(SHIPPED_POSES).save(arguments.out / "poses.npz")
    detector_report.write_pictures(tally, arguments.out / "pictures.png")
    print(detector_report.table(result))
    print(f"{arguments.out / 'result.json'}, {arguments.out / 'pictures.png'}")
    return 0


def _tell(done, of):
    if done % 50 == 0 or done == of:
        print(f"\r{done} of {of} images", end="\n" if done == of else "", file=sys.stderr, flush=True)
