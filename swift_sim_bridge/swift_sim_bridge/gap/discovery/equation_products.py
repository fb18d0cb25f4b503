"""Products of quantities in a recording: what an equation of the vehicle file may consist of.

They are computed by the functions that the simulator flies (`physics.terms.quantities`).
"""

from collections.abc import Iterator
from itertools import combinations_with_replacement
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.gap.residuals.channels import ANGULAR_ACCELERATION, ROTOR_SPEED, SPECIFIC_FORCE, VOLTAGE, Channel
from swift_sim_bridge.gap.residuals.filters import apply, averaged, derivative, lagged
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.sensor_correction import correct
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.physics.terms import quantities, registry
from swift_sim_bridge.physics.terms.motion import Instant, Motion, instant_of
from swift_sim_bridge.physics.terms.vectors import stack, vector
from swift_sim_bridge.sensors.terms import sensor_terms

RATES, SPEEDS = ("omega_x", "omega_y", "omega_z"), ("v_x", "v_y", "v_z")
AIR = ("", "v_x", "v_y", "v_z", "v_xy", "v_xy^2", "mu^2", "mu^3", "sink", "sink^2", "sink^3", "ring", "ground")
# From where on command and speed (share of the highest) may count, and peaks of the speed, as at a resonance.
BENDS_OF_COMMAND, BENDS_OF_SPEED = np.arange(0.1, 1.0, 0.1), np.arange(0.3, 1.0, 0.025)
PEAKS_OF_SPEED, REACHES_OF_SPEED = np.arange(0.3, 1.0, 0.025), (0.1, 0.15, 0.2, 0.3)
SHARE_BELOW_FASTEST = 0.995  # of the rows, whose speed is below the fastest that counts as recorded
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
    *(f"up_{axis}" for axis in "xyz"),  # not the heading: on another path a force that follows it is another one
)
# The same of a share of a rotor's thrust that changes somewhere in the range of a ratio, as at a stall or in a wake.
BENDS_OF_MU, BENDS_OF_SINK = np.arange(0.005, 0.2, 0.01), np.arange(0.1, 1.8, 0.1)
REACHES_OF_SINK = (0.3, 0.4, 0.5, 0.6, 0.8)
OF_ROTOR = (
    *(f"thrust {one}".strip() for one in ("", "v_z", "v_xy", "v_xy^2", "mu", "mu^2", "mu^3", "ground")),
    *(f"thrust {one}" for one in ("min(v_z,0)", "sink", "sink^2", "sink^3", "ring")),
    *(f"thrust over(mu,{bend:.3f}){power}" for bend in BENDS_OF_MU for power in ("", "^2")),
    *(f"thrust over(sink,{bend:.1f})" for bend in BENDS_OF_SINK),
    *(f"thrust around(sink,{bend:.1f},{reach})" for bend in BENDS_OF_SINK for reach in REACHES_OF_SINK),
    "Omega v_z",
)
OF_MOTOR = ("1", "u", "sqrt(u)", "u^2", "U", "U u", "U sqrt(u)", "Omega")
OF_PACK = ("current", "charge", "current^2", "current^3", "Omega^3")
BENDS_OF_CURRENT = np.arange(0.05, 0.55, 0.05)  # share of that at full speed from where on it may count: a worn plug


class Products(NamedTuple):
    """Products of quantities in a recording.

    Attributes:
        names: of the q products.
        values: (m, q), filtered as the residual to which they belong; of motors (m, q / (1 + rotors)), see `positions`.
        ranges: (q, 2) lowest and highest values that the simulator would meet in the recording.
        means: (q,) means that the values of a left side without a mean have lost; zeros elsewhere.
        positions: of the columns of `values` among the products. Those of one motor stand twice: as the products of all
            rotors, and as those of this rotor alone. Those of other rotors alone are zero.
    """

    names: tuple[str, ...]
    values: np.ndarray
    ranges: np.ndarray
    means: np.ndarray
    positions: tuple[slice, ...] = (slice(None),)

    def normal_equations(self, x, y) -> tuple[np.ndarray, np.ndarray]:
        """Return x^T x (q, q) and x^T y (q,) of all products, for some rows of `values` and of a residual."""
        size, square, slope = len(self.names), x.T @ x, x.T @ y
        information, gradient = np.zeros((size, size)), np.zeros(size)
        for row in self.positions:
            gradient[row] = slope
            for column in self.positions:
                information[row, column] = square
        return information, gradient


def products_of_recording(residual_model: ResidualModel, vehicle: Vehicle, places) -> dict[str, dict[int, Products]]:
    """Return by left side, by index of each channel that shows it, the products.

    The channel's residual is proportional to them: by mass or inertia, and behind the lag of a motor.
    """
    found: dict = {}
    parameters = parameters_from_vehicle(vehicle, np.float64, np.asarray)
    channels = residual_model.channels
    shown = {"force": SPECIFIC_FORCE, "moment": ANGULAR_ACCELERATION}
    if any(channel.quantity in shown.values() for channel in channels):
        products = (*IN_MOTION, *_thrusts(vehicle), *_at_places(places))
        moving = _in_motion(residual_model, vehicle, parameters, products)
        for kind, quantity in shown.items():
            for c, axis in _axes(channels, quantity):
                found[f"{kind}_{'xyz'[axis]}"] = {c: moving}
    rotors = [c for c, channel in enumerate(channels) if channel.quantity == ROTOR_SPEED]
    if rotors:
        found["rotor_speed"] = dict(zip(rotors, _of_motors(residual_model, vehicle, parameters), strict=True))
    if packs := [c for c, channel in enumerate(channels) if channel.quantity == VOLTAGE]:
        found["voltage"] = {packs[0]: _of_pack(residual_model, vehicle)}
    return found


def _axes(channels: tuple[Channel, ...], quantity: str) -> Iterator[tuple[int, int]]:
    """Yield (channel, axis) of a body vector."""
    yield from ((c, "xyz".index(one.axis)) for c, one in enumerate(channels) if one.quantity == quantity)


def _thrusts(vehicle: Vehicle) -> tuple[str, ...]:
    """Return products of the thrust of each rotor: alone, its square, and with the rates that tilt it with its arm."""
    numbers = range(1, len(vehicle.rotors) + 1)
    return tuple(f"thrust_{i}{one}" for one in ("", "^2", " omega_x", " omega_y") for i in numbers)


def _at_places(places) -> tuple[str, ...]:
    """Return the products of forces that act at one place: along the body's z axis, and along the world's axes."""
    axes = tuple(f"{name}_{axis}" for name in ("up", "east", "north") for axis in "xyz")
    return tuple(f"{place} {one}".strip() for place in places for one in ("", "thrust", *axes))


def _in_motion(residual_model: ResidualModel, vehicle: Vehicle, parameters: Parameters, products) -> Products:
    """Return products of the recorded motion; their ranges are those of the filtered ones, which have no noise."""
    recording = residual_model.recording
    instant = instant_of_recording(recording, vehicle, parameters)
    rows = {}
    for product in products:
        if not recording.has("single_rotor_speeds") and ("_Omega" in product or "thrust_" in product):
            continue
        value = quantities.product_of(product).value(instant)
        rows[product] = np.broadcast_to(np.asarray(value, dtype=float), len(recording.t))
    smooth = apply(residual_model.filter.smooth, np.stack(list(rows.values()), axis=-1))
    return Products(tuple(rows), smooth, ranges_of(smooth[residual_model.good]), np.zeros(len(rows)))


def products_at_rotors(residual_model: ResidualModel, vehicle: Vehicle, places) -> dict[int, Products]:
    """Return by index of a channel what products that add to each rotor's thrust add to it.

    There are none without the speed of each rotor, or where neither forces nor moments show.
    Unlike those of `products_of_recording` they are in the channel's unit: one coefficient has several channels.
    """
    recording, parameters = residual_model.recording, parameters_from_vehicle(vehicle, np.float64, np.asarray)
    moving = any(one.quantity in (SPECIFIC_FORCE, ANGULAR_ACCELERATION) for one in residual_model.channels)
    if not (moving and recording.has("single_rotor_speeds")):
        return {}
    products = (*OF_ROTOR, *(f"{place} thrust" for place in places))
    hubs = quantities.hubs(instant_of_recording(recording, vehicle, parameters))
    values = [[quantities.product_of(one, "rotor").value(hub) for one in products] for hub in hubs]
    each = np.moveaxis(np.asarray(values, dtype=float), 2, 0)  # (n, rotors, q)
    smooth = apply(residual_model.filter.smooth, each.reshape(len(each), -1)).reshape(-1, *each.shape[1:])
    ranges = ranges_of(smooth[residual_model.good].reshape(-1, len(products)))
    position = np.asarray(parameters.rotors.position)
    moments = np.stack([position[:, 1], -position[:, 0], np.zeros(len(position))])  # of a thrust of 1 N
    shares = {
        SPECIFIC_FORCE: np.array([[0.0], [0.0], [1.0 / vehicle.mass]]) * np.ones(len(position)),
        ANGULAR_ACCELERATION: np.linalg.solve(vehicle.inertia_matrix, moments),
    }
    return {
        c: Products(products, np.einsum("r,nrq->nq", share[axis], smooth), ranges, np.zeros(len(products)))
        for quantity, share in shares.items()
        for c, axis in _axes(residual_model.channels, quantity)
        if np.any(share[axis])
    }


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


def _of_motors(residual_model: ResidualModel, vehicle: Vehicle, parameters: Parameters) -> list[Products]:
    """Return for each rotor the effects of products on its speed: they change the steady speed, behind the lag."""
    recording, record = residual_model.recording, residual_model.recording.motor_record
    speed = physics_replay.rotor_speeds(physics_replay.stack_parameters([vehicle]), record)[0]
    command = np.concatenate([record.command, record.command[-1:]])
    products = (*OF_MOTOR, *(f"over(u,{bend:.1f})" for bend in BENDS_OF_COMMAND))
    highest = vehicle.rotor_speed_range[1]
    products += tuple(f"over(Omega,{bend * highest:.0f})" for bend in BENDS_OF_SPEED)
    peaks = {
        f"around(Omega,{peak * highest:.0f},{reach * highest:.0f})": peak * highest
        for peak in PEAKS_OF_SPEED
        for reach in REACHES_OF_SPEED
    }
    products += tuple(peaks)
    time, found = 0.5 * (vehicle.motor.time_constant_up + vehicle.motor.time_constant_down), []
    for i in range(speed.shape[1]):
        at = [np.interp(recording.t, record.t, part) for part in (command[:, i], record.voltage, speed[:, i])]
        if recording.has("single_rotor_speeds"):  # the vehicle's own speed, which is what the equation will meet
            at[2] = recording.rotor_speed[:, i]
        drive = quantities.Drive(*map(jnp.asarray, at), number=i + 1)
        fastest, ones = np.quantile(at[2], SHARE_BELOW_FASTEST), np.ones_like(at[2])
        values = [
            # zero for a peak beyond the recorded speeds: nothing shows that what rises falls again
            quantities.product_of(product, "motor").value(drive) * (peaks.get(product, 0.0) < fastest) * ones
            for product in products
        ]
        late = np.stack([lagged(np.asarray(one), recording.dt, time) for one in values], axis=-1)
        met = np.stack(values, axis=-1)[residual_model.filter.rows][residual_model.good]
        smooth = apply(residual_model.filter.smooth, late)
        shared = Products(products, smooth, ranges_of(met), np.zeros(len(products)))
        found.append(_with_each_alone(shared, i, speed.shape[1]))
    return found


def _with_each_alone(shared: Products, rotor: int, count: int) -> Products:
    """Return the products of one of `count` motors, and those of each motor alone, which are zero for the others."""
    size = len(shared.names)
    names = (*shared.names, *(f"rotor_{i + 1} {one}" for i in range(count) for one in shared.names))
    ranges = np.concatenate([shared.ranges, *((i == rotor) * shared.ranges for i in range(count))])
    begin = size * (1 + rotor)
    positions = (slice(0, size), slice(begin, begin + size))
    return Products(names, shared.values, ranges, np.zeros(len(names)), positions)


def _of_pack(residual_model: ResidualModel, vehicle: Vehicle) -> Products:
    """Return the effects of products on the voltage less its mean, averaged as the residual."""
    recording = residual_model.recording
    pack, speed = vehicle.battery, recording.rotor_speed
    cubed = np.sum(speed**3, axis=1)
    power_w = vehicle.torque_coefficient * cubed / pack.efficiency + pack.avionics_w
    drawn = recording.current if recording.has("current") else power_w / recording.voltage
    load = quantities.Load(drawn, np.cumsum(drawn) * recording.dt, tuple(recording.rotor_speed.T))
    full_w = vehicle.torque_coefficient * speed.shape[1] * vehicle.rotor_speed_range[1] ** 3 / pack.efficiency
    bends = BENDS_OF_CURRENT * full_w / pack.reference_voltage
    products, rows = (*OF_PACK, *(f"over(current,{bend:.1f})" for bend in bends)), residual_model.filter.rows
    values = np.stack([np.asarray(quantities.product_of(one, "supply").value(load)) for one in products], axis=-1)
    smooth = averaged(values - values.mean(axis=0), recording.dt)[rows]
    return Products(products, smooth, ranges_of(values[rows][residual_model.good]), values.mean(axis=0))


def ranges_of(values) -> np.ndarray:
    """Return lowest and highest (q, 2) of values (n, q)."""
    return np.stack([values.min(axis=0), values.max(axis=0)], axis=-1)
