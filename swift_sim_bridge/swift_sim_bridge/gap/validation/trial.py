"""A trial of a repair: effects that are fitted to the first part of each flight, with their error on what follows."""

from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.discovery.polynomial_search import Found
from swift_sim_bridge.gap.inference.sensitivity import parameter_slices


@dataclass(frozen=True)
class Trial:
    """Effects that are fitted to the first part of each flight.

    Attributes:
        names: the named effects.
        equation: effects of an equation.
        found: the equation's summands.
        values: values of all of them by key.
        error: `unseen_error`.
    """

    names: tuple[Effect, ...]
    equation: tuple[Effect, ...]
    found: tuple[Found, ...]
    values: dict[str, np.ndarray]
    error: float

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects of the trial."""
        return (*self.names, *self.equation)

    @property
    def numbers(self) -> int:
        """How many numbers are fitted."""
        return sum(len(one.parameters) for one in self.effects)

    @property
    def coefficients(self) -> dict[str, float]:
        """The coefficient of each summand by its name."""
        return {p.name: x for one in self.equation for p, x in zip(one.parameters, self.values[one.key], strict=True)}

    @property
    def items(self) -> dict[str, np.ndarray]:
        """The positions of the parameters of each name, by key, and of each new summand, by name."""
        found, new, slices = {}, {one.name for one in self.found}, parameter_slices(self.effects)
        for effect in self.names:
            found[effect.key] = np.arange(slices[effect.key].start, slices[effect.key].stop)
        for effect in self.equation:
            begin = slices[effect.key].start
            found |= {p.name: np.array([begin + i]) for i, p in enumerate(effect.parameters) if p.name in new}
        return found
