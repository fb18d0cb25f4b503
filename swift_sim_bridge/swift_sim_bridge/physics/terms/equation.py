"""An equation in the vehicle file: physics without a name, as a sparse polynomial of named quantities.

Each summand is a coefficient times a product of quantities (`quantities.product_of`) and adds to one axis of force or
moment, to the thrust of each rotor, to the motors' steady speeds or to the voltage of the pack. Beyond its range in the
recordings that it was estimated from, a product keeps the value of the bound: an equation is not extrapolated.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge import units
from swift_sim_bridge.effects import FORCE_CHANNELS, MOMENT_CHANNELS, MOTOR_CHANNELS, Effect, Parameter
from swift_sim_bridge.physics.terms import quantities
from swift_sim_bridge.physics.terms.motion import along_z, wrench_of
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import Vector, add, total

PREFIX = "equation_of_"  # of the ids of effects that change an equation's coefficients
STEP_SHARE = 0.005  # of the weight, of full speed and of the voltage: step of a summand for numerical derivatives
STEP_TURN = 0.5  # rad/s^2, the same of a moment
MAX_STEPS = 600.0  # that a summand is at most: three times the weight
MIN_REACH = 1e-9  # of a product whose range is a point
UNIT = {"force": "N", "moment": "N m", "rotor_thrust": "N", "rotor_speed": "rad/s", "voltage": "V"}
AT_ROTORS = "rotor_thrust"  # the left side that describes both, force and moment
KNOWN = {  # quantities of each
    "force": "motion",
    "moment": "motion",
    "rotor_thrust": "rotor",
    "rotor_speed": "motor",
    "voltage": "supply",
}
LAYERS = {"force": "force", "moment": "moment", "rotor_thrust": "force", "rotor_speed": "motor", "voltage": "motor"}
CHANNELS = {
    "force": FORCE_CHANNELS,
    "moment": MOMENT_CHANNELS,
    "rotor_thrust": (*FORCE_CHANNELS, *MOMENT_CHANNELS),
    "rotor_speed": MOTOR_CHANNELS,
    "voltage": ("voltage", "rotor_speed"),
}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Summand:
    """A coefficient and the range of the product that it multiplies.

    Attributes:
        coefficient: in the unit of the equation's left side over that of the product.
        range: lowest and highest value of the product; beyond, the nearer one is used.
    """

    coefficient: float
    range: tuple[float, float] = field(metadata={"static": True})


Summands = dict[str, Summand]  # by product of quantities


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Equation:
    """Summands of forces, moments, thrusts, motor speeds and voltage by their product of quantities.

    Attributes:
        force_x, force_y, force_z: N, body frame, at the centre of mass.
        moment_x, moment_y, moment_z: N m, body frame.
        rotor_thrust: N, added to the thrust of each rotor at its hub; of the quantities of that rotor.
        rotor_speed: rad/s, added to each motor's steady speed; of the quantities of that motor.
        voltage: V, added to the voltage of the pack; of the quantities of the pack.
        covariance: (k, k) of the coefficients, in the order in which they stand here; may be empty.
    """

    force_x: Summands = field(default_factory=dict)
    force_y: Summands = field(default_factory=dict)
    force_z: Summands = field(default_factory=dict)
    moment_x: Summands = field(default_factory=dict)
    moment_y: Summands = field(default_factory=dict)
    moment_z: Summands = field(default_factory=dict)
    rotor_thrust: Summands = field(default_factory=dict)
    rotor_speed: Summands = field(default_factory=dict)
    voltage: Summands = field(default_factory=dict)
    covariance: tuple[tuple[float, ...], ...] = field(default=(), metadata={"static": True})


SIDES = tuple(spec.name for spec in fields(Equation) if spec.name != "covariance")


def kind_of(side: str) -> str:
    """Return what a left side belongs to: force, moment, rotor_thrust, rotor_speed or voltage."""
    return side if side in UNIT else side[:-2]


def unit_of(side: str, product: str) -> str:
    """Return the unit of the coefficient of a product."""
    kind = kind_of(side)
    return units.ratio(UNIT[kind], quantities.product_of(product, KNOWN[kind]).unit)


def name_of(side: str, product: str) -> str:
    """Return the name of a summand in reports and covariances."""
    return f"{side}: {product}"


def summands_of(entry: dict) -> Iterator[tuple[str, str]]:
    """Yield (left side, product) of each summand of an entry of the vehicle file, in the order of the covariance."""
    yield from ((side, product) for side in SIDES for product in entry.get(side) or {})


def _sum(summands: Summands, known: str, at):
    """Return the sum (...) of some summands; 0.0 without any."""
    return total(
        one.coefficient * jnp.clip(quantities.product_of(product, known).value(at), *one.range)
        for product, one in summands.items()
    )


def wrench(instant, coefficients, parameters):
    """Return the equation's force and moment."""
    force, moment = (
        Vector(*(_sum(getattr(coefficients, f"{kind}_{axis}"), "motion", instant) for axis in "xyz"))
        for kind in ("force", "moment")
    )
    if not coefficients.rotor_thrust:
        return force, moment
    added = along_z(_sum(coefficients.rotor_thrust, "rotor", hub) for hub in quantities.hubs(instant))
    at_hubs = wrench_of(added, instant.hubs)
    return add(force, at_hubs[0]), add(moment, at_hubs[1])


def steady_speed(coefficients, drive: quantities.Drive):
    """Return what the equation adds to the steady speed of one motor, rad/s; 0 at a command of 0."""
    added = _sum(coefficients.rotor_speed, "motor", drive)
    return jnp.where(drive.command > 0, added, 0.0) if coefficients.rotor_speed else 0.0


def supply(coefficients, load: quantities.Load):
    """Return what the equation adds to the voltage of the pack, V."""
    return _sum(coefficients.voltage, "supply", load)


def check(coefficients: Equation, vehicle: Vehicle) -> None:
    """Raise ValueError for an unknown quantity, a range that falls, or a covariance that is none."""
    count = 0
    for side in SIDES:
        for product, one in getattr(coefficients, side).items():
            try:
                quantities.product_of(product, KNOWN[kind_of(side)])
            except ValueError as error:
                raise ValueError(f"{side}: '{product}' {error}") from error
            if one.range[0] > one.range[1]:
                raise ValueError(f"{side}: the range of '{product}' must rise, not fall from {one.range[0]:g}")
            count += 1
    covariance = coefficients.covariance
    if not covariance:
        return
    if len(covariance) != count or any(len(row) != count for row in covariance):
        raise ValueError(f"needs a 'covariance' of {count} rows and columns, one for each summand, or none")
    matrix = np.array(covariance)
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix / np.outer(scale, scale)
    if not np.allclose(scaled, scaled.T, atol=1e-6) or np.linalg.eigvalsh(scaled).min() < -1e-6:
        raise ValueError("has a 'covariance' that is none: it must be symmetric, and no variance negative")


def effects(vehicle: Vehicle, gates: int = 0) -> tuple[Effect, ...]:
    """Return one effect for each kind of left side of the vehicle's equation: its coefficients may be wrong."""
    entry = vehicle.terms.get("equation")
    entry = entry if isinstance(entry, dict) else {}
    found = []
    for kind in UNIT:
        rows = [(side, product) for side, product in summands_of(entry) if kind_of(side) == kind]
        if rows:
            found.append(_effect(kind, rows, entry, vehicle))
    return tuple(found)


def _effect(kind: str, rows: list[tuple[str, str]], entry: dict, vehicle: Vehicle) -> Effect:
    """Return the effect of the summands of one kind."""
    idle: dict = {}
    for side, product in rows:
        idle.setdefault(side, {})[product] = {**entry[side][product], "coefficient": 0.0}
    return Effect(
        id=f"{PREFIX}{kind}",
        layer=LAYERS[kind],
        parameters=tuple(_parameter(side, product, entry[side][product]["range"], vehicle) for side, product in rows),
        equation="; ".join(f"{side} += c * clip({product})" for side, product in rows),
        sentence=f"the coefficients of its equation of {kind.replace('_', ' ')} are {{values}}",
        manoeuvre="fly where the equation was found, and beyond",
        channels=CHANNELS[kind],
        idle={"equation": idle},
    )


def _parameter(side: str, product: str, bounds, vehicle: Vehicle) -> Parameter:
    """Return the coefficient of a summand as a parameter of an effect."""
    step = step_of(side, vehicle) / max(abs(float(bounds[0])), abs(float(bounds[1])), MIN_REACH)
    path = ("terms", "equation", side, product, "coefficient")
    return Parameter(name_of(side, product), unit_of(side, product), path, step, -MAX_STEPS * step, MAX_STEPS * step)


def step_of(side: str, vehicle: Vehicle) -> float:
    """Return a small, still visible size of a summand, in the unit of its left side."""
    kind = kind_of(side)
    if kind == "moment":
        return STEP_TURN * float(vehicle.inertia_matrix["xyz".index(side[-1]), "xyz".index(side[-1])])
    sizes = {
        "force": vehicle.mass * GRAVITY,
        "rotor_thrust": vehicle.mass * GRAVITY / len(vehicle.rotors),
        "rotor_speed": vehicle.rotor_speed_range[1],
        "voltage": vehicle.battery.reference_voltage,
    }
    return STEP_SHARE * sizes[kind]


def without_covariance(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without the covariance of its equation, to which summands can then be added."""
    entry = vehicle.terms.get("equation")
    if not isinstance(entry, dict) or "covariance" not in entry:
        return vehicle
    kept = {key: value for key, value in entry.items() if key != "covariance"}
    return replace(vehicle, terms={**vehicle.terms, "equation": kept})


def with_covariance(entry: dict, known: dict[str, dict[str, float]]) -> dict:
    """Return an entry of the vehicle file with the covariance of its coefficients.

    Args:
        entry: the entry; an older covariance in it is replaced.
        known: covariance of each pair of summands, by their names such as "force_x: v_x v_z"; others are zero.
    """
    names = [name_of(*one) for one in summands_of(entry)]
    rows = [[float(known.get(one, {}).get(other, 0.0)) for other in names] for one in names]
    return {**{key: value for key, value in entry.items() if key != "covariance"}, "covariance": rows}


EXAMPLE = {
    "force_x": {"v_x v_z": {"coefficient": 0.004, "range": [-60.0, 60.0]}},
    "force_z": {
        "thrust v_xy^2": {"coefficient": -4e-4, "range": [0.0, 4000.0]},
        "min(v_z,0)": {"coefficient": 0.05, "range": [-8.0, 0.0]},
    },
    "moment_y": {"v_x": {"coefficient": 0.002, "range": [-15.0, 15.0]}},
    "rotor_thrust": {"thrust over(mu,0.05)": {"coefficient": -0.8, "range": [0.0, 0.6]}},
    "rotor_speed": {"u": {"coefficient": -30.0, "range": [0.0, 1.0]}},
    "voltage": {"current": {"coefficient": -0.004, "range": [0.0, 80.0]}},
}

TERMS = {
    "equation": Term(
        Equation,
        wrench=wrench,
        steady_speed=steady_speed,
        supply=supply,
        check=check,
        idle={},
        example=EXAMPLE,
        effects=effects,
    ),
}
