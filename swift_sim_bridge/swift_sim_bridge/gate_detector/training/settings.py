"""The settings of the gate detector's training, and its learning rate."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import optax

from swift_ros import configuration
from swift_ros.configuration import refuse_larger, within
from swift_ros.perception.upright import Panorama
from swift_sim_bridge.gate_detector.images.composites.looks import CompositeLooks
from swift_sim_bridge.gate_detector.images.targets import GateLimits
from swift_sim_bridge.model_files.sittings import Sitting
from swift_sim_bridge.rendering.scene import Looks

MAX_SEED = 999  # higher seeds are kept for evaluation and review
LAST_SHARE = 1 / 50  # of the maximum, the learning rate at the end


@dataclass(frozen=True)
class DetectorTraining:
    """Section `detector` of `config/training.yaml`.

    Attributes:
        seed: 0..999.
        panorama: geometry of the network's input.
        judged: which gates count.
        looks: ranges of the surfaces of rendered images.
        composites: what composed images look like.
        plates: flat objects in a scene, gates included.
        own_track_share: images of the configured track; the others show random tracks.
        labelled_share: examples from folders of labelled images, where there are any; the others are synthetic.
        composed_share: synthetic examples of composed images; the rest is rendered.
        racing_share: poses on racing lines; the others are random.
        attitude_error_deg: of the odometry that turns the view, standard deviation an axis.
        crop_px: side of a training crop.
        corner_crop_share: crops around a corner; the others are anywhere.
        batch: crops of one step.
        steps: of the whole training.
        learning_rate: the maximum, after warmup_steps; then a half cosine down to a fiftieth.
        restart_share: of it, the maximum after a finished training was prolonged, or one began with a trained network.
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
    composites: CompositeLooks
    plates: int = within(1, 1000)
    own_track_share: float = within(0.0, 1.0)
    labelled_share: float = within(0.0, 1.0)
    composed_share: float = within(0.0, 1.0)
    racing_share: float = within(0.0, 1.0)
    attitude_error_deg: float = within(0.0, 45.0)
    crop_px: int = within(1, 4096)
    corner_crop_share: float = within(0.0, 1.0)
    batch: int = within(1, 10_000)
    steps: int = within(1)
    learning_rate: float = within(1e-8, 1.0)
    restart_share: float = within(0.0, 1.0)
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
        refuse_larger(("panorama.side", self.panorama.side), crop_px=self.crop_px)
        span_rad = self.panorama.side / self.panorama.pixels_per_radian
        if span_rad > 2.0 * math.pi:
            raise ValueError(
                f"'panorama.side' {self.panorama.side} px over 'panorama.pixels_per_radian' "
                f"{self.panorama.pixels_per_radian:g} spans {span_rad:.3g} rad, more than a whole turn; give pixels "
                "per radian, not per degree"
            )
        refuse_larger(("steps", self.steps), warmup_steps=self.warmup_steps)
        if self.batch > self.pool:
            raise ValueError(
                f"'batch' {self.batch} must be at most 'pool' {self.pool}, the number of images from which it is cut"
            )


def load_settings(folder: Path, changes: dict) -> DetectorTraining:
    """Return the section `detector` of training.yaml in a configuration folder, with `changes` to its values."""
    path = folder / "training.yaml"
    content = configuration.read_section(path, "detector")
    return configuration.build(DetectorTraining, content | changes, f"{path}, section 'detector'")


def ends(sittings: Iterable[Sitting]) -> list[int]:
    """Return the last steps of the schedules of a training, one for each time that it was finished and prolonged.

    A sitting that begins before the end of the schedule only moves this end.
    """
    found: list[int] = []
    for sitting in sittings:
        if found and sitting.begin < found[-1]:
            found[-1] = sitting.end
        else:
            found.append(sitting.end)
    return found


def learning_rate(settings: DetectorTraining, sittings: Iterable[Sitting], restarts: bool = False) -> optax.Schedule:
    """Return the learning rate by the step: a warm-up and a half cosine for each of `ends`.

    Args:
        settings: of the training.
        sittings: of the training.
        restarts: it begins with a trained network, whose weights the maximum of the learning rate would destroy.
    """
    first, rates, boundaries = 0, [], ends(sittings)
    begin, peak, last = 0.0, settings.learning_rate, LAST_SHARE * settings.learning_rate
    peak *= settings.restart_share if restarts else 1.0
    for end in boundaries:
        warmup = min(settings.warmup_steps, (end - first) // 2)
        rates.append(optax.warmup_cosine_decay_schedule(begin, peak, warmup, end - first, last))
        first, begin, peak = end, last, settings.restart_share * settings.learning_rate
    return optax.join_schedules(rates, boundaries[:-1]) if len(rates) > 1 else rates[0]
