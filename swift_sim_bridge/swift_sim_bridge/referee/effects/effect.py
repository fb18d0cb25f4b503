"""The specification of an effect that the referee conceals."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Effect:
    """One effect of the referee's catalogue.

    Attributes:
        layer: layer of residuals in which it acts.
        detectable: size that should be detectable, in `unit`.
        largest: largest plausible size, in `unit`.
        unit: unit of the size.
        plant: plant(content, size, rng) returns {path: value}, the values of the true vehicle file.
        expected_terms: terms of an equation that describes the effect (see `quantities`).
        path: kind of path that shows it, any kind if empty.
        acts_on_moment: whether it acts at the hubs or off the centre of mass, and so also in the moment layer.
        idle: value of its parameters where a vehicle file has none.
    """

    layer: str
    detectable: float
    largest: float
    unit: str
    plant: Callable
    expected_terms: Callable
    path: str = ""
    acts_on_moment: bool = False
    idle: float = 0.0

    @property
    def layers(self) -> set[str]:
        """The layers in which it acts."""
        return {self.layer, "moment"} if self.acts_on_moment else {self.layer}
