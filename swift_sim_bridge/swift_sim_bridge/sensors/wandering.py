"""A random error that wanders and forgets."""

import numpy as np


class Wandering:
    """A random vector (n,) that starts at zero, wanders about it and forgets: Ornstein-Uhlenbeck, exact at any step."""

    def __init__(self, size: int, memory_s: float, rng: np.random.Generator):
        self.value = np.zeros(size)
        self._memory_s = memory_s
        self._rng = rng
        self._shares = (0.0, 1.0, 0.0)  # of the last step: dt s, what is kept, what is fresh

    def step(self, dt: float, sigma: float) -> np.ndarray:
        """Return the value after dt s in which its standard deviation tends to `sigma`."""
        if dt != self._shares[0]:
            keep = np.exp(-dt / self._memory_s)
            self._shares = dt, keep, np.sqrt(1 - keep * keep)
        _, keep, fresh = self._shares
        self.value = keep * self.value + sigma * fresh * self._rng.standard_normal(self.value.size)
        return self.value
