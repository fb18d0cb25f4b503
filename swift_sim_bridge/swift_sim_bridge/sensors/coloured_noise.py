"""A coloured random error."""

import numpy as np


class ColouredNoise:
    """An Ornstein-Uhlenbeck process (n,) that starts at zero; exact at any step.

    Args:
        size: n.
        memory_s: s, correlation time.
        rng: draws it.
    """

    def __init__(self, size: int, memory_s: float, rng: np.random.Generator):
        self.value = np.zeros(size)
        self._memory_s = memory_s
        self._rng = rng
        self._shares = (0.0, 1.0, 0.0)  # of the last step: dt s, share that is kept, share that is new

    def step(self, dt: float, sigma: float) -> np.ndarray:
        """Return the value after dt s; `sigma`: its stationary standard deviation."""
        if dt != self._shares[0]:
            keep = np.exp(-dt / self._memory_s)
            self._shares = dt, keep, np.sqrt(1 - keep * keep)
        _, keep, fresh = self._shares
        self.value = keep * self.value + sigma * fresh * self._rng.standard_normal(self.value.size)
        return self.value
