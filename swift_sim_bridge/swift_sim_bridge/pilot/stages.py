"""Trainings in a row, each with its own settings: the next begins with the pilot of the one before.

The last has the folder that the user named; those before it have folders inside it, named by their settings.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from swift_ros.errors import UsageError
from swift_sim_bridge.model_files import checkpoint
from swift_sim_bridge.pilot.job import CHECKPOINT, TrainingOptions, read_settings, require_guide
from swift_sim_bridge.pilot.train import train_policy


def train_in_stages(options: TrainingOptions, folder: Path) -> None:
    """Train once with each of the settings; go on with the first training that is not done.

    Args:
        options: of all trainings, but for their settings; `start_from` is of the first.
        folder: files of settings, one for each training, in the order of their names.

    Raises:
        UsageError: bad input, or the last training is done.
    """
    stages = list(stages_of(options, folder))
    for i, stage in enumerate(stages, start=1):
        if i < len(stages) and _is_done(stage.out / CHECKPOINT):
            print(f"training {i} of {len(stages)}, {stage.settings}, is done", flush=True)
        else:
            print(f"training {i} of {len(stages)}: {stage.settings}", flush=True)
            train_policy(stage)


def stages_of(options: TrainingOptions, folder: Path) -> Iterator[TrainingOptions]:
    """Yield the options of each training. Raises UsageError for options and settings that do not fit."""
    files = sorted(folder.glob("*.yaml"))
    if not files:
        raise UsageError(f"--settings names the folder {folder}, which has no .yaml file")
    if options.interactions:
        raise UsageError("--interactions is the length of one training; those of a folder --settings have their own")
    for file in files:  # a bad one is refused now, and not after the trainings before it
        require_guide(replace(options, settings=file), read_settings(options.folder, file))
    begin_with = options.start_from
    for file in files:
        out = options.out if file is files[-1] else options.out / file.stem
        yield replace(options, out=out, start_from=begin_with, settings=file)
        begin_with = str(out / "pilot.npz")


def _is_done(saved: Path) -> bool:
    """Return whether a training has a checkpoint at its end. Raises UsageError."""
    if not saved.exists():
        return False
    record = checkpoint.read_record(saved)
    return record["interactions"] >= record["sittings"][-1]["end"]
