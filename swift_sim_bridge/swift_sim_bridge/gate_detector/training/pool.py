"""The images that the crops of a training are cut from."""

import jax
import numpy as np

from swift_sim_bridge.gate_detector import model
from swift_sim_bridge.gate_detector.corner_states import VISIBLE
from swift_sim_bridge.gate_detector.images.sources import Source
from swift_sim_bridge.gate_detector.training.settings import DetectorTraining


class Pool:
    """The images that crops are cut from; a new image replaces the oldest."""

    def __init__(self, settings: DetectorTraining, examples: Source, rng):
        side, small = settings.panorama.side, settings.panorama.side // model.STRIDE
        self._settings, self._examples, self._next = settings, examples, 0
        self._images = np.zeros((settings.pool, side, side, 1), np.float32)
        self._targets = np.zeros((settings.pool, small, small, model.OUTPUTS), np.float32)
        self._masks = np.zeros((settings.pool, small, small, 2), np.float32)
        self._corners = [np.zeros((0, 2))] * settings.pool
        self._corner_share = np.zeros(settings.pool)
        self._normalize = jax.jit(model.normalize)
        for _ in range(settings.pool):
            self.renew(rng)

    def renew(self, rng):
        """Replace the oldest image with a new one."""
        example, k = self._examples.draw(rng), self._next
        self._images[k] = np.asarray(self._normalize(example.panorama[None]))[0]
        self._targets[k], self._masks[k] = example.target, example.mask
        self._corners[k] = example.points[example.state == VISIBLE]
        # Crops anywhere show what is no gate. Where not all gates are labelled, they would show what does not count.
        self._corner_share[k] = self._settings.corner_crop_share if example.labels.complete else 1.0
        self._next = (k + 1) % self._settings.pool

    def batch(self, rng):
        """Return images (n, c, c, 1), targets (n, c/2, c/2, 12) and masks (n, c/2, c/2, 2) of random crops."""
        crop, stride, side = self._settings.crop_px, model.STRIDE, self._settings.panorama.side
        rows = []
        for k in rng.integers(0, self._settings.pool, self._settings.batch):
            corner = rng.integers(0, side - crop + 1, 2)
            if len(self._corners[k]) and rng.random() < self._corner_share[k]:
                middle = self._corners[k][rng.integers(0, len(self._corners[k]))]
                corner = np.clip(middle - rng.uniform(0.1, 0.9, 2) * crop, 0, side - crop).astype(int)
            x, y = corner // stride * stride
            big, small = np.s_[y : y + crop, x : x + crop], np.s_[y // stride :, x // stride :]
            few = np.s_[: crop // stride, : crop // stride]
            rows.append((self._images[k][big], self._targets[k][small][few], self._masks[k][small][few]))
        return tuple(np.stack(column) for column in zip(*rows, strict=True))
