"""Train the pilot's policy or the gate detector; an interrupted training goes on where it was."""

import importlib

TRAININGS = {
    "policy": ("pilot.ppo", "the pilot's policy, by PPO in the batched simulator"),
    "detector": ("gate_detector.train", "the gate detector's network, on rendered images"),
}


def command(subparsers):
    """Add `train policy` and `train detector`."""
    parser = subparsers.add_parser("train", help="train a network")
    kinds = parser.add_subparsers(required=True, metavar="|".join(TRAININGS))
    for name, (module, meaning) in TRAININGS.items():
        kind = kinds.add_parser(name, help=meaning, description=meaning)
        training = importlib.import_module(f"swift_sim_bridge.{module}")
        training.add_arguments(kind)
        kind.set_defaults(run=training.run)
