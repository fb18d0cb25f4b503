"""Search for the equation that the vehicle file can carry: few summands of forces, moments, motor speeds and voltage.

One product after the other (see `equation_products`) is chosen by how much of the error in one half of the flight it
removes with the coefficient of the other half: a product whose coefficient differs from one half to the other is none.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.discovery.equation_products import products_at_rotors, products_of_recording, ranges_of
from swift_sim_bridge.gap.discovery.equation_search import searched_columns
from swift_sim_bridge.gap.discovery.half_regression import HalfRegression, Level
from swift_sim_bridge.gap.discovery.product_choice import chosen_products
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.propulsion import MAX_ABOVE_FULL_V, voltage_above_full
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.physics.terms import equation


@dataclass(frozen=True)
class Residuals:
    """Residuals of recordings against a vehicle.

    Attributes:
        residual_models: the recordings.
        lines: of each, the residuals.
        sigmas: of each, (c,) standard deviation of its residuals.
        places: factors of local quantities, such as "near(1,0,2,1.5)".
    """

    residual_models: tuple[ResidualModel, ...]
    lines: list[Linearisation]
    sigmas: tuple[np.ndarray, ...]
    places: tuple[str, ...] = ()


@dataclass(frozen=True)
class Found:
    """One summand that the search has found.

    Attributes:
        side: left side, such as "force_z".
        product: the product of quantities.
        range: its lowest and highest value in the whole recordings.
        removed_share: share of the squares of the left side's error, noise included, that it removes in one half with
            the coefficient of the other; of coefficients of each rotor's own an equal part.
    """

    side: str
    product: str
    range: tuple[float, float]
    removed_share: float

    @property
    def name(self) -> str:
        """The name of the summand, as that of its parameter."""
        return equation.name_of(self.side, self.product)


def equation_effects(vehicle: Vehicle, found: Iterable[Found]) -> tuple[Effect, ...]:
    """Return the effects of an equation with new summands beside those of the vehicle file."""
    entry = {side: dict(own) for side, own in vehicle.terms.get("equation", {}).items()}
    for one in found:
        entry.setdefault(one.side, {}).setdefault(one.product, {"coefficient": 0.0, "range": list(one.range)})
    return equation.effects(replace(vehicle, terms={**vehicle.terms, "equation": entry}))


def search(
    residuals: Residuals,
    vehicle: Vehicle,
    share: float,
    known: Iterable[Found] = (),
    at_rotors: bool = False,
    refused: frozenset[str] = frozenset(),
) -> list[Found]:
    """Return the summands that the residuals call for, by decreasing share of the error that each removes.

    Args:
        residuals: against the vehicle.
        vehicle: the vehicle with the selected effects.
        share: share of each recording that is used, from its start.
        known: summands that are chosen already; others join them.
        at_rotors: whether what adds to each rotor's thrust is sought before forces and moments of what it leaves.
        refused: names of summands that must not join.
    """
    found, searched = list(known), set(searched_columns(residuals.residual_models))

    def shown(products: dict) -> dict:
        return {c: own for c, own in products.items() if c in searched}

    if at_rotors:
        at = [shown(products_at_rotors(one, vehicle, residuals.places)) for one in residuals.residual_models]
        if problem := _problem(equation.AT_ROTORS, at, residuals, share):
            found += _chosen(problem, _products(found, equation.AT_ROTORS), refused)
            residuals = _less(residuals, at, problem, _products(found, equation.AT_ROTORS))
    columns = [products_of_recording(one, vehicle, residuals.places) for one in residuals.residual_models]
    for side in columns[0]:
        problem = _problem(side, [shown(own.get(side, {})) for own in columns], residuals, share)
        if problem is not None and side == "voltage":
            problem = replace(problem, levels=_levels(columns, residuals, vehicle))
        if problem is not None:
            found += _chosen(problem, _products(found, side), refused)
    return sorted(found, key=lambda one: -one.removed_share)


def _products(found: list[Found], side: str) -> list[str]:
    """Return the products of one left side."""
    return [one.product for one in found if one.side == side]


def _less(residuals: Residuals, columns, problem: HalfRegression, chosen: list[str]) -> Residuals:
    """Return the residuals less the chosen products of one left side, with the coefficients that fit them best.

    Args:
        residuals: of the recordings.
        columns: of each recording, by index of a channel, the products.
        problem: the regression of the left side.
        chosen: products of it.
    """
    rows = [problem.products.index(one) for one in chosen]
    coefficients = solve(problem.information.sum(axis=0)[np.ix_(rows, rows)], problem.gradient.sum(axis=0)[rows])
    lines = []
    for own, line in zip(columns, residuals.lines, strict=True):
        left = line.residual.copy()
        for c, products in own.items():
            left[:, c] -= products.values[:, rows] @ coefficients
        lines.append(replace(line, residual=left))
    return replace(residuals, lines=lines)


def _problem(side: str, columns, residuals: Residuals, share: float) -> HalfRegression | None:
    """Return the regression of one left side over all recordings, None without data.

    Args:
        side: left side.
        columns: of each recording, by index of a channel, the products.
        residuals: of the recordings.
        share: share of each recording that is used.
    """
    parts, shown, noise = [], [], 0.0
    recorded = zip(columns, residuals.residual_models, residuals.lines, residuals.sigmas, strict=True)
    for own, one, line, sigma in recorded:
        for c, products in own.items():
            good = line.good & one.measured[:, c]
            used = np.flatnonzero(good)[: int(share * np.count_nonzero(good))]
            if len(used) < 2:
                continue
            shown.append(products)
            x = products.values[used] / sigma[c]
            y = line.residual[used, c] / sigma[c]
            halves = np.array_split(np.arange(len(used)), 2)
            parts.append([(*products.normal_equations(x[h], y[h]), float(y[h] @ y[h])) for h in halves])
            noise += float(len(y))
    if not parts:
        return None
    information, gradient, squares = (np.stack([sum(part[i][k] for part in parts) for i in range(2)]) for k in range(3))
    ranges = ranges_of(np.concatenate([one.ranges.T for one in shown]))
    return HalfRegression(side, shown[0].names, ranges, information, gradient, squares, noise)


def _levels(columns, residuals: Residuals, vehicle: Vehicle) -> tuple[Level, ...]:
    """Return the mean of each recording's voltage, but of one that is above full already."""
    found = []
    for own, one, sigma in zip(columns, residuals.residual_models, residuals.sigmas, strict=True):
        above = voltage_above_full(one.recording, vehicle)
        if above < MAX_ABOVE_FULL_V:
            ((c, products),) = own["voltage"].items()
            found.append(Level(above, products.means, np.count_nonzero(one.good) / sigma[c] ** 2))
    return tuple(found)


def _chosen(problem: HalfRegression, known: list[str], refused: frozenset[str]) -> list[Found]:
    """Return the summands of one left side that join the products that are known already; see `search`."""
    offered = {j for j, one in enumerate(problem.products) if equation.name_of(problem.side, one) not in refused}
    total = float(problem.squares.sum())
    return [
        Found(problem.side, problem.products[j], tuple(map(float, problem.ranges[j])), share / total)
        for j, share in chosen_products(problem, [problem.products.index(one) for one in known], offered).items()
    ]
