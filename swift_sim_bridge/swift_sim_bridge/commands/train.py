"""Train the pilot's policy or the gate detector; the same command resumes an interrupted training."""

import os
from pathlib import Path

KINDS = {
    "policy": "the pilot's policy, by PPO in the batched simulator",
    "detector": "the gate detector's network, on rendered images",
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
    parser.add_argument("--config", help="configuration folder")
    parser.add_argument("--vehicle", type=Path, metavar="FILE", help="another drone.yaml, as `gap` repairs one")
    parser.add_argument("--start-from", type=Path, help="another training's best.npz to start from")


def _add_detector_arguments(parser) -> None:
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument("--out", type=Path, default=Path("runs/detector"), help="folder of checkpoint and log")
    parser.add_argument("--steps", type=int, help="steps of the whole schedule (default: training.yaml)")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="end this session after so many minutes")
    parser.add_argument("--seed", type=int, help="training seed, 0..999 (default: training.yaml)")


def run_policy(arguments) -> int:
    """Train or resume a policy. Returns 0. Raises UsageError on bad input."""
    from swift_ros.configuration import configuration_folder
    from swift_sim_bridge.pilot.train import TrainingOptions, train_policy  # JAX takes seconds to import

    folder = configuration_folder(arguments.config)
    print(f"configuration: {folder}", flush=True)
    options = TrainingOptions(folder, arguments.out, arguments.seed, arguments.vehicle, arguments.start_from)
    train_policy(options)
    return 0


def run_detector(arguments) -> int:
    """Train or resume a gate detector. Returns 0. Raises UsageError on bad input."""
    # One thread: small convolutions are not faster with more. JAX reads this when it first computes.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    from swift_ros import configuration
    from swift_ros.camera.model import Camera
    from swift_ros.track import Track
    from swift_sim_bridge.gate_detector import train  # JAX takes seconds to import

    folder = configuration.configuration_folder(arguments.config)
    changes = {name: getattr(arguments, name) for name in ("steps", "seed") if getattr(arguments, name) is not None}
    settings = train.load_settings(folder, changes)
    camera = configuration.load(Camera, folder / "camera.yaml")
    track = configuration.load(Track, folder / "track.yaml")
    progress = train.train(settings, camera, track, arguments.out, minutes=arguments.minutes)
    end = "done" if progress.step >= settings.steps else "the same command resumes it"
    print(f"{arguments.out / 'gate_detector.onnx'}: step {progress.step} of {settings.steps}; {end}")
    return 0
