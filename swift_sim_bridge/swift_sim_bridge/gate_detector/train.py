"""Training the gate detector: `swiftros train detector`.

One process, one core: every step renders one new labelled image into a pool, cuts a batch of crops (mostly around
corners) from images of the pool, and takes one Adam step. A checkpoint every two minutes holds all that the next
sitting needs, the random generator's state included; the same command goes on from it. At every validation the output
folder gets a line in `log.jsonl` and the model as it then is, `gate_detector.onnx`, with its provenance.
"""

import dataclasses
import hashlib
import json
import os
import pickle
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

from swift_ros import configuration
from swift_ros import track as tracks
from swift_ros.camera import model as lens
from swift_ros.errors import UsageError
from swift_ros.perception.corner_grouping import GroupingSettings, find_peaks
from swift_ros.perception.upright import Panorama, UprightView
from swift_sim_bridge.gate_detector import export as detector_export
from swift_sim_bridge.gate_detector import model, scores
from swift_sim_bridge.gate_detector.data import NOT_JUDGED, SEEN, Examples, Judged
from swift_sim_bridge.model_files import provenance
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.renderer import CircleRenderer
from swift_sim_bridge.rendering.scene import Looks

MOST_SEED = 999  # higher seeds belong to evaluation and review
VALIDATION_SEED = 990
MOST_DIFFERENCE = 2e-3  # of the exported file from the network it was made of


@dataclass(frozen=True)
class DetectorTraining:
    """Section `detector` of `config/training.yaml`.

    seed: 0..999; panorama: geometry of the view; judged: which gates count; looks: ranges of the looks; plates: flat
    objects in a scene, gates included; own_track_share: images of the configured track, the rest of random tracks;
    racing_share: poses on racing lines, the rest wander; attitude_error_deg: of the odometry that turns the view, one
    standard deviation an axis; crop_px, corner_crop_share: training crops and the share of them around a corner;
    batch; steps; learning_rate: at its top, after warmup_steps, then a half cosine to a fiftieth; gradient_norm: clip;
    background, affinity_weight: of the loss; average: decay a step of the averaged weights that are exported;
    pool: images kept; validation_images, validation_every: how many, steps between; peak_threshold: of validation.
    """

    seed: int
    panorama: Panorama
    judged: Judged
    looks: Looks
    plates: int
    own_track_share: float
    racing_share: float
    attitude_error_deg: float
    crop_px: int
    corner_crop_share: float
    batch: int
    steps: int
    learning_rate: float
    warmup_steps: int
    gradient_norm: float
    background: float
    affinity_weight: float
    average: float
    pool: int
    validation_images: int
    validation_every: int
    peak_threshold: float

    def __post_init__(self):
        if not 0 <= self.seed <= MOST_SEED:
            raise ValueError(f"'seed' must lie in 0..{MOST_SEED}; higher seeds are kept for evaluation")
        if self.crop_px % 32 or self.panorama.side % 32:
            raise ValueError("'crop_px' and 'panorama.side' must be multiples of 32, for five poolings")


class Pool:
    """The images that crops are cut from, the oldest replaced first."""

    def __init__(self, settings: DetectorTraining, examples: Examples, rng):
        side, small = settings.panorama.side, settings.panorama.side // model.STRIDE
        self._settings, self._examples, self._next = settings, examples, 0
        self._images = np.zeros((settings.pool, side, side, 1), np.float32)
        self._targets = np.zeros((settings.pool, small, small, model.OUTPUTS), np.float32)
        self._cares = np.zeros((settings.pool, small, small, 2), np.float32)
        self._corners = [np.zeros((0, 2))] * settings.pool
        self._normalize = jax.jit(model.normalize)
        for _ in range(settings.pool):
            self.renew(rng)

    def renew(self, rng):
        """Replace the oldest image by a new one."""
        example, k = self._examples.draw(rng), self._next
        self._images[k] = np.asarray(self._normalize(example.panorama[None]))[0]
        self._targets[k], self._cares[k] = example.target, example.care
        self._corners[k] = example.points[example.state == SEEN]
        self._next = (k + 1) % self._settings.pool

    def batch(self, rng):
        """Return images (n, c, c, 1), targets (n, c/2, c/2, 12) and cares (n, c/2, c/2, 2) of random crops."""
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
            rows.append((self._images[k][big], self._targets[k][small][few], self._cares[k][small][few]))
        return tuple(np.stack(column) for column in zip(*rows, strict=True))


class Validation:
    """Images of textures that training never draws, scored by the corners that the network finds in them."""

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
                true, forgiven = (pixels[:, k][example.state[:, k] == state] for state in (SEEN, NOT_JUDGED))
                places = self._view.to_image(peaks.points, example.r_world_camera)
                matches = scores.match(places, peaks.confidence, true, forgiven)
                truths += len(true)
                found, right, error = found + [matches.found], right + [matches.right], error + [matches.error_px]
        return summary(np.concatenate(found), np.concatenate(right), np.concatenate(error), truths)


def summary(found, right, error_px, truths: int) -> dict:
    """Return the figures of a validation as plain numbers."""
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
    """Return the jitted step: (weights, average, optimizer state, batch, count of steps before) -> the first three
    renewed and the losses (2,)."""
    chain = optimizer(settings)

    def total(weights, batch):
        return model.loss(weights, *batch, background=settings.background, affinity_weight=settings.affinity_weight)

    @jax.jit
    def step(weights, average, state, batch, count):
        (_, parts), gradient = jax.value_and_grad(total, has_aux=True)(weights, batch)
        update, state = chain.update(gradient, state, weights)
        weights = optax.apply_updates(weights, update)
        decay = jnp.minimum(settings.average, (1.0 + count) / (10.0 + count))  # soon forgets the start
        average = jax.tree.map(lambda a, w: decay * a + (1 - decay) * w, average, weights)
        return weights, average, state, jnp.stack(parts)

    return step


@dataclass
class Progress:
    """What a checkpoint holds: step, weights, their average, optimizer state, generator state, seconds spent so far,
    the newest figures, and of every sitting at which step it began and how many steps it had in view."""

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
    """Write a checkpoint so that an interruption leaves the old or the new one, never half of one."""
    partial = path.with_suffix(".partial")
    host = jax.tree.map(np.asarray, (progress.weights, progress.average, progress.optimizer_state))
    state = (progress.step, *host, progress.generator_state, progress.seconds, progress.figures, progress.sittings)
    partial.write_bytes(pickle.dumps(state))
    partial.replace(path)


def restore(path: Path) -> Progress:
    """Return the progress in a checkpoint of this command. Raises UsageError when it cannot be read."""
    try:
        return Progress(*pickle.loads(path.read_bytes()))
    except (OSError, pickle.UnpicklingError, TypeError, EOFError, AttributeError) as error:
        raise UsageError(f"{path} is no detector checkpoint; give another --out or remove it to start anew") from error


def train(settings: DetectorTraining, camera, track, out: Path, *, minutes: float, checkpoint_s: float = 120.0):
    """Train until `settings.steps` are done or `minutes` have passed, going on from `out/checkpoint.pkl` if there is
    one; return the Progress, which is also saved."""
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
    began = saved = told = time.monotonic()
    first, before, losses = progress.step, progress.seconds, []
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
        progress.seconds, progress.generator_state = before + now - began, rng.bit_generator.state
        if now - told > 20 or progress.step == settings.steps:
            told = now
            _tell(progress, settings, np.mean(losses[-200:], axis=0), (now - began) / (progress.step - first))
        if progress.step % settings.validation_every == 0 or progress.step == settings.steps:
            progress.figures = validation.score(progress.average)
            export(progress, settings, out, validation.images)
            _record(out, progress, np.mean(losses[-settings.validation_every :], axis=0))
        if now - saved > checkpoint_s:
            saved = now
            save(progress, checkpoint)
    if progress.step > first:
        save(progress, checkpoint)
    export(progress, settings, out, validation.images)
    return progress


def export(progress: Progress, settings: DetectorTraining, out: Path, images) -> Path:
    """Write the averaged weights as `gate_detector.onnx` with its provenance into `out`; return the model's path.

    Raises RuntimeError when the file does not give what the network gives on `images`.
    """
    path = out / "gate_detector.onnx"
    detector_export.write_detector(path, progress.average, settings.panorama)
    parity = detector_export.largest_difference(path, progress.average, images[:4])
    if parity > MOST_DIFFERENCE:
        raise RuntimeError(f"{path} differs from the trained network by {parity:.1e}; it must not fly")
    figures = {"step": progress.step, "of_steps": settings.steps, "training_seconds": round(progress.seconds)}
    figures |= {"sittings_from_step_of_steps": progress.sittings, "largest_difference_to_jax": parity}
    figures |= progress.figures or {}
    command = f"swiftros train detector --seed {settings.seed} --steps {settings.steps}"
    content = json.dumps(dataclasses.asdict(settings), sort_keys=True)
    sha256 = hashlib.sha256(content.encode()).hexdigest()
    provenance.write_provenance(path, command=command, configuration=sha256, seed=settings.seed, figures=figures)
    return path


def _tell(progress, settings, losses, seconds_a_step):
    left = (settings.steps - progress.step) * seconds_a_step / 60
    recall = progress.figures["recall_at_precision_0.95"] if progress.figures else float("nan")
    print(
        f"step {progress.step}/{settings.steps}  corners {losses[0]:.4f}  fields {losses[1]:.4f}  "
        f"recall at precision 0.95: {recall:.3f}  {seconds_a_step * 1e3:.0f} ms a step, {left:.0f} min left",
        flush=True,
    )


def _record(out, progress, losses):
    line = {"step": progress.step, "seconds": round(progress.seconds), "cpu_seconds": round(time.process_time())}
    line |= {"corner_loss": float(losses[0]), "affinity_loss": float(losses[1])} | progress.figures
    with (out / "log.jsonl").open("a") as log:
        log.write(json.dumps(line) + "\n")
    print(json.dumps(line), flush=True)


def load_settings(folder: Path, changes: dict) -> DetectorTraining:
    """Return the section `detector` of training.yaml in a configuration folder, with `changes` put over it."""
    path = folder / "training.yaml"
    content = configuration.read_yaml(path)
    if "detector" not in content:
        raise UsageError(f"{path} lacks the section 'detector'")
    return configuration.build(DetectorTraining, content["detector"] | changes, f"{path}, section 'detector'")


def add_arguments(parser):
    """Declare the arguments of `swiftros train detector`."""
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument("--out", type=Path, default=Path("runs/detector"), help="folder of checkpoint and log")
    parser.add_argument("--steps", type=int, help="steps of the whole schedule (default: training.yaml)")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="end this sitting after so many minutes")
    parser.add_argument("--seed", type=int, help="training seed, 0..999 (default: training.yaml)")


def run(arguments) -> int:
    """Train, go on where the last sitting ended, and say where the checkpoint is. Return 0."""
    # One thread: small convolutions gain nothing from more. Read when JAX first computes, which it has not yet.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    folder = configuration.configuration_folder(arguments.config)
    given = {name: getattr(arguments, name) for name in ("steps", "seed") if getattr(arguments, name) is not None}
    settings = load_settings(folder, given)
    camera = configuration.load(lens.Camera, folder / "camera.yaml")
    track = configuration.load(tracks.Track, folder / "track.yaml")
    progress = train(settings, camera, track, arguments.out, minutes=arguments.minutes)
    done = "done" if progress.step >= settings.steps else "the same command goes on"
    print(f"{arguments.out / 'gate_detector.onnx'}: step {progress.step} of {settings.steps}; {done}")
    return 0
