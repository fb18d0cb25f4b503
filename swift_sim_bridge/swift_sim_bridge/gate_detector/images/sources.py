"""Sources of labelled images, and their mixture."""

from typing import Protocol

import numpy as np

from swift_sim_bridge.gate_detector.images.targets import Example


class Source(Protocol):
    """Where examples come from."""

    def draw(self, rng) -> Example:
        """Return the next example."""
        ...


class Mixture:
    """Draws each example from one of some sources.

    Args:
        shares: (source, its share of the examples, above 0); the shares need not sum to one. One source alone gets the
            random generator as if there were no mixture.
    """

    def __init__(self, shares: list[tuple[Source, float]]):
        self._sources = [source for source, _ in shares]
        self._upper = np.cumsum([share for _, share in shares]) / sum(share for _, share in shares)

    def draw(self, rng) -> Example:
        """Return the next example."""
        if len(self._sources) == 1:
            return self._sources[0].draw(rng)
        return self._sources[int(np.searchsorted(self._upper[:-1], rng.random(), side="right"))].draw(rng)
