"""The images on which the training of the gate detector is scored."""

from typing import NamedTuple

import jax
import numpy as np

from swift_ros.perception.corner_grouping import GroupingSettings, find_peaks
from swift_ros.perception.upright import UprightView
from swift_sim_bridge.gate_detector import model, scores
from swift_sim_bridge.gate_detector.corner_states import IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.images.rendered import RenderedExamples
from swift_sim_bridge.gate_detector.training.settings import DetectorTraining
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.renderer import CircleRenderer

VALIDATION_SEED = 990  # of the images; above those of trainings
SHOWN, SHOWN_CONFIDENCE = 8, 0.5  # images in the picture, and the least confidence of a corner in them


class ShownImage(NamedTuple):
    """One image of the picture.

    Attributes:
        panorama: (side, side) uint8.
        true: (n, 2) px, visible corners.
        found: (m, 2) px, detected corners.
    """

    panorama: np.ndarray
    true: np.ndarray
    found: np.ndarray


class Validation:
    """Images with textures that the training does not use, and the scores of the corners that the network finds.

    Attributes:
        shown: some of the images, with the corners that were found at the last score.
    """

    def __init__(self, settings: DetectorTraining, camera, track):
        rng = np.random.default_rng([VALIDATION_SEED, settings.validation_images])
        stack = textures.stack(textures.FAMILIES, settings.looks.textures, rng)
        self._view = UprightView(camera, settings.panorama)
        source = RenderedExamples(settings, camera, self._view, track, CircleRenderer(camera, stack))
        self._examples = [source.draw(rng) for _ in range(settings.validation_images)]
        self._grouping = GroupingSettings(settings.peak_threshold, 0.0, 100, model.STRIDE)
        self._detect = jax.jit(model.detect)
        self.shown: list[ShownImage] = []

    @property
    def images(self) -> list[np.ndarray]:
        """The panoramas (side, side) uint8."""
        return [example.panorama for example in self._examples]

    def score(self, weights) -> dict:
        """Return recall at precision 0.95 and its threshold, recall and precision at 0.3 and 0.5, median error (px)."""
        found, right, error, truths = [], [], [], 0
        self.shown = []
        for example in self._examples:
            corners = []
            maps = np.asarray(self._detect(weights, example.panorama[None]))[0, ..., : model.CORNERS]
            pixels = self._view.to_image(example.points, example.r_world_camera)
            for k, peaks in enumerate(find_peaks(np.moveaxis(maps, -1, 0), self._grouping)):
                true, ignored = (pixels[:, k][example.state[:, k] == state] for state in (VISIBLE, IGNORED))
                points = self._view.to_image(peaks.points, example.r_world_camera)
                matches = scores.match(points, peaks.confidence, true, ignored)
                truths += len(true)
                corners.append(peaks.points[peaks.confidence > SHOWN_CONFIDENCE])
                found, right, error = found + [matches.found], right + [matches.right], error + [matches.error_px]
            if len(self.shown) < SHOWN:
                true = example.points[example.state == VISIBLE]
                self.shown.append(ShownImage(example.panorama, true, np.concatenate(corners)))
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
