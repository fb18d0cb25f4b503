"""Specification of effects: the entries of the vehicle file's `terms`, and the numbers of the file that may be wrong.

Each specification stands in the file of the function that simulates the effect; identification, the gap tool, tests and
the documentation read it from there. This module has the types alone and imports nothing that simulates.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.plausibility import of_vehicle
from swift_ros.vehicle import Vehicle

TERM_TABLES = (  # module and name of the tables of terms, imported when a vehicle file is read
    ("swift_sim_bridge.physics.terms.registry", "PHYSICS"),
    ("swift_sim_bridge.sensors.terms", "SENSOR_TERMS"),
)

MIN_THRUST_TO_WEIGHT = 1.05  # that an estimated mass or thrust coefficient leaves: the vehicle flew
MASS_AND_THRUST_RANGE = (0.6, 1.7)  # factors of the file's values; beyond, the file describes another vehicle
# Size of a vehicle: mass in kg, reach of the propellers in m, rotor speed in hover in rad/s. The bounds of the effects'
# parameters are those of a 5 inch racer; by its unit, a bound changes with the powers of these three.
REFERENCE = (0.87, 0.19, 1382.0)
SIZES = {
    "N/(m/s)": (1, 0, 0),
    "N/(m/s)^2": (1, 0, 0),
    "N/(rad/s m/s)": (1, 0, -1),
    "N m/(rad/s m/s)": (1, 1, -1),
    "kg": (1, 0, 0),
    "kg m^2": (1, 2, 0),
}
LENGTH = (0, 1, 0)  # of the 'position' of a term, a place on the vehicle

# Channels of a recording without which the effects of a group are not identified.
MOTION_CHANNELS = ("gyro_body", "p_world", "q_world_body")
IMU_CHANNELS = ("specific_force_body", *MOTION_CHANNELS)
FORCE_CHANNELS = (*MOTION_CHANNELS, "specific_force_body", "rotor_speed")
MOMENT_CHANNELS = (*MOTION_CHANNELS, "rotor_speed", "single_rotor_speeds")
MOTOR_CHANNELS = ("rotor_speed", "motor_command")
VIO_CHANNELS = ("p_vio", "q_vio_body", *MOTION_CHANNELS)
COMMAND_CHANNELS = ("omega_command_body", "thrust_command")
GATE_CHANNELS = ("gate_observations", "p_world", "q_world_body", "gyro_body")


@dataclass(frozen=True)
class Parameter:
    """One number of the vehicle file that an effect changes.

    Attributes:
        name: name in reports, with the index of an entry of a vector.
        unit: unit of the value; empty for a ratio.
        path: keys from the top of the vehicle file to the number.
        step: change that is small and still visible in a flight: step of numerical derivatives.
        low: smallest physical value, for a vehicle of the size REFERENCE.
        high: largest physical value, for the same.
        tied: paths whose numbers change by the same factor.
        inverse: whether the motion depends on 1/value, as on a mass.
    """

    name: str
    unit: str
    path: tuple
    step: float
    low: float = -np.inf
    high: float = np.inf
    tied: tuple = ()
    inverse: bool = False

    def bounds(self, vehicle: Vehicle) -> tuple[float, float]:
        """Return the smallest and the largest physical value for a vehicle of any size: forces grow with its weight."""
        powers = SIZES.get(self.unit) or (LENGTH if self.path[2:3] == ("position",) else (0, 0, 0))
        now = (vehicle.mass, of_vehicle.reach_m(vehicle), vehicle.hover_speed)
        factor = float(
            np.prod([(one / other) ** power for one, other, power in zip(now, REFERENCE, powers, strict=True)])
        )
        return factor * self.low, factor * self.high

    def first_order_low(self, start: float) -> float:
        """Return the lower bound of an estimate to first order about `start`.

        To first order in the value, halving an inertia has the same effect as an inertia of zero has in the formula.
        The bound is therefore the one that corresponds to `low` in 1/value.
        """
        return start * (1.0 - start / self.low) if self.inverse and 0.0 < self.low < start else self.low


@dataclass(frozen=True)
class Effect:
    """A hypothesis: numbers of the vehicle file that may differ from their values, and how that shows.

    Attributes:
        id: name of the effect; the name of its entry where it is one of the file's `terms`.
        layer: group of residuals in which it shows first: command, motor, force, moment, imu, vio or camera.
        parameters: the numbers that it changes.
        equation: equation of the effect.
        sentence: finding in words, a format string of the parameters' names.
        manoeuvre: flight that shows the effect.
        channels: channels of the recording without which it is not identified.
        idle: entries of `terms` with which it does nothing; None for ordinary keys of the vehicle file.
        part: what the variants are variants of (a rotor, a gate); empty without variants.
        variant: number of this variant; empty without variants.
        retimes: whether it shifts measurements in time, and with them their noise.
        requires: terms of which the vehicle file needs one, else the effect changes nothing; empty for none.
        own_search: whether a search of its own finds it, so that it is not in the catalogue of linear effects.
    """

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
    requires: tuple[str, ...] = ()
    own_search: bool = False

    @property
    def key(self) -> str:
        """The id, with the variant where there are several."""
        return f"{self.id}[{self.variant}]" if self.variant else self.id

    @property
    def exclusive(self) -> bool:
        """Whether the variants exclude each other: the vehicle file has one entry for all of them."""
        return self.part in (self.idle or {}).get(self.id, {})

    def possible(self, vehicle: Vehicle) -> bool:
        """Return whether the vehicle file has what the effect requires."""
        return not self.requires or not set(self.requires).isdisjoint(vehicle.terms)


Effects = tuple[Effect, ...] | Callable[[Vehicle, int], tuple[Effect, ...]]  # of a vehicle and a map of so many gates


@dataclass(frozen=True)
class NotIdentified:
    """A known effect that the gap tool does not identify.

    Attributes:
        reason: why.
        equation: how it is simulated; empty where it is no term.
        manoeuvre: flight that shows it; empty where it is no term.
    """

    reason: str
    equation: str = ""
    manoeuvre: str = ""


@dataclass(frozen=True)
class TermSpecification:
    """One optional entry of the vehicle file's `terms`; an absent one is not simulated.

    Attributes:
        coefficients: dataclass that mirrors the entry.
        idle: entry that does nothing.
        example: entry of realistic size for a quadrotor of 5 inch propellers, no coefficient zero.
        effects: the effects that the gap tool may find in the entry; `idle` completes those without an idle entry.
        units: unit by coefficient, or one for each entry of it; needed for those that no effect has as a parameter.
        not_identified: why the gap tool does not identify the term.
    """

    coefficients: type
    idle: dict = field(kw_only=True)
    example: dict = field(kw_only=True)
    effects: Effects = field(default=(), kw_only=True)
    units: dict[str, str | tuple[str, ...]] = field(default_factory=dict, kw_only=True)
    not_identified: NotIdentified | None = field(default=None, kw_only=True)

    def effects_of(self, name: str, vehicle: Vehicle, gates: int = 0) -> tuple[Effect, ...]:
        """Return the term's effects, complete.

        Args:
            name: of the term.
            vehicle: whose file is examined.
            gates: number of gates of the map.
        """
        effects = self.effects(vehicle, gates) if callable(self.effects) else self.effects
        return tuple(one if one.idle else replace(one, idle={name: self.idle}) for one in effects)

    def unit(self, name: str, coefficient: str, vehicle: Vehicle, index: tuple = ()) -> str:
        """Return the unit of a coefficient of this term, or of its entry at `index`."""
        if coefficient in self.units:
            unit = self.units[coefficient]
            return unit if isinstance(unit, str) else unit[index[0]]
        path = ("terms", name, coefficient, *(key for key in index if isinstance(key, str)))
        for effect in self.effects_of(name, vehicle, gates=1):
            for parameter in effect.parameters:
                if parameter.path[: len(path)] == path:
                    return parameter.unit
        raise KeyError(f"the unit of {name}.{coefficient} is not specified")


def scalar_parameter(
    name: str, unit: str, term: str, step: float, low: float = -np.inf, high: float = np.inf
) -> Parameter:
    """Return the parameter for a scalar coefficient of a term."""
    return Parameter(name, unit, ("terms", term, name), step, low, high)


def vector_parameters(
    name: str, unit: str, term: str, step: float, bounds: tuple[float, float], count: int = 3
) -> tuple[Parameter, ...]:
    """Return the parameters for a vector coefficient of a term: `count` entries with the same step and bounds."""
    return tuple(Parameter(f"{name}[{i}]", unit, ("terms", term, name, i), step, *bounds) for i in range(count))


@cache
def known_terms() -> dict[str, TermSpecification]:
    """Return every term by name: those of the physics, then those of the sensors."""
    tables = (getattr(importlib.import_module(module), table) for module, table in TERM_TABLES)
    return {name: term for table in tables for name, term in table.items()}


def refuse_unknown_terms(vehicle: Vehicle) -> None:
    """Raise UsageError when the vehicle file has a term that nothing simulates."""
    for name in vehicle.terms:
        if name not in known_terms():
            known = ", ".join(known_terms())
            raise UsageError(f"the vehicle '{vehicle.name}' has the unknown term '{name}' in terms; known are {known}")
