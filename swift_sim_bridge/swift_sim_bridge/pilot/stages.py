"""Trainings in a row, each with its own settings: the next begins with the pilot of the one before.

The last has the folder that the user named; those before it have folders inside it, named by their settings.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from swift_ros.errors import UsageError
from swift_sim_bridge.model_files import checkpoint
from swift_sim_bridge.pilot.job import CHECKPOINT, TrainingOptions, read_settings
from swift_sim_bridge.pilot.train import train_policy


def train_in_stages(options: TrainingOptions, settings: list[Path]) -> None:
    """Train once with each of the settings; go on with the first training that is not done.

    Args:
        options: of all trainings, but for their settings; the first one's pilot to begin with.
        settings: files, one for each training.

    Raises:
        UsageError: bad input; the last training is done.
    """
    stages = list(stages_of(options, settings))
    for i, stage in enumerate(stages, start=1):
        if i < len(stages) and _is_done(stage.out / CHECKPOINT):
            print(f"training {i} of {len(stages)}, {stage.settings}, is done", flush=True)
            continue
        if len(stages) > 1:
            print(f"training {i} of {len(stages)}: {stage.settings}", flush=True)
        train_policy(stage)


def stages_of(options: TrainingOptions, settings: list[Path]) -> Iterator[TrainingOptions]:
    """Yield the options of each training. Raises UsageError for options and settings that do not fit."""
    if len(settings) > 1 and options.interactions:
        raise UsageError("--interactions is the length of one training; --settings names several, which have their own")
    if len({file.stem for file in settings}) < len(settings):
        raise UsageError("--settings names two files of the same name; each training needs a folder of its own name")
    for file in settings:  # a bad one is said now, and not after the trainings before it
        read_settings(options.folder, file)
    begin_with = options.start_from
    for file in settings:
        out = options.out if file is settings[-1] else options.out / file.stem
        yield replace(options, out=out, start_from=begin_with, settings=file)
        begin_with = str(out / "pilot.npz")


def _is_done(saved: Path) -> bool:
    """Return whether a training has a checkpoint at its end. Raises UsageError."""
    if not saved.exists():
        return False
    record = checkpoint.read_record(saved)
    return record["interactions"] >= record["sittings"][-1]["end"]
