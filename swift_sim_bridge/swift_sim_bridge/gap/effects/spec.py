"""What an effect is: a hypothesis, as a patch of the vehicle file.

The patch is all there is: sensitivities, fits and the repaired simulator call the same physics behind `inject`.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.effects.patch import over, value_at, with_idle_terms, with_value


@dataclass(frozen=True)
class Parameter:
    """One number that an effect changes.

    name; unit; path in the vehicle file; step: a change of it that is small and yet matters; low, high: what is
    physical: no drag pushes; tied: paths that change by the same share; inverse: what it does goes by one over it.
    """

    name: str
    unit: str
    path: tuple
    step: float
    low: float = -np.inf
    high: float = np.inf
    tied: tuple = ()
    inverse: bool = False

    def least(self, begun: float) -> float:
        """Return the least value that an estimate to first order from `begun` may have: half an inertia turns twice as
        easily, which looks like none at all."""
        return begun * (1.0 - begun / self.low) if self.inverse and 0.0 < self.low < begun else self.low


@dataclass(frozen=True)
class Effect:
    """One hypothesis. id: of the catalogue; layer: where it shows first; channels: without which it cannot be told;
    idle: entry of `terms` that does nothing, None for ordinary keys of the file; part, variant: of several alike, what
    there are several of, and the number of this one; retimes: it moves measurements in time, noise and all."""

    id: str
    layer: str
    parameters: tuple[Parameter, ...]
    equation: str
    sentence: str
    manoeuvre: str
    channels: tuple[str, ...]
    idle: dict | None = field(default=None, hash=False)
    part: str = ""
    variant: str = ""
    retimes: bool = False

    @property
    def key(self) -> str:
        """The id, with the variant where there are several."""
        return f"{self.id}[{self.variant}]" if self.variant else self.id

    @property
    def exclusive(self) -> bool:
        """Whether its variants exclude each other: the vehicle file has one entry for all of them."""
        return self.part in (self.idle or {}).get(self.id, {})


def start(effect: Effect, vehicle: Vehicle) -> np.ndarray:
    """Return the effect's parameters (k,) as the vehicle file has them, idle ones where it lacks the term."""
    vehicle = _ready(effect, vehicle)
    return np.array([value_at(vehicle, parameter.path) for parameter in effect.parameters])


def inject(vehicle: Vehicle, effect: Effect, values) -> Vehicle:
    """Return the vehicle with the effect's parameters at `values` (k,)."""
    vehicle = _ready(effect, vehicle)
    for parameter, value in zip(effect.parameters, values, strict=True):
        before = value_at(vehicle, parameter.path)
        vehicle = with_value(vehicle, parameter.path, float(value))
        for path in parameter.tied:
            vehicle = with_value(vehicle, path, value_at(vehicle, path) * float(value) / before)
    return vehicle


def _ready(effect: Effect, vehicle: Vehicle) -> Vehicle:
    if effect.idle is None:
        return vehicle
    if effect.exclusive:
        own = {**effect.idle[effect.id], **vehicle.terms.get(effect.id, {})}
        if own[effect.part] != effect.idle[effect.id][effect.part]:
            own = effect.idle[effect.id]
        return replace(vehicle, terms={**vehicle.terms, effect.id: own})
    return with_idle_terms(vehicle, effect.idle)


def idle_terms(effects: Iterable[Effect]) -> dict:
    """Return entries of `terms` that together hold every effect and do nothing."""
    found: dict = {}
    for effect in effects:
        for name, entry in (effect.idle or {}).items():
            found[name] = over(entry, found.get(name, {}))
    return found


def vector(
    name: str, unit: str, path: tuple, step: float, bound: float, count: int = 3, low: float | None = None
) -> tuple[Parameter, ...]:
    """Return the parameters of a vector, from `low` to `bound`, else from minus to plus `bound`."""
    low = -bound if low is None else low
    return tuple(Parameter(f"{name}[{i}]", unit, (*path, i), step, low, bound) for i in range(count))
