"""Vehicles with changes: a path leads to one number of the vehicle file, as ("motor", "time_constant_up"). Pure."""

from dataclasses import is_dataclass, replace

import numpy as np

from swift_ros.vehicle import Vehicle


def value_at(vehicle: Vehicle, path: tuple) -> float:
    """Return the number at a path of the vehicle file."""
    here = vehicle
    for key in path:
        here = getattr(here, key) if is_dataclass(here) else here[key]
    return float(here)


def key_of(path: tuple) -> str:
    """Return a path as text, such as "motor.map.coefficients[2]"."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)[1:]


def with_value(described, path: tuple, value: float):
    """Return the vehicle (or a part of it) with another number at a path. A 3x3 inertia has paths of its diagonal."""
    if not path:
        return value
    key, *rest = path
    if is_dataclass(described):
        return replace(described, **{key: with_value(getattr(described, key), tuple(rest), value)})
    if isinstance(described, dict):
        return {**described, key: with_value(described[key], tuple(rest), value)}
    entries = described.tolist() if isinstance(described, np.ndarray) else list(described)
    entries[key] = with_value(entries[key], tuple(rest), value)
    return entries


def with_idle_terms(vehicle: Vehicle, terms: dict) -> Vehicle:
    """Return the vehicle with these terms where it lacks them.

    Their coefficients do nothing, so that all variants of a vehicle are one compiled program.
    """
    return replace(vehicle, terms=over(terms, vehicle.terms))


def over(idle: dict, own: dict) -> dict:
    """Return the entries of `own`, and those of `idle` that it lacks, at every depth."""
    deeper = {key: over(idle.get(key, {}), entry) if isinstance(entry, dict) else entry for key, entry in own.items()}
    return {**idle, **deeper}
