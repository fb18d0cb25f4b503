"""The training of the gate detector.

One process on one core. Each step draws one new labelled image into a pool, cuts a batch of crops (mostly around
corners) from images of the pool, and takes one Adam step. A checkpoint is saved every two minutes; it holds all that
the training needs to resume, including the state of the random generator. At each validation the output folder gets a
line in `log.jsonl`, a new `progress.png` and the current model, `gate_detector.onnx`, with its provenance. The same
call resumes an interrupted training, and prolongs a finished one where more steps are given.
"""

import dataclasses
import hashlib
import json
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

from swift_sim_bridge.gate_detector import export as detector_export
from swift_sim_bridge.gate_detector import model
from swift_sim_bridge.gate_detector.training import picture
from swift_sim_bridge.gate_detector.training import progress as progresses
from swift_sim_bridge.gate_detector.training.job import DetectorJob, examples_of
from swift_sim_bridge.gate_detector.training.pool import Pool
from swift_sim_bridge.gate_detector.training.progress import Progress
from swift_sim_bridge.gate_detector.training.settings import DetectorTraining
from swift_sim_bridge.gate_detector.training.validation import Validation
from swift_sim_bridge.model_files import provenance, training_log
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.renderer import CircleRenderer

CHECKPOINT, LOG, PICTURE = "checkpoint.pkl", "log.jsonl", "progress.png"
# Largest difference between an output of the exported file and of the network: less than a hundredth of the detector's
# thresholds, 0.35 and 0.55. The provenance gives the actual difference.
MAX_DIFFERENCE = 2e-3
PRINT_EVERY_S = 20  # progress on the terminal
LOSS_WINDOW = 200  # steps over which the printed losses are averaged


def make_step(settings: DetectorTraining, rate: optax.Schedule):
    """Return the compiled step.

    It is (weights, averaged weights, optimizer state, batch, number of steps before) -> (the first three after the
    step, losses (2,)).
    """
    chain = progresses.optimizer(settings, rate)

    def total(weights, batch):
        return model.loss(weights, *batch, background=settings.background, affinity_weight=settings.affinity_weight)

    @jax.jit
    def step(weights, average, state, batch, count):
        (_, parts), gradient = jax.value_and_grad(total, has_aux=True)(weights, batch)
        update, state = chain.update(gradient, state, weights)
        weights = optax.apply_updates(weights, update)
        decay = jnp.minimum(settings.average, (1.0 + count) / (10.0 + count))  # the first weights are soon forgotten
        average = jax.tree.map(lambda a, w: decay * a + (1 - decay) * w, average, weights)
        return weights, average, state, jnp.stack(parts)

    return step


def train(job: DetectorJob, *, minutes: float, checkpoint_s: float = 120.0) -> Progress:
    """Train, or go on from the checkpoint in `job.out`, and return the Progress, which is also saved.

    Args:
        job: what to train.
        minutes: the call ends after so many minutes.
        checkpoint_s: time between two checkpoints.

    Raises:
        UsageError: the checkpoint is unreadable, or is of a training that cannot go on with this job.
    """
    settings, out = job.settings, job.out
    out.mkdir(parents=True, exist_ok=True)
    checkpoint = out / CHECKPOINT
    progress = progresses.begin_sitting(checkpoint, settings, job.conditions, job.first and job.first.weights)
    rows = training_log.rows_until(out / LOG, "step", progress.step if checkpoint.is_file() else -1)
    rng = np.random.default_rng()
    rng.bit_generator.state = progress.generator_state
    stack = textures.stack(textures.TRAINED, settings.looks.textures, np.random.default_rng([settings.seed, 0]))
    pool = Pool(settings, examples_of(job, CircleRenderer(job.camera, stack)), rng)
    validation = Validation(settings, job.camera, job.track)
    step = make_step(settings, progress.learning_rate(settings))
    began = saved = printed = time.monotonic()
    first, earlier_s, losses = progress.step, progress.seconds, []
    while progress.step < settings.steps and time.monotonic() - began < 60 * minutes:
        pool.renew(rng)
        batch = pool.batch(rng)
        result = step(progress.weights, progress.average, progress.optimizer_state, batch, np.float32(progress.step))
        progress.weights, progress.average, progress.optimizer_state = result[:3]
        losses.append(np.asarray(result[3]))
        progress.step += 1
        now = time.monotonic()
        progress.seconds, progress.generator_state = earlier_s + now - began, rng.bit_generator.state
        if now - printed > PRINT_EVERY_S or progress.step == settings.steps:
            printed = now
            seconds_a_step = (now - began) / (progress.step - first)
            _print_progress(progress, settings, np.mean(losses[-LOSS_WINDOW:], axis=0), seconds_a_step)
        if progress.step % settings.validation_every == 0 or progress.step == settings.steps:
            progress.figures = validation.score(progress.average)
            export(progress, job, validation.images)
            rows.append(_row(progress, job, np.mean(losses[-settings.validation_every :], axis=0)))
            training_log.append(out / LOG, rows[-1])
            print(json.dumps(rows[-1]), flush=True)
            picture.draw(out / PICTURE, rows, validation.shown)
        if now - saved > checkpoint_s:
            saved = now
            progresses.save(progress, checkpoint)
    if progress.step > first:
        progresses.save(progress, checkpoint)
    export(progress, job, validation.images)
    return progress


def export(progress: Progress, job: DetectorJob, images) -> Path:
    """Write the averaged weights as `gate_detector.onnx` with its provenance; return the model's path.

    Raises:
        RuntimeError: the file and the network differ on `images`.
    """
    path, settings = job.out / "gate_detector.onnx", job.settings
    detector_export.write_detector(path, progress.average, settings.panorama)
    parity = detector_export.largest_difference(path, progress.average, images[:4])
    if parity > MAX_DIFFERENCE:
        raise RuntimeError(f"{path} differs from the trained network by {parity:.1e}; do not use it")
    figures = {"step": progress.step, "of_steps": settings.steps, "training_seconds": round(progress.seconds)}
    figures |= {"largest_difference_to_jax": parity} | (progress.figures or {})
    chosen = json.dumps(dataclasses.asdict(settings), sort_keys=True)
    origin = provenance.Origin(
        command=job.command,
        configuration_sha256=hashlib.sha256(chosen.encode()).hexdigest(),
        seed=settings.seed,
        trained_for=job.trained_for,
        sittings=[dataclasses.asdict(sitting) for sitting in progress.sittings],
        started_from=job.first.hashes if job.first else {},
    )
    provenance.write_provenance(path, origin, figures)
    return path


def _print_progress(progress, settings, losses, seconds_a_step):
    """Print one line on the progress."""
    left = (settings.steps - progress.step) * seconds_a_step / 60
    recall = progress.figures["recall_at_precision_0.95"] if progress.figures else float("nan")
    print(
        f"step {progress.step}/{settings.steps}  corners {losses[0]:.4f}  fields {losses[1]:.4f}  "
        f"recall at precision 0.95: {recall:.3f}  {seconds_a_step * 1e3:.0f} ms a step, {left:.0f} min left",
        flush=True,
    )


def _row(progress: Progress, job: DetectorJob, losses) -> dict:
    """Return the row of a validation for log.jsonl."""
    row = {"step": progress.step, "seconds": round(progress.seconds), "cpu_seconds": round(time.process_time())}
    row["learning_rate"] = float(progress.learning_rate(job.settings)(progress.step - 1))
    return row | {"corner_loss": float(losses[0]), "affinity_loss": float(losses[1])} | (progress.figures or {})
