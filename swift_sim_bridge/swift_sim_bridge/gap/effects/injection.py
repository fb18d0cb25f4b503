"""Vehicles with an effect: the effect's parameters as the vehicle file has them, and with other values.

Sensitivities, fits and the repaired simulator call the same physics with the vehicle that `inject` returns.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.patch import over, value_at, with_idle_terms, with_value


def file_values(effect: Effect, vehicle: Vehicle) -> np.ndarray:
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
    """Return the vehicle with the idle terms of an effect where it lacks them."""
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
