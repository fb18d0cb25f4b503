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

    Attributes:
        sources: in the order of `shares`.
        shares: of the sources, with a sum of one.
    """

    def __init__(self, shares: list[tuple[Source, float]]):
        self.sources = [source for source, _ in shares]
        self.shares = np.array([share for _, share in shares]) / sum(share for _, share in shares)

    def draw(self, rng) -> Example:
        """Return the next example."""
        number = rng.choice(len(self.sources), p=self.shares) if len(self.sources) > 1 else 0
        return self.sources[number].draw(rng)
