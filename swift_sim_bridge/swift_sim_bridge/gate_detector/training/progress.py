"""How far a training of the gate detector is, and the checkpoint that holds it."""

import pickle
from dataclasses import dataclass, fields
from pathlib import Path

import jax
import numpy as np
import optax

from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector import model
from swift_sim_bridge.gate_detector.training.settings import DetectorTraining, learning_rate
from swift_sim_bridge.model_files.sittings import Sitting, changes, require_same
from swift_sim_bridge.model_files.whole_file import replacing

# Conditions without which a training cannot go on: shapes and first weights of the network, the scale of its input, and
# the draws of its images. Everything else may change from sitting to sitting.
FIXED = ("seed", "networks", "start_from", "panorama")


@dataclass
class Progress:
    """What a checkpoint holds.

    Attributes:
        step: number of steps taken.
        weights: of the network.
        average: averaged weights, which are exported.
        optimizer_state: of Adam.
        generator_state: of the random generator.
        conditions: what the last sitting read.
        sittings: runs of the command.
        seconds: of training so far.
        figures: of the last validation.
    """

    step: int
    weights: dict
    average: dict
    optimizer_state: object
    generator_state: dict
    conditions: dict
    sittings: tuple[Sitting, ...]
    seconds: float = 0.0
    figures: dict | None = None

    def learning_rate(self, settings: DetectorTraining) -> optax.Schedule:
        """Return the learning rate by the step; one that begins with a trained network starts as a restart does."""
        return learning_rate(settings, self.sittings, restarts="start_from" in self.conditions)


def optimizer(settings: DetectorTraining, rate: optax.Schedule):
    """Return Adam with clipped gradients and a learning rate."""
    return optax.chain(optax.clip_by_global_norm(settings.gradient_norm), optax.adam(rate))


def begin_sitting(checkpoint: Path, settings: DetectorTraining, conditions: dict, first: dict | None) -> Progress:
    """Return the progress from which to train: that of the checkpoint with one more sitting, or a new one.

    A finished training without more steps gets no further sitting: it is only exported again.

    Args:
        checkpoint: file, which a new training has not.
        settings: of the training.
        conditions: what it reads.
        first: weights of a new training; None for random ones.

    Raises:
        UsageError: the checkpoint is unreadable, or of a training that cannot go on under these conditions.
    """
    if not checkpoint.is_file():
        return start(settings, conditions, first)
    progress = restore(checkpoint)
    require_same(checkpoint, progress.conditions, conditions, FIXED)
    if progress.step < settings.steps:
        changed = changes(progress.conditions, conditions)
        for key, (before, now) in changed.items():
            print(f"changed: '{key}' from {before} to {now}", flush=True)
        progress.sittings += (Sitting(progress.step, settings.steps, changed),)
    progress.conditions = conditions
    return progress


def start(settings: DetectorTraining, conditions: dict, first: dict | None) -> Progress:
    """Return the progress before the first step, with given weights or random ones."""
    rng = np.random.default_rng([settings.seed, 1])
    weights = first or model.initial_weights(rng)
    sittings = (Sitting(0, settings.steps),)
    progress = Progress(0, weights, weights, None, rng.bit_generator.state, conditions, sittings)
    progress.optimizer_state = optimizer(settings, progress.learning_rate(settings)).init(weights)
    return progress


def save(progress: Progress, path: Path) -> None:
    """Write a checkpoint; the file is replaced at once or not at all."""
    state = {spec.name: getattr(progress, spec.name) for spec in fields(progress)}
    for name in ("weights", "average", "optimizer_state"):
        state[name] = jax.tree.map(np.asarray, state[name])
    with replacing(path) as partial:
        partial.write_bytes(pickle.dumps(state))


def restore(path: Path) -> Progress:
    """Return the progress in a checkpoint. Raises UsageError if it cannot be read."""
    try:
        return Progress(**pickle.loads(path.read_bytes()))
    except Exception as error:  # a damaged pickle raises nearly anything
        raise UsageError(f"{path} is no detector checkpoint; give another --out or remove it to start again") from error
