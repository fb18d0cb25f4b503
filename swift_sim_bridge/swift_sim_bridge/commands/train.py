"""Train the pilot's policy or the gate detector; the same command resumes an interrupted training or prolongs it."""

import dataclasses
import os
from argparse import ArgumentTypeError
from pathlib import Path

from swift_ros.text import excerpt

KINDS = {
    "policy": "the pilot's policy, by PPO in the batched simulator",
    "detector": "the gate detector's network, on rendered, labelled and composed images",
}


def command(subparsers) -> None:
    """Add the parsers of `swiftros train policy` and `swiftros train detector`."""
    parser = subparsers.add_parser("train", help="train a network")
    kinds = parser.add_subparsers(required=True, metavar="|".join(KINDS))
    policy, detector = (kinds.add_parser(name, help=text, description=text) for name, text in KINDS.items())
    _add_policy_arguments(policy)
    policy.set_defaults(run=run_policy)
    _add_detector_arguments(detector)
    detector.set_defaults(run=run_detector)


def _add_policy_arguments(parser) -> None:
    parser.add_argument("--out", type=Path, default=Path("runs/policy"), help="folder of checkpoints and the model")
    parser.add_argument("--seed", type=int, default=0, help="of networks, races and noise (default 0)")
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument("--track", type=Path, metavar="FILE", help="another track.yaml")
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="another drone.yaml, as `gap` repairs one")
    text = "length of the whole training (default: training.yaml); more than before prolongs a finished one"
    parser.add_argument("--interactions", type=_count, metavar="N", help=text)
    text = "begin with another pilot: its pilot.npz or pilot.onnx, or the shipped one"
    parser.add_argument("--start-from", metavar="FILE|shipped", help=text)
    text = "a folder of `swiftros limit`: episodes start along its time-optimal lap, and leaving it costs"
    parser.add_argument("--guide", type=Path, metavar="DIR", help=text)
    text = "what is other than in training.yaml, as in config/trainings; a folder: one training with each of its files"
    parser.add_argument("--settings", type=Path, metavar="FILE|DIR", help=text)


def _add_detector_arguments(parser) -> None:
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument("--out", type=Path, default=Path("runs/detector"), help="folder of checkpoint and log")
    text = "length of the whole training (default: training.yaml); more than before prolongs a finished one"
    parser.add_argument("--steps", type=_count, metavar="N", help=text)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="end this session after so many minutes")
    parser.add_argument("--seed", type=int, help="training seed, 0..999 (default: training.yaml)")
    text = "folders of labelled images (`swiftros label`), which take 'labelled_share' of the examples"
    parser.add_argument("--images", type=Path, nargs="+", default=[], metavar="DIR", help=text)
    parser.add_argument("--fov-deg", type=float, metavar="DEG", help="horizontal field of view, without a camera.yaml")
    text = "photographs without gates, backgrounds of composed images ('composed_share')"
    parser.add_argument("--photographs", type=Path, metavar="DIR", help=text)
    text = "your gates for composed images: meshes, labelled photographs, or frontal PNG pictures with transparency"
    parser.add_argument("--own-gates", type=Path, metavar="DIR", help=text)
    text = "begin with another detector: its gate_detector.onnx, or the shipped one"
    parser.add_argument("--start-from", metavar="FILE|shipped", help=text)


def _count(text: str) -> int:
    """Return a positive whole number. Raises ArgumentTypeError, to which argparse adds the name of the option."""
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"'{excerpt(text)}' is not a whole number above 0")
    return int(text)


def run_policy(arguments) -> int:
    """Train or resume a policy. Returns 0. Raises UsageError on bad input."""
    from swift_ros.configuration import configuration_folder
    from swift_sim_bridge.parallel import use_all_cores
    from swift_sim_bridge.pilot.job import TrainingOptions  # JAX takes seconds to import
    from swift_sim_bridge.pilot.stages import train_in_stages
    from swift_sim_bridge.pilot.train import train_policy

    use_all_cores()
    folder = configuration_folder(arguments.config)
    print(f"configuration: {folder}", flush=True)
    options = TrainingOptions(
        folder=folder,
        out=arguments.out,
        seed=arguments.seed,
        track=arguments.track,
        vehicle=arguments.vehicle,
        interactions=arguments.interactions,
        start_from=arguments.start_from,
        guide=arguments.guide,
    )
    if arguments.settings and arguments.settings.is_dir():
        train_in_stages(options, arguments.settings)
    else:
        train_policy(dataclasses.replace(options, settings=arguments.settings))
    return 0


def run_detector(arguments) -> int:
    """Train or resume a gate detector. Returns 0. Raises UsageError on bad input."""
    # One thread: small convolutions are not faster with more. JAX reads this when it first computes.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    from swift_ros import configuration
    from swift_ros.camera.model import Camera
    from swift_ros.track import Track
    from swift_sim_bridge.gate_detector.training import job, train  # JAX takes seconds to import
    from swift_sim_bridge.gate_detector.training.settings import load_settings
    from swift_sim_bridge.labels import folder as labels

    folder = configuration.configuration_folder(arguments.config)
    changes = {name: getattr(arguments, name) for name in ("steps", "seed") if getattr(arguments, name) is not None}
    settings = load_settings(folder, changes)
    chosen = job.DetectorJob(
        settings=settings,
        camera=configuration.load(Camera, folder / "camera.yaml"),
        track=configuration.load(Track, folder / "track.yaml"),
        out=arguments.out,
        folders=tuple(labels.read(path, arguments.fov_deg) for path in arguments.images),
        photographs=arguments.photographs,
        own_gates=arguments.own_gates,
        fov_deg=arguments.fov_deg,
        first=job.first_network(arguments.start_from) if arguments.start_from else None,
    )
    progress = train.train(chosen, minutes=arguments.minutes)
    end = "done" if progress.step >= settings.steps else "the same command resumes it"
    print(f"{arguments.out / 'gate_detector.onnx'}: step {progress.step} of {settings.steps}; {end}")
    return 0
