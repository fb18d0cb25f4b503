"""Identification of a vehicle: forces and moments, pack and motors, one after the other."""

import copy
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, field, fields

import jax

from swift_ros.configuration import build
from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.identification import motor_replay, pack, wrenches
from swift_sim_bridge.identification.regression import Fit, NotMeasured, fit
from swift_sim_bridge.physics.terms import equation
from swift_sim_bridge.physics.terms.registry import PHYSICS

FORCES = [name for name, term in PHYSICS.items() if (term.hubs or term.wrench) and not term.airframe]
AIR_FORCES = (  # a vehicle file has one of them, or it gets the first
    "aerodynamic_polynomial",
    "rotor_drag",
    "linear_drag",
    "body_drag",
    "lift_cross",
    "axial_inflow",
    "translational_lift",
)
DIGITS = 7  # significant digits of a value in the repaired file: more than any standard error allows


@dataclass(frozen=True)
class Part:
    """One problem of the identification.

    Attributes:
        name: of the problem.
        fit: its solution; None when the flights lack a channel.
        missing: what they lack.
    """

    name: str
    fit: Fit | None = None
    missing: str | None = None


@dataclass(frozen=True)
class Change:
    """One identified coefficient.

    Attributes:
        path: in the vehicle file.
        name: in reports.
        before: value of the file.
        value: identified value.
        standard_error: of the value.
        half_interval95: half the width of the 95 % interval.
        unit: of all these.
    """

    path: tuple
    name: str
    before: float
    value: float
    standard_error: float
    half_interval95: float
    unit: str


@dataclass(frozen=True)
class Identification:
    """Result of an identification.

    Attributes:
        content: of the vehicle file with the identified values.
        parts: the problems in the order of their solution.
        changes: the identified coefficients in that order.
    """

    content: dict
    parts: tuple[Part, ...]
    changes: tuple[Change, ...] = field(default=())


def identify(
    tables: list[FlightTable], content: dict, where: str, more: Iterable[str] = (), less: Iterable[str] = ()
) -> Identification:
    """Return the coefficients of a vehicle that its flights determine.

    Each problem is solved with the values that the earlier ones have found.

    Args:
        tables: the flights.
        content: of the vehicle file.
        where: names the vehicle file in errors.
        more: terms to fit besides those of the file, from zero.
        less: terms of the file to remove.

    Raises:
        UsageError: a term is unknown, or a file is wrong.
    """
    content = with_terms(content, where, more, less)
    found = Identification(content, ())
    with jax.enable_x64(True):
        for name, problem in PROBLEMS.items():
            vehicle = build(Vehicle, found.content, where)
            try:
                part = Part(name, fit(problem(tables, vehicle, found.changes)))
            except NotMeasured as reason:
                part = Part(name, missing=str(reason))
            changes = _changes(part)
            found = Identification(
                with_changes(found.content, changes), (*found.parts, part), (*found.changes, *changes)
            )
    return found


def _wrenches(tables, vehicle: Vehicle, changes):
    """Return the problem of thrust, torque and the forces and moments of the file."""
    return wrenches.problem(tables, vehicle, [name for name in vehicle.terms if name in FORCES])


def _pack(tables, vehicle: Vehicle, changes):
    """Return the problem of the pack, with the standard error of the torque coefficient."""
    torque = (change.standard_error / change.value for change in changes if change.path == ("torque_coefficient",))
    return pack.problem(tables, vehicle, next(torque, 0.0))


def _motors(tables, vehicle: Vehicle, changes):
    """Return the problem of the motors."""
    return motor_replay.problem(tables, vehicle)


PROBLEMS = {"forces and moments": _wrenches, "battery": _pack, "motors": _motors}


def with_terms(content: dict, where: str, more: Iterable[str], less: Iterable[str]) -> dict:
    """Return the content of a vehicle file with terms added, all coefficients zero, and removed.

    A file without a force of the air gets the paper's polynomial (Methods, eq. 5). Raises UsageError for a name that is
    no force or moment, or that the file lacks.
    """
    content = copy.deepcopy(content)
    terms = content.get("terms") or {}
    for name in less:
        if name not in terms:
            raise UsageError(f"{where} has no term '{name}' to leave out; it has {', '.join(terms) or 'none'}")
        del terms[name]
    for name in more:
        if name not in FORCES:
            raise UsageError(f"there is no force or moment '{name}'; there are {', '.join(FORCES)}")
        terms.setdefault(name, zeros(PHYSICS[name].coefficients))
    if not set(terms) & set(AIR_FORCES):
        terms[AIR_FORCES[0]] = zeros(PHYSICS[AIR_FORCES[0]].coefficients)
    return content | {"terms": terms}


def zeros(record_type) -> dict:
    """Return the entry of a term with each coefficient at its default, or at zero where it has none."""
    entry = {}
    for spec in fields(record_type):
        if spec.default_factory is not MISSING:
            entry[spec.name] = spec.default_factory()
        elif spec.default is MISSING:
            count = len(getattr(spec.type, "__args__", ()))
            entry[spec.name] = [0.0] * count if count else 0.0
        else:
            entry[spec.name] = list(spec.default) if isinstance(spec.default, tuple) else spec.default
    return entry


def _changes(part: Part) -> tuple[Change, ...]:
    """Return the coefficients that a part has identified."""
    if part.fit is None:
        return ()
    rows = zip(
        part.fit.problem.coefficients,
        part.fit.theta,
        part.fit.standard_error,
        part.fit.half_interval95,
        part.fit.free,
        strict=True,
    )
    return tuple(
        Change(
            path=c.path,
            name=c.name,
            before=c.start,
            value=float(f"{value:.{DIGITS}g}"),
            standard_error=float(error),
            half_interval95=float(half),
            unit=c.unit,
        )
        for c, value, error, half, free in rows
        if c.path and free
    )


def with_changes(content: dict, changes: Iterable[Change]) -> dict:
    """Return the content of a vehicle file with the identified values, and with the variances of an equation's."""
    content, changes = copy.deepcopy(content), tuple(changes)
    for change in changes:
        *folders, last = change.path
        entry = content
        for key in folders:
            entry = entry[key]
        entry[last] = change.value
    variances = {
        equation.name_of(*change.path[2:4]): change.standard_error**2
        for change in changes
        if change.path[:2] == ("terms", "equation")
    }
    if variances:
        known = {name: {name: variance} for name, variance in variances.items()}
        content["terms"]["equation"] = equation.with_covariance(content["terms"]["equation"], known)
    return content


def as_result(found: Identification, tables: list[FlightTable]) -> dict:
    """Return the content of result.json."""
    rows, recorded, parts = [], [], {}
    for part in found.parts:
        parts[part.name] = _part_result(part)
        if part.fit is None:
            continue
        changed = {change.path: change for change in _changes(part)}
        for i, coefficient in enumerate(part.fit.problem.coefficients):
            if not coefficient.path:
                value, error = float(part.fit.theta[i]), float(part.fit.standard_error[i])
                if part.fit.free[i] and error < 0.9 * coefficient.prior:  # else the flights do not determine it
                    recorded.append(
                        {"name": coefficient.name, "value": value, "standard_error": error, "unit": coefficient.unit}
                    )
                continue
            change = changed.get(coefficient.path)
            row = {"name": coefficient.name, "part": part.name, "unit": coefficient.unit, "before": coefficient.start}
            if change:
                low, high = change.value - change.half_interval95, change.value + change.half_interval95
                row |= {"value": change.value, "standard_error": change.standard_error, "interval95": [low, high]}
            else:
                row |= {"refused": part.fit.refused[coefficient.name], "fly": coefficient.manoeuvre}
            rows.append(row)
    flights = [
        {
            "name": table.name,
            "span_s": list(map(float, table.span_s)),
            "channels": sorted(table.channels),
            "rejected_data": [rejection.as_json() for rejection in table.rejections],
        }
        for table in tables
    ]
    return {"flights": flights, "coefficients": rows, "recording": recorded, "parts": parts}


def _part_result(part: Part) -> dict:
    """Return the entry of a part in result.json."""
    if part.fit is None:
        return {"fitted": False, "missing": part.missing}
    units = dict(part.fit.problem.channels)
    held_out = {
        name: {"unit": units[name], "before": before, "after": after}
        for name, (before, after) in part.fit.held_out.items()
    }
    condition = part.fit.condition if part.fit.free.any() else None
    return {
        "fitted": bool(part.fit.free.any()),
        "notes": list(part.fit.problem.notes),
        "held_out_rmse": held_out,
        "condition_number": condition,
        "seconds": part.fit.freedom + 1,
    }
