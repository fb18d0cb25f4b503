"""Forces and moments: what accelerometer and gyro (or velocity) say, against the physics behind measured rotor speeds.

The physics is `physics.terms.wrench` itself, so what is fitted is what is simulated, with its whole footprint in forces
and moments at once. Its inputs are rotor speeds, velocity and rates; measured accelerations are the response alone, and
both sides pass through the same filter.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.flight_table import FlightTable
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.identification import grid
from swift_sim_bridge.identification.advice import fly, unit_of
from swift_sim_bridge.identification.regression import Coefficient, NotMeasured, Problem
from swift_sim_bridge.physics import terms
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.physics.vectors import vector

ACCELEROMETER_BIAS = 0.1  # m/s^2, standard deviation; without it an offset takes the place of thrust (hover is g)
USEFUL_FORCE, USEFUL_TURN = 0.25, 1.0  # m/s^2, rad/s^2 in a racing flight: a coarser answer is none
RACING_SPEED = 10.0  # m/s
AXES = "xyz"


@dataclass(frozen=True)
class _Flight:
    """One flight on its grid: motion, the filter, which filtered samples are good, and the responses (m,) by channel,
    in the body frame by accelerometer or in the world by velocity."""

    t: np.ndarray
    motion: terms.Motion
    filter: grid.Filter
    good: np.ndarray
    response: np.ndarray


def problem(tables: list[FlightTable], vehicle: Vehicle, names: list[str]) -> Problem:
    """Return the problem of thrust, torque and the named terms of the vehicle.

    Call it, and the problem's `linearise`, in double precision. Raises NotMeasured when the flights lack a channel that
    it needs.
    """
    by_accelerometer = all("specific_force_body" in table for table in tables)
    singly = all(_singly(table) for table in tables if "rotor_speed" in table)
    parameters = parameters_from_vehicle(vehicle, np.float64)
    flights = [_flight(table, vehicle, parameters, by_accelerometer, singly) for table in tables]
    coefficients = _coefficients(vehicle, parameters, names, flights, by_accelerometer)
    space = "body" if by_accelerometer else "world"
    channels = [(f"specific force {axis}, {space}", "m/s^2") for axis in AXES]
    channels += [(f"angular acceleration {axis}", "rad/s^2") for axis in AXES] if singly else []
    linearise = _model(flights, parameters, coefficients, by_accelerometer, len(channels))
    measured, channel, t, cluster, begin = [], [], [], [], 0
    for flight in flights:
        times = flight.t[flight.filter.reach : -flight.filter.reach : flight.filter.rows][flight.good]
        measured.append(flight.response[flight.good].T.ravel())
        channel.append(np.repeat(np.arange(len(channels)), len(times)))
        t.append(np.tile(times, len(channels)))
        cluster.append(begin + np.floor(t[-1] - flight.t[0]).astype(int))
        begin = begin + int(flight.t[-1] - flight.t[0]) + 3  # seconds of two flights are no neighbours
    notes = () if singly else ("moments are left out: all rotor speeds are the same, they were not measured singly",)
    arrays = map(np.concatenate, (measured, channel, cluster, t))
    name = "forces and moments"
    return Problem(name, tuple(coefficients), tuple(channels), *arrays, _remembering(linearise), notes)


def _singly(table: FlightTable) -> bool:
    """Return whether each rotor's own speed was measured."""
    speeds = table["rotor_speed"].values
    return bool(np.abs(speeds - speeds[:, :1]).max() > 0)


def _flight(table: FlightTable, vehicle: Vehicle, parameters, by_accelerometer: bool, singly: bool) -> _Flight:
    for name, columns in (("rotor_speed", "rotor speeds"), ("p_world", "position"), ("q_world_body", "attitude"),
                          ("gyro_body", "gyro")):
        if name not in table:
            raise NotMeasured(f"{table.name} has no {columns}")
    count = table["rotor_speed"].values.shape[1]
    if count != len(vehicle.rotors):
        raise NotMeasured(f"{table.name} has {count} rotors, the vehicle {len(vehicle.rotors)}")
    used = ["rotor_speed", "p_world", "q_world_body", "gyro_body"]
    used += ["v_world"] if "v_world" in table else []
    used += ["specific_force_body"] if by_accelerometer else []
    t = grid.uniform_times(table, *used)
    low_pass = grid.Filter(float(t[1] - t[0]) if len(t) > 1 else 1.0)
    if len(t) <= 4 * low_pass.reach:
        raise NotMeasured(f"in {table.name} {', '.join(used)} hardly overlap in time")
    q, v_world = grid.attitude_at(table["q_world_body"], t), grid.velocity_at(table, t)
    p_world, speed = grid.at(table["p_world"], t), grid.at(table["rotor_speed"], t)
    motion = terms.Motion(
        p_world=p_world,
        q_world_body=q,
        v_body=geometry.rotate_inverse(q, v_world - _wind(p_world, parameters)),
        omega_body=grid.at(table["gyro_body"], t),
        rotor_speed=speed,
        rotor_acceleration=np.gradient(speed, t, axis=0),
    )
    if by_accelerometer:
        force = low_pass.smooth(grid.at(table["specific_force_body"], t))
    else:
        force = low_pass.slope(v_world) + [0.0, 0.0, GRAVITY]
    turn = low_pass.slope(motion.omega_body)
    good = low_pass.whole(grid.known(table, used, t) & _airborne(motion, vehicle))
    return _Flight(t, motion, low_pass, good, np.concatenate([force, turn] if singly else [force], axis=1))


def _wind(p_world, parameters) -> np.ndarray:
    """Return the velocity (n, 3) m/s of the file's steady wind and draughts; of its gusts a recording does not know."""
    air = terms.air_velocity(vector(jnp.asarray(p_world)), {}, parameters)
    return np.stack([np.broadcast_to(part, len(p_world)) for part in air], axis=-1)


def _airborne(motion: terms.Motion, vehicle: Vehicle) -> np.ndarray:
    """Return the rows (n,) in which nothing but rotors and air carries the vehicle: not those in which it stands."""
    lift = vehicle.thrust_coefficient * np.sum(motion.rotor_speed**2, axis=1) / vehicle.mass
    still = (np.linalg.norm(motion.v_body, axis=1) < 0.2) & (np.linalg.norm(motion.omega_body, axis=1) < 0.3)
    return ~(still & (lift < 0.8 * GRAVITY))


def _coefficients(vehicle, parameters, names, flights, by_accelerometer) -> list[Coefficient]:
    found = [
        Coefficient(key, unit, getattr(vehicle, key), 0.0, fly(key), (key,), low=0.0)
        for key, unit in (("thrust_coefficient", "N s^2/rad^2"), ("torque_coefficient", "N m s^2/rad^2"))
    ]
    for name in names:
        for spec in fields(parameters.terms[name]):
            value = np.asarray(getattr(parameters.terms[name], spec.name))
            for index in np.ndindex(value.shape):
                text = f"terms.{name}.{spec.name}" + "".join(f"[{i}]" for i in index)
                path, unit = ("terms", name, spec.name, *index), unit_of(name, spec.name, index)
                found.append(Coefficient(text, unit, float(value[index]), 0.0, fly(name), path))
    found = [replace(c, tolerance=tolerance) for c, tolerance in
             zip(found, _tolerances(parameters, found, flights), strict=True)]
    if by_accelerometer:
        found += [
            Coefficient(f"accelerometer bias {axis}", "m/s^2", 0.0, np.inf, prior=ACCELEROMETER_BIAS) for axis in AXES
        ]
    return found


def with_values(parameters: Parameters, coefficients, theta) -> Parameters:
    """Return the parameters with the coefficients of the vehicle file at theta (k,). Thrust and torque of each rotor
    change by the same share, whatever else is wrong with one of them."""
    rotors, built = parameters.rotors, dict(parameters.terms)
    for coefficient, value in zip(coefficients, theta, strict=False):
        path = coefficient.path
        if path in (("thrust_coefficient",), ("torque_coefficient",)):
            rotors = replace(rotors, **{path[0]: getattr(rotors, path[0]) * (value / coefficient.start)})
        elif path:
            _, name, key, *index = path
            leaf = jnp.asarray(getattr(built[name], key))
            built[name] = replace(built[name], **{key: leaf.at[tuple(index)].set(value)})
    return replace(parameters, rotors=rotors, terms=built)


def _predicted(theta, motion: terms.Motion, parameters: Parameters, coefficients):
    """Return specific force (n, 3) m/s^2 and angular acceleration (n, 3) rad/s^2 in the body frame."""
    parameters = with_values(parameters, coefficients, theta)
    force, moment = terms.wrench(motion, parameters)
    momentum = motion.omega_body @ parameters.inertia
    moment = moment - geometry.cross(motion.omega_body, momentum)
    return force / parameters.mass, moment @ parameters.inertia_inverse


@partial(jax.jit, static_argnames="coefficients")
def _along(theta, direction, motion: terms.Motion, parameters: Parameters, coefficients):
    """Return `_predicted` at theta (k,) and its derivative along a direction (k,)."""
    predicted = partial(_predicted, motion=motion, parameters=parameters, coefficients=coefficients)
    return jax.jvp(predicted, (theta,), (direction,))


def _tolerances(parameters, coefficients, flights) -> np.ndarray:
    """Return the standard error (k,) of each coefficient that in a race would leave a useful answer at worst."""
    hover = np.sqrt(parameters.mass * GRAVITY / np.sum(parameters.rotors.thrust_coefficient))
    ways = np.array([*np.eye(3), *-np.eye(3), *np.array(np.meshgrid(*[(-0.6, 0.6)] * 3)).reshape(3, -1).T])
    count = len(parameters.rotors.spin)
    speed = np.full((len(ways) + 2, count), hover)
    speed[-2:] = np.where(parameters.rotors.spin * np.array([[1.0], [-1.0]]) > 0, hover, 0.0)  # one diagonal pair
    v_body = np.concatenate([RACING_SPEED * ways, np.zeros((2, 3))])
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(speed), 1))
    racing = terms.Motion(v_body, level, v_body, v_body[:, [1, 2, 0]], speed, 10.0 * speed)
    sample = [np.concatenate([part[:: max(1, len(part) // 500)] for part in parts])
              for parts in zip(*(flight.motion for flight in flights), strict=True)]
    motion = terms.Motion(*(np.concatenate(pair) for pair in zip(racing, sample, strict=True)))
    start = np.array([c.start for c in coefficients])
    motion = jax.tree.map(jnp.asarray, motion)
    effect = []
    for direction in np.eye(len(start)):
        force, turn = _along(start, direction, motion, parameters, tuple(coefficients))[1]
        effect.append(np.maximum(np.abs(force) / USEFUL_FORCE, np.abs(turn) / USEFUL_TURN).max(axis=1))
    effect = np.stack(effect, axis=-1)
    # the flight's wildest moments count as a race does, its very wildest may be a fault
    of_flight = np.percentile(effect[len(speed):], 99, axis=0)
    return 1.0 / np.maximum(np.maximum(effect[: len(speed)].max(axis=0), of_flight), 1e-300)


def _model(flights, parameters, coefficients, by_accelerometer, channels) -> Callable:
    """Return linearise(theta) -> predicted (N,), derivative (N, k), in the order of `problem`."""
    k = len(coefficients)
    physical = tuple(c for c in coefficients if c.path)
    motion = terms.Motion(*(np.concatenate(parts) for parts in zip(*(f.motion for f in flights), strict=True)))
    ends = np.cumsum([len(flight.t) for flight in flights])[:-1]

    def rows(force, turn) -> np.ndarray:
        force, turn = np.asarray(force), np.asarray(turn)
        if not by_accelerometer:
            force = geometry.rotate(motion.q_world_body, force)
        both = np.split(np.concatenate([force, turn], axis=1)[:, :channels], ends)
        return np.concatenate([f.filter.smooth(part)[f.good].T.ravel() for f, part in zip(flights, both, strict=True)])

    bias_rows = np.zeros((sum(f.good.sum() for f in flights) * channels, k - len(physical)))
    filled = 0
    for flight in flights:
        block = np.eye(channels)[:, :3].repeat(flight.good.sum(), axis=0)
        bias_rows[filled : filled + len(block)] = block[:, : bias_rows.shape[1]]
        filled += len(block)

    def linearise(theta):
        at, columns = jnp.asarray(theta[: len(physical)]), []
        for direction in np.eye(len(physical)):
            value, column = _along(at, direction, motion, parameters, physical)
            columns.append(rows(*column))
        predicted = rows(*value) + bias_rows @ theta[len(physical):]
        return predicted, np.column_stack([*columns, bias_rows])

    return _affine_if_so(linearise, coefficients)


def _affine_if_so(linearise: Callable, coefficients) -> Callable:
    """Return `linearise`, or where it is affine, as most terms are, the same evaluated once."""
    start = np.array([c.start for c in coefficients])
    step = np.array([c.tolerance if np.isfinite(c.tolerance) else 1.0 for c in coefficients])
    predicted, jacobian = linearise(start)
    moved, _ = linearise(start + step)
    if np.abs(moved - predicted - jacobian @ step).max(initial=0.0) > 1e-9 * np.abs(moved).max(initial=0.0):
        return linearise
    return lambda theta: (predicted + jacobian @ (theta - start), jacobian)


def _remembering(linearise: Callable) -> Callable:
    """Return `linearise` that remembers its last answer: the solver asks again for what it has just tried."""
    last: dict = {}

    def asked(theta):
        key = theta.tobytes()
        if key not in last:
            last.clear()
            last[key] = linearise(theta)
        return last[key]

    return asked
