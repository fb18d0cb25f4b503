"""How far beyond the recorded range a summand of an equation holds, where the flight itself shows it.

The coefficient is estimated from the inner half of its product's range, and from the rest. Where both agree, the flight
has shown that the product predicts twice as far as it was fitted, and its range is doubled. Any other ends where the
recordings end: a polynomial that only resembles the cause goes astray beyond. Towards zero a summand goes on that is
alone on its left side: a loss that was recorded in fast flight alone does not stay in slow flight. A voltage that is
lost in proportion to the current goes on to twice the current, by Ohm's law: it does not stop at the recorded one.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.discovery.equation_products import Products, products_at_rotors, products_of_recording
from swift_sim_bridge.gap.discovery.polynomial_search import Found, Residuals
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.physics.terms import equation, quantities

INNER_SHARE = 0.5  # of the largest value of a product
MAX_ERROR_SHARE = 0.2  # of the coefficient, its standard error; what is less certain shows nothing
AGREEMENT_ERRORS = 2.0  # standard errors by which the two coefficients may differ
AGREEMENT_SHARE = 0.1  # of the coefficient, by which they may differ where that is more
EXTRAPOLATED = ("force", "moment", equation.AT_ROTORS)  # motors saturate; for packs see `_bend_of_current`


def with_tested_ranges(
    residuals: Residuals, vehicle: Vehicle, found: Iterable[Found], coefficients: dict[str, float]
) -> tuple[Found, ...]:
    """Return the summands of an equation with the ranges in which they are used, see the module.

    Args:
        residuals: against the vehicle with the equation.
        vehicle: that vehicle.
        found: the summands.
        coefficients: of each, by its name.
    """
    found = tuple(found)
    sides = {one.side for one in found}
    columns = [_columns(one, vehicle, residuals.places, sides) for one in residuals.residual_models]

    def tested(one: Found) -> Found:
        if sum(other.side == one.side for other in found) == 1:
            one = replace(one, range=(min(one.range[0], 0.0), max(one.range[1], 0.0)))
        own = [products.get(one.side, {}) for products in columns]
        coefficient = coefficients[one.name] * _response(one.side, vehicle)
        low, high = one.range
        if one.side == "voltage" and (bend := _bend_of_current(one.product)) is not None:
            return replace(one, range=(low, (high + bend) / INNER_SHARE - bend))
        if equation.kind_of(one.side) not in EXTRAPOLATED or not _holds(residuals, own, one, coefficient):
            return one
        return replace(one, range=(low / INNER_SHARE, high / INNER_SHARE))

    return tuple(map(tested, found))


def _bend_of_current(product: str) -> float | None:
    """Return the current from which on a voltage is proportional to more of it; None for another product."""
    bend = quantities.OVER.fullmatch(product)
    if bend and bend[1] == "current":
        return float(bend[2])
    return 0.0 if product == "current" else None


def _columns(
    residual_model: ResidualModel, vehicle: Vehicle, places, sides: set[str]
) -> dict[str, dict[int, Products]]:
    """Return the products of some left sides in a recording, by index of each channel that shows them."""
    shown = products_of_recording(residual_model, vehicle, places)
    if equation.AT_ROTORS in sides:
        shown[equation.AT_ROTORS] = products_at_rotors(residual_model, vehicle, places)
    return shown


def _response(side: str, vehicle: Vehicle) -> float:
    """Return the acceleration of a channel for a left side of 1, as the columns of products have it."""
    kind = equation.kind_of(side)
    if kind == "force":
        return 1.0 / vehicle.mass
    axis = "xyz".find(side[-1])
    return 1.0 / float(vehicle.inertia_matrix[axis, axis]) if kind == "moment" else 1.0


def _holds(residuals: Residuals, columns: list[dict[int, Products]], one: Found, coefficient: float) -> bool:
    """Return whether the coefficients of the inner part of a product's range, and of the outer part, agree.

    Args:
        residuals: against the vehicle with the equation.
        columns: of each recording, by index of a channel, the products of the summand's left side.
        one: the summand.
        coefficient: of its column.
    """
    if not one.range[0] <= 0.0 <= one.range[1]:
        return False
    information, gradient = np.zeros(2), np.zeros(2)
    recorded = zip(columns, residuals.residual_models, residuals.lines, residuals.sigmas, strict=True)
    for own, model, line, sigma in recorded:
        size = None
        for c, products in own.items():
            x = products.values[:, products.names.index(one.product)]
            size = np.abs(x) if size is None else size  # of rotors: that of their sum
            inner = size <= INNER_SHARE * np.max(size[line.good], initial=0.0)
            for i, part in enumerate((inner, ~inner)):
                rows = part & line.good & model.measured[:, c]
                information[i] += float(x[rows] @ x[rows]) / sigma[c] ** 2
                gradient[i] += float(x[rows] @ line.residual[rows, c]) / sigma[c] ** 2
    if not information.all():
        return False
    changes, errors = gradient / information, information**-0.5
    known = errors.max() <= MAX_ERROR_SHARE * abs(coefficient)
    apart = max(AGREEMENT_ERRORS * float(np.hypot(*errors)), AGREEMENT_SHARE * abs(coefficient))
    return bool(known and abs(changes[0] - changes[1]) <= apart)
