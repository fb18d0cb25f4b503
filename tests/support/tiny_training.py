"""Trainings of the policy that take seconds: their settings, the command, and what they leave behind."""

import argparse
import json

import yaml

from swift_ros import configuration
from swift_sim_bridge.commands import train as command

FOLDER = configuration.configuration_folder()
TINY = {"interactions": 256, "agents": 4, "steps": 16, "trial_every": 64}
TINY |= {"trial_races": 2, "final_races": 2}
TINY |= {"fine_tuning": {"interactions": 128, "critic_first": 64, "schedule_share": 0.75}}


def write_configuration(folder):
    """Write a configuration folder whose training takes seconds."""
    folder.mkdir()
    for name in ("drone.yaml", "track.yaml", "camera.yaml"):
        (folder / name).write_text((FOLDER / name).read_text())
    training = yaml.safe_load((FOLDER / "training.yaml").read_text())
    training["policy"] |= TINY
    training["policy"]["ppo"] |= {"minibatch": 32, "epochs": 1}
    training["policy"]["environment"] |= {"bank_size": 4, "bank_fixed": 2}
    (folder / "training.yaml").write_text(yaml.safe_dump(training))


def train(folder, out, *options):
    parser = argparse.ArgumentParser()
    command.command(parser.add_subparsers())
    arguments = parser.parse_args(["train", "policy", "--config", str(folder), "--out", str(out), *options])
    return arguments.run(arguments)


def rewrite(folder, section, **values):
    """Change values of a section of a configuration folder's training.yaml, or of a whole other file."""
    path = folder / "training.yaml"
    content = yaml.safe_load(path.read_text())
    content[section] |= values
    path.write_text(yaml.safe_dump(content))


def other(tmp_path, name, change):
    """Write a shipped file with a change of its content, and return its path."""
    content = yaml.safe_load((FOLDER / name).read_text())
    change(content)
    path = tmp_path / name
    path.write_text(yaml.safe_dump(content))
    return str(path)


def log_of(out):
    return [json.loads(line) for line in (out / "progress.jsonl").read_text().splitlines()]


def provenance_of(out):
    return json.loads((out / "pilot.json").read_text())
