"""Search for the equation that the vehicle file can carry: few summands of forces, moments, motor speeds and voltage.

The products are computed by the functions that the simulator flies (`physics.terms.quantities`). One after the other is
chosen by how much of the error in one half of the flight it removes with the coefficient of the other half: a product
whose coefficient differs from one half to the other is none.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.gap.residuals.channels import ANGULAR_ACCELERATION, ROTOR_SPEED, SPECIFIC_FORCE, VOLTAGE, Channel
from swift_sim_bridge.gap.residuals.filters import apply, averaged, derivative, lagged
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.sensor_correction import correct
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.physics.terms import equation, quantities, registry
from swift_sim_bridge.physics.terms.motion import Instant, Motion, instant_of
from swift_sim_bridge.physics.terms.vectors import stack, vector
from swift_sim_bridge.sensors.terms import sensor_terms

MAX_SUMMANDS = 4  # of one left side; more remove little and are harder to read
MIN_REMOVED_SHARE = 0.02  # of the error of a left side beyond its noise, that a summand must remove
MIN_EXCESS_SHARE = 0.05  # of the squares of a left side's noise, which its error beyond the noise is taken to be
MIN_GAIN = 40.0  # squares of independent samples that a summand must remove; noise gives 10 to the best of 100
MAX_DISAGREEMENT = 0.5  # of the mean of two halves' coefficients, by which they may differ
TIE_SHARE = 0.02  # of that error, by which a simpler product may remove less than the best one
MIN_INDEPENDENT_SHARE = 1e-3  # of a product's square that the chosen ones do not contain
ONE_HALF_SHARE = 0.02  # of a product's square, below which a half of the flight does not show it
BEND = 1e-6  # of the sum of squares of a product, added for products that are zero in one half

RATES, SPEEDS = ("omega_x", "omega_y", "omega_z"), ("v_x", "v_y", "v_z")
AIR = ("", "v_x", "v_y", "v_z", "v_xy", "v_xy^2", "mu^2", "mu^3", "sink", "sink^2", "sink^3", "ring", "ground")
IN_MOTION = (
    "1",
    *SPEEDS,
    *RATES,
    "|v|",
    "v_xy",
    "v_xy^2",
    "v_xy v_z",
    "min(v_z,0)",
    *(f"|v| {v}" for v in SPEEDS),
    *(" ".join(pair) for pair in combinations_with_replacement((*SPEEDS, *RATES), 2)),
    *(f"thrust {one}".strip() for one in (*AIR, *RATES)),
    *(f"Omega {one}" for one in (*SPEEDS, *RATES)),
    *(f"spin_Omega {one}" for one in (*SPEEDS[:2], *RATES[:2])),
    "spin_Omega'",
    *(f"{name}_{axis}" for name in ("up", "east", "north") for axis in "xyz"),
)
OF_MOTOR = ("1", "u", "sqrt(u)", "u^2", "U", "U u", "U sqrt(u)", "Omega")
OF_PACK = ("current", "charge", "current^2", "Omega^3")


@dataclass(frozen=True)
class Found:
    """One summand that the search has found.

    Attributes:
        side: left side, such as "force_z".
        product: the product of quantities.
        range: its lowest and highest value in the recordings.
        removed_share: share of the squares of the left side's error, noise included, that it removes in one half with
            the coefficient of the other.
    """

    side: str
    product: str
    range: tuple[float, float]
    removed_share: float

    @property
    def name(self) -> str:
        """The name of the summand, as that of its parameter."""
        return equation.name_of(self.side, self.product)


@dataclass(frozen=True)
class _Problem:
    """The regression of one left side on q products, for each half of the flight.

    Attributes:
        side: left side.
        products: (q,).
        ranges: (q, 2).
        information: (2, q, q) products of the products, by half.
        gradient: (2, q) products of the products and the error, by half.
        squares: (2,) squares of the error, by half.
        noise: squares of its noise, of both halves.
    """

    side: str
    products: tuple[str, ...]
    ranges: np.ndarray
    information: np.ndarray
    gradient: np.ndarray
    squares: np.ndarray
    noise: float


def search(
    residual_models: tuple[ResidualModel, ...],
    vehicle: Vehicle,
    lines: list[Linearisation],
    sigmas,
    share: float,
    places: tuple[str, ...] = (),
) -> list[Found]:
    """Return the summands that the residuals call for, by decreasing share of the error that each removes.

    Args:
        residual_models: the recordings.
        vehicle: the vehicle with the selected effects.
        lines: the residuals against it.
        sigmas: of each recording, (c,) standard deviation of its residuals.
        share: share of each recording that is used, from its start.
        places: factors of local quantities, such as "near(1,0,2,1.5)".
    """
    found = []
    columns = [_columns(one, vehicle, places) for one in residual_models]
    for side in columns[0]:
        problem = _problem(side, [own.get(side, {}) for own in columns], residual_models, lines, sigmas, share)
        if problem is not None:
            found += _chosen(problem)
    return sorted(found, key=lambda one: -one.removed_share)


def _columns(residual_model: ResidualModel, vehicle: Vehicle, places) -> dict[str, dict[int, dict[str, np.ndarray]]]:
    """Return by left side, by index of each channel that shows it, the products (m,) by name, filtered as the channel.

    The channel's residual is proportional to them: by mass or inertia, and behind the lag of a motor.
    """
    found: dict = {}
    parameters = parameters_from_vehicle(vehicle, np.float64, np.asarray)
    channels = residual_model.channels
    shown = {"force": SPECIFIC_FORCE, "moment": ANGULAR_ACCELERATION}
    if any(channel.quantity in shown.values() for channel in channels):
        products = (*IN_MOTION, *_of_rotors(vehicle), *_at_places(places))
        values = _in_motion(residual_model, vehicle, parameters, products)
        for kind, quantity in shown.items():
            for c, axis in _axes(channels, quantity):
                found[f"{kind}_{'xyz'[axis]}"] = {c: values}
    rotors = [c for c, channel in enumerate(channels) if channel.quantity == ROTOR_SPEED]
    if rotors:
        found["rotor_speed"] = dict(zip(rotors, _of_motors(residual_model, vehicle, parameters), strict=True))
    if packs := [c for c, channel in enumerate(channels) if channel.quantity == VOLTAGE]:
        found["voltage"] = {packs[0]: _of_pack(residual_model, vehicle)}
    return found


def _axes(channels: tuple[Channel, ...], quantity: str) -> Iterator[tuple[int, int]]:
    """Yield (channel, axis) of a body vector."""
    yield from ((c, "xyz".index(one.axis)) for c, one in enumerate(channels) if one.quantity == quantity)


def _of_rotors(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the thrust of each rotor as a product."""
    return tuple(f"thrust_{i + 1}" for i in range(len(vehicle.rotors)))


def _at_places(places) -> tuple[str, ...]:
    """Return the products of forces that act at one place: along the body's z axis, and along the world's axes."""
    axes = tuple(f"{name}_{axis}" for name in ("up", "east", "north") for axis in "xyz")
    return tuple(f"{place} {one}".strip() for place in places for one in ("", "thrust", *axes))


def _in_motion(residual_model: ResidualModel, vehicle: Vehicle, parameters: Parameters, products) -> dict:
    """Return products (m,) of the recorded motion by name, filtered as the residuals."""
    recording = residual_model.recording
    instant = instant_of_recording(recording, vehicle, parameters)
    rows = {}
    for product in products:
        if not recording.has("single_rotor_speeds") and ("_Omega" in product or "thrust_" in product):
            continue
        value = quantities.product_of(product).value(instant)
        rows[product] = np.broadcast_to(np.asarray(value, dtype=float), len(recording.t))
    smooth = apply(residual_model.filter.smooth, np.stack(list(rows.values()), axis=-1))
    return dict(zip(rows, smooth.T, strict=True))


def instant_of_recording(recording, vehicle: Vehicle, parameters: Parameters) -> Instant:
    """Return the recorded motion (n,) without the errors of the sensors, as the physics takes it."""
    corrected = correct(recording, sensor_terms(vehicle))
    p_world, q, v_world, _ = corrected.moving
    air = stack(registry.air_velocity(vector(jnp.asarray(p_world)), {}, parameters), like=jnp.asarray(p_world[..., 0]))
    speed = recording.rotor_speed
    motion = Motion(
        p_world,
        q,
        geometry.rotate_inverse(q, v_world - np.asarray(air)),
        corrected.gyro_body,
        speed,
        derivative(speed, recording.dt),
    )
    return instant_of(Motion(*(jnp.asarray(part) for part in motion)), parameters)


def _of_motors(residual_model: ResidualModel, vehicle: Vehicle, parameters: Parameters) -> list[dict]:
    """Return for each rotor the effect (m,) of products on its speed: they change the steady speed, behind the lag."""
    recording, record = residual_model.recording, residual_model.recording.motor_record
    speed = physics_replay.rotor_speeds(physics_replay.stack_parameters([vehicle]), record)[0]
    command = np.concatenate([record.command, record.command[-1:]])
    time, found = 0.5 * (vehicle.motor.time_constant_up + vehicle.motor.time_constant_down), []
    for i in range(speed.shape[1]):
        at = (np.interp(recording.t, record.t, part) for part in (command[:, i], record.voltage, speed[:, i]))
        drive = quantities.Drive(*map(jnp.asarray, at))
        values = [
            quantities.product_of(product, "motor").value(drive) * jnp.ones_like(drive.speed) for product in OF_MOTOR
        ]
        late = np.stack([lagged(np.asarray(one), recording.dt, time) for one in values], axis=-1)
        found.append(dict(zip(OF_MOTOR, apply(residual_model.filter.smooth, late).T, strict=True)))
    return found


def _of_pack(residual_model: ResidualModel, vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Return the effect (m,) of products on the voltage less its mean, averaged as the residual."""
    recording = residual_model.recording
    cubed = np.sum(recording.rotor_speed**3, axis=1)
    pack = vehicle.battery
    power_w = vehicle.torque_coefficient * cubed / pack.efficiency + pack.avionics_w
    drawn = recording.current if recording.has("current") else power_w / recording.voltage
    load = quantities.Load(drawn, np.cumsum(drawn) * recording.dt, tuple(recording.rotor_speed.T))
    values = np.stack([np.asarray(quantities.product_of(one, "supply").value(load)) for one in OF_PACK], axis=-1)
    smooth = averaged(values - values.mean(axis=0), recording.dt)[residual_model.filter.rows]
    return dict(zip(OF_PACK, smooth.T, strict=True))


def _problem(side: str, columns, residual_models, lines, sigmas, share: float) -> _Problem | None:
    """Return the regression of one left side over all recordings, None without data.

    Args:
        side: left side.
        columns: of each recording, by index of a channel, the products (m,) by name.
        residual_models: the recordings.
        lines: their residuals.
        sigmas: of each recording, (c,) standard deviation of its residuals.
        share: share of each recording that is used.
    """
    parts, names = [], None
    for own, one, line, sigma in zip(columns, residual_models, lines, sigmas, strict=True):
        for c, products in own.items():
            names = names or tuple(products)
            good = line.good & one.measured[:, c]
            used = np.flatnonzero(good)[: int(share * np.count_nonzero(good))]
            if len(used) < 2:
                continue
            x = np.stack([products[name][used] for name in names], axis=-1) / sigma[c]
            y = line.residual[used, c] / sigma[c]
            halves = np.array_split(np.arange(len(used)), 2)
            parts.append((x, y, halves, sigma[c]))
    if not parts or names is None:
        return None
    information = np.stack([sum(x[h[i]].T @ x[h[i]] for x, _, h, _ in parts) for i in range(2)])
    gradient = np.stack([sum(x[h[i]].T @ y[h[i]] for x, y, h, _ in parts) for i in range(2)])
    squares = np.array([sum(float(y[h[i]] @ y[h[i]]) for _, y, h, _ in parts) for i in range(2)])
    raw = np.concatenate([x * sigma for x, _, _, sigma in parts])
    ranges = np.stack([raw.min(axis=0), raw.max(axis=0)], axis=-1)
    return _Problem(side, names, ranges, information, gradient, squares, float(sum(len(y) for _, y, _, _ in parts)))


def _chosen(problem: _Problem) -> list[Found]:
    """Return the summands of one left side."""
    excess = max(float(problem.squares.sum()) - problem.noise, MIN_EXCESS_SHARE * problem.noise)
    chosen: list[int] = []
    removed = [0.0]
    while len(chosen) < MAX_SUMMANDS:
        scores = {j: _removed(problem, [*chosen, j]) for j in _independent(problem, chosen)}
        best = _simplest(problem, scores, TIE_SHARE * excess)
        if best is None or scores[best] - removed[-1] < max(MIN_REMOVED_SHARE * excess, MIN_GAIN):
            break
        chosen.append(best)
        removed.append(scores[best])
    steps = np.diff(removed) / problem.squares.sum()
    return [
        Found(problem.side, problem.products[j], tuple(map(float, problem.ranges[j])), float(step))
        for j, step in zip(chosen, steps, strict=True)
    ]


def _simplest(problem: _Problem, scores: dict[int, float], tie: float) -> int | None:
    """Return the product of the fewest factors among those whose score is the largest but for `tie`."""
    largest = max(scores.values(), default=-np.inf)
    tied = [j for j, score in scores.items() if score > -np.inf and score >= largest - tie]
    return min(
        tied, key=lambda j: (sum(power for _, power in quantities.factors(problem.products[j])), j), default=None
    )


def _independent(problem: _Problem, chosen: list[int]) -> list[int]:
    """Return the products that the chosen ones do not contain."""
    total = problem.information.sum(axis=0)
    diagonal = np.diag(total)
    remaining = diagonal.copy()
    if chosen:
        weights = solve(total[np.ix_(chosen, chosen)], total[chosen])
        remaining = remaining - np.einsum("ij,ij->j", total[chosen], weights)
    return [j for j in np.flatnonzero(remaining > MIN_INDEPENDENT_SHARE * diagonal) if j not in chosen]


def _removed(problem: _Problem, rows: list[int]) -> float:
    """Return by how much the coefficients of one half lower the squares of the other, both ways together.

    Minus infinity if the coefficient of the last product differs between the halves.
    """
    at, lowered = np.ix_(rows, rows), 0.0
    total = problem.information.sum(axis=0)[at]
    fits = [
        solve(problem.information[i][at] + BEND * np.diag(np.diag(total)), problem.gradient[i][rows]) for i in range(2)
    ]
    if min(one[rows[-1], rows[-1]] for one in problem.information) < ONE_HALF_SHARE * total[-1, -1]:
        fits = [solve(total, problem.gradient.sum(axis=0)[rows])] * 2  # a place that is passed in one half alone
    for i, other in ((0, 1), (1, 0)):
        x = fits[other]
        lowered += float(2.0 * x @ problem.gradient[i][rows] - x @ problem.information[i][at] @ x)
    first, second = fits[0][-1], fits[1][-1]
    if abs(first - second) > MAX_DISAGREEMENT * 0.5 * abs(first + second):
        return -np.inf
    return lowered
