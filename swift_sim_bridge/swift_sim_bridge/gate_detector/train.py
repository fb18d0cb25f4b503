"""The training of the gate detector.

One process on one core. Each step renders one new labelled image into a pool, cuts a batch of crops (mostly around
corners) from images of the pool, and takes one Adam step. A checkpoint is saved every two minutes; it holds all that
the training needs to resume, including the state of the random generator. At each validation the output folder gets a
line in `log.jsonl` and the current model, `gate_detector.onnx`, with its provenance.
"""

import dataclasses
import hashlib
import json
import pickle
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

from swift_ros import configuration
from swift_ros.configuration import within
from swift_ros.errors import UsageError
from swift_ros.perception.corner_grouping import GroupingSettings, find_peaks
from swift_ros.perception.upright import Panorama, UprightView
from swift_sim_bridge.gate_detector import export as detector_export
from swift_sim_bridge.gate_detector import model, scores
from swift_sim_bridge.gate_detector.data import IGNORED, VISIBLE, Examples, GateLimits
from swift_sim_bridge.model_files import provenance
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.renderer import CircleRenderer
from swift_sim_bridge.rendering.scene import Looks

MAX_SEED = 999  # higher seeds are kept for evaluation and review
VALIDATION_SEED = 990  # of the images on which the training is scored
# Largest difference between an output of the exported file and of the network: less than a hundredth of the detector's
# thresholds, 0.35 and 0.55. The provenance gives the actual difference.
MAX_DIFFERENCE = 2e-3
PRINT_EVERY_S = 20  # progress on the terminal
LOSS_WINDOW = 200  # steps over which the printed losses are averaged


@dataclass(frozen=True)
class DetectorTraining:
    """Section `detector` of `config/training.yaml`.

    Attributes:
        seed: 0..999.
        panorama: geometry of the network's input.
        judged: which gates count.
        looks: ranges of the surfaces.
        plates: flat objects in a scene, gates included.
        own_track_share: images of the configured track; the others show random tracks.
        racing_share: poses on racing lines; the others are random.
        attitude_error_deg: of the odometry that turns the view, standard deviation an axis.
        crop_px: side of a training crop.
        corner_crop_share: crops around a corner; the others are anywhere.
        batch: crops of one step.
        steps: of the whole training.
        learning_rate: the maximum, after warmup_steps; then a half cosine down to a fiftieth.
        warmup_steps: steps with a rising learning rate.
        gradient_norm: gradients are clipped to this norm.
        background, affinity_weight: of the loss, see `model.loss`.
        average: decay a step of the averaged weights, which are exported.
        pool: images that crops are cut from.
        validation_images, validation_every: number of images, and steps between two validations.
        peak_threshold: of the validation.
    """

    seed: int
    panorama: Panorama
    judged: GateLimits
    looks: Looks
    plates: int = within(1, 1000)
    own_track_share: float = within(0.0, 1.0)
    racing_share: float = within(0.0, 1.0)
    attitude_error_deg: float = within(0.0, 45.0)
    crop_px: int = within(1, 4096)
    corner_crop_share: float = within(0.0, 1.0)
    batch: int = within(1, 10_000)
    steps: int = within(1)
    learning_rate: float = within(1e-8, 1.0)
    warmup_steps: int = within(0)
    gradient_norm: float = within(1e-6)
    background: float = within(0.0, 1.0)
    affinity_weight: float = within(0.0, 1000.0)
    average: float = within(0.0, 0.999999)
    pool: int = within(1, 100_000)
    validation_images: int = within(1, 100_000)
    validation_every: int = within(1)
    peak_threshold: float = within(0.0, 1.0)

    def __post_init__(self):
        if not 0 <= self.seed <= MAX_SEED:
            raise ValueError(f"'seed' must lie in 0..{MAX_SEED}; higher seeds are kept for evaluation")
        if self.crop_px % 32 or self.panorama.side % 32:
            raise ValueError("'crop_px' and 'panorama.side' must be multiples of 32, for five poolings")
        if self.crop_px > self.panorama.side:
            raise ValueError("'crop_px' must be at most 'panorama.side', of which it is a part")
        if self.warmup_steps > self.steps:
            raise ValueError("'warmup_steps' must be at most 'steps', of which they are a part")


class Pool:
    """The images that crops are cut from; a new image replaces the oldest."""

    def __init__(self, settings: DetectorTraining, examples: Examples, rng):
        side, small = settings.panorama.side, settings.panorama.side // model.STRIDE
        self._settings, self._examples, self._next = settings, examples, 0
        self._images = np.zeros((settings.pool, side, side, 1), np.float32)
        self._targets = np.zeros((settings.pool, small, small, model.OUTPUTS), np.float32)
        self._masks = np.zeros((settings.pool, small, small, 2), np.float32)
        self._corners = [np.zeros((0, 2))] * settings.pool
        self._normalize = jax.jit(model.normalize)
        for _ in range(settings.pool):
            self.renew(rng)

    def renew(self, rng):
        """Replace the oldest image with a new one."""
        example, k = self._examples.draw(rng), self._next
        self._images[k] = np.asarray(self._normalize(example.panorama[None]))[0]
        self._targets[k], self._masks[k] = example.target, example.mask
        self._corners[k] = example.points[example.state == VISIBLE]
        self._next = (k + 1) % self._settings.pool

    def batch(self, rng):
        """Return images (n, c, c, 1), targets (n, c/2, c/2, 12) and masks (n, c/2, c/2, 2) of random crops."""
        crop, stride, side = self._settings.crop_px, model.STRIDE, self._settings.panorama.side
        rows = []
        for k in rng.integers(0, self._settings.pool, self._settings.batch):
            corner = rng.integers(0, side - crop + 1, 2)
            if len(self._corners[k]) and rng.random() < self._settings.corner_crop_share:
                middle = self._corners[k][rng.integers(0, len(self._corners[k]))]
                corner = np.clip(middle - rng.uniform(0.1, 0.9, 2) * crop, 0, side - crop).astype(int)
            x, y = corner // stride * stride
            big, small = np.s_[y : y + crop, x : x + crop], np.s_[y // stride :, x // stride :]
            few = np.s_[: crop // stride, : crop // stride]
            rows.append((self._images[k][big], self._targets[k][small][few], self._masks[k][small][few]))
        return tuple(np.stack(column) for column in zip(*rows, strict=True))


class Validation:
    """Images with textures that the training does not use, and the scores of the corners that the network finds."""

    def __init__(self, settings: DetectorTraining, camera, track):
        rng = np.random.default_rng([VALIDATION_SEED, settings.validation_images])
        stack = textures.stack(textures.FAMILIES, settings.looks.textures, rng)
        self._view = UprightView(camera, settings.panorama)
        source = Examples(settings, camera, self._view, track, CircleRenderer(camera, stack))
        self._examples = [source.draw(rng) for _ in range(settings.validation_images)]
        self._grouping = GroupingSettings(settings.peak_threshold, 0.0, 100, model.STRIDE)
        self._detect = jax.jit(model.detect)

    @property
    def images(self) -> list[np.ndarray]:
        """The panoramas (side, side) uint8."""
        return [example.panorama for example in self._examples]

    def score(self, weights) -> dict:
        """Return recall at precision 0.95 and its threshold, recall and precision at 0.3 and 0.5, median error (px)."""
        found, right, error, truths = [], [], [], 0
        for example in self._examples:
            maps = np.asarray(self._detect(weights, example.panorama[None]))[0, ..., : model.CORNERS]
            pixels = self._view.to_image(example.points, example.r_world_camera)
            for k, peaks in enumerate(find_peaks(np.moveaxis(maps, -1, 0), self._grouping)):
                true, ignored = (pixels[:, k][example.state[:, k] == state] for state in (VISIBLE, IGNORED))
                points = self._view.to_image(peaks.points, example.r_world_camera)
                matches = scores.match(points, peaks.confidence, true, ignored)
                truths += len(true)
                found, right, error = found + [matches.found], right + [matches.right], error + [matches.error_px]
        return summary(np.concatenate(found), np.concatenate(right), np.concatenate(error), truths)


def summary(found, right, error_px, truths: int) -> dict:
    """Return the figures of a validation.

    Args:
        found, right, error_px: (n,), of all detected corners, see `scores.CornerMatches`.
        truths: number of true corners.
    """
    recall, threshold = scores.recall_at_precision(found, right, truths, 0.95)
    figures = {"recall_at_precision_0.95": recall, "threshold": threshold, "corners": truths}
    for at in (0.3, 0.5):
        above = found > at
        figures[f"recall_{at}"] = float(right[above].sum() / max(truths, 1))
        figures[f"precision_{at}"] = float(right[above].mean()) if above.any() else 0.0
    figures["median_error_px"] = float(np.nanmedian(error_px)) if right.any() else None
    return figures


def optimizer(settings: DetectorTraining):
    """Return Adam with clipped gradients and the schedule of the settings."""
    peak = settings.learning_rate
    schedule = optax.warmup_cosine_decay_schedule(0.0, peak, settings.warmup_steps, settings.steps, peak / 50)
    return optax.chain(optax.clip_by_global_norm(settings.gradient_norm), optax.adam(schedule))


def make_step(settings: DetectorTraining):
    """Return the compiled step.

    It is (weights, averaged weights, optimizer state, batch, number of steps before) -> (the first three after the
    step, losses (2,)).
    """
    chain = optimizer(settings)

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


@dataclass
class Progress:
    """What a checkpoint holds.

    Attributes:
        step: number of steps taken.
        weights: of the network.
        average: averaged weights, which are exported.
        optimizer_state: of Adam.
        generator_state: of the random generator.
        seconds: of training so far.
        figures: of the last validation.
        sittings: for each run of the command, the step at which it began and the steps of its schedule.
    """

    step: int
    weights: dict
    average: dict
    optimizer_state: object
    generator_state: dict
    seconds: float = 0.0
    figures: dict | None = None
    sittings: tuple[tuple[int, int], ...] = ()


def start(settings: DetectorTraining) -> Progress:
    """Return the progress before the first step."""
    rng = np.random.default_rng([settings.seed, 1])
    weights = model.initial_weights(rng)
    return Progress(0, weights, weights, optimizer(settings).init(weights), rng.bit_generator.state)


def save(progress: Progress, path: Path):
    """Write a checkpoint; the file is replaced at once or not at all."""
    partial = path.with_suffix(".partial")
    host = jax.tree.map(np.asarray, (progress.weights, progress.average, progress.optimizer_state))
    state = (progress.step, *host, progress.generator_state, progress.seconds, progress.figures, progress.sittings)
    partial.write_bytes(pickle.dumps(state))
    partial.replace(path)


def restore(path: Path) -> Progress:
    """Return the progress in a checkpoint. Raises UsageError if it cannot be read."""
    try:
        return Progress(*pickle.loads(path.read_bytes()))
    except (OSError, pickle.UnpicklingError, TypeError, EOFError, AttributeError) as error:
        raise UsageError(f"{path} is no detector checkpoint; give another --out or remove it to start again") from error


def train(settings: DetectorTraining, camera, track, out: Path, *, minutes: float, checkpoint_s: float = 120.0):
    """Train, or resume from `out/checkpoint.pkl`, and return the Progress, which is also saved.

    Args:
        settings: of the training; it ends after `settings.steps`.
        camera: the lens and its mount.
        track: of the images that do not show a random track.
        out: folder of checkpoint, log and model.
        minutes: the call ends after so many minutes.
        checkpoint_s: time between two checkpoints.
    """
    out.mkdir(parents=True, exist_ok=True)
    checkpoint = out / "checkpoint.pkl"
    progress = restore(checkpoint) if checkpoint.is_file() else start(settings)
    rng = np.random.default_rng()
    rng.bit_generator.state = progress.generator_state
    stack = textures.stack(textures.TRAINED, settings.looks.textures, np.random.default_rng([settings.seed, 0]))
    view = UprightView(camera, settings.panorama)
    pool = Pool(settings, Examples(settings, camera, view, track, CircleRenderer(camera, stack)), rng)
    validation = Validation(settings, camera, track)
    step = make_step(settings)
    began = saved = printed = time.monotonic()
    first, earlier_s, losses = progress.step, progress.seconds, []
    if first < settings.steps:
        progress.sittings += ((first, settings.steps),)
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
            export(progress, settings, out, validation.images)
            _log(out, progress, np.mean(losses[-settings.validation_every :], axis=0))
        if now - saved > checkpoint_s:
            saved = now
            save(progress, checkpoint)
    if progress.step > first:
        save(progress, checkpoint)
    export(progress, settings, out, validation.images)
    return progress


def export(progress: Progress, settings: DetectorTraining, out: Path, images) -> Path:
    """Write the averaged weights as `gate_detector.onnx` with its provenance into `out`; return the model's path.

    Raises:
        RuntimeError: the file and the network differ on `images`.
    """
    path = out / "gate_detector.onnx"
    detector_export.write_detector(path, progress.average, settings.panorama)
    parity = detector_export.largest_difference(path, progress.average, images[:4])
    if parity > MAX_DIFFERENCE:
        raise RuntimeError(f"{path} differs from the trained network by {parity:.1e}; do not use it")
    figures = {"step": progress.step, "of_steps": settings.steps, "training_seconds": round(progress.seconds)}
    figures |= {"sittings_from_step_of_steps": progress.sittings, "largest_difference_to_jax": parity}
    figures |= progress.figures or {}
    command = f"swiftros train detector --seed {settings.seed} --steps {settings.steps}"
    content = json.dumps(dataclasses.asdict(settings), sort_keys=True)
    sha256 = hashlib.sha256(content.encode()).hexdigest()
    provenance.write_provenance(path, command=command, configuration=sha256, seed=settings.seed, figures=figures)
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


def _log(out, progress, losses):
    """Append the figures of a validation to log.jsonl and print them."""
    line = {"step": progress.step, "seconds": round(progress.seconds), "cpu_seconds": round(time.process_time())}
    line |= {"corner_loss": float(losses[0]), "affinity_loss": float(losses[1])} | progress.figures
    with (out / "log.jsonl").open("a") as log:
        log.write(json.dumps(line) + "\n")
    print(json.dumps(line), flush=True)


def load_settings(folder: Path, changes: dict) -> DetectorTraining:
    """Return the section `detector` of training.yaml in a configuration folder, with `changes` to its values."""
    path = folder / "training.yaml"
    content = configuration.read_section(path, "detector")
    return configuration.build(DetectorTraining, content | changes, f"{path}, section 'detector'")
