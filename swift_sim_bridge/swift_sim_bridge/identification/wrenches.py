"""Forces and moments: accelerometer (or velocity) and gyro, compared with the physics at the measured rotor speeds.

The physics is `physics.terms.registry.wrench`, so the fitted function is the simulated one, in forces and moments at
once. Its inputs are rotor speeds, velocity and body rates; the measured accelerations are the response alone. Both
pass through the same filter.
"""

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.identification import grid
from swift_sim_bridge.identification.advice import manoeuvre, unit_of
from swift_sim_bridge.identification.regression import Coefficient, NotMeasured, Problem
from swift_sim_bridge.identification.wrench_model import Flight, Model, affine_if_so, by_channel
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.vectors import vector

ACCELEROMETER_BIAS = 0.1  # m/s^2, prior standard deviation; without it a bias replaces thrust (hover is g)
DELAY_S = 0.005  # s, prior standard deviation of the delay between IMU and rotor speeds in a log
INERTIA_SHARE = 0.1  # prior standard deviation of the relative error of an inertia in a vehicle file
STILL_SPEED, STILL_RATE = 0.2, 0.3  # m/s, rad/s: slower than both, and with little thrust, the vehicle rests
RESTING_THRUST = 0.8  # of gravity: less thrust at rest means that something else carries the vehicle
AXES = "xyz"
NO_WRENCH = ("rotor_speed", "voltage")  # left sides of an equation that are neither force nor moment
NEEDED = {"rotor_speed": "rotor speeds", "p_world": "position", "q_world_body": "attitude", "gyro_body": "gyro"}


def problem(tables: list[FlightTable], vehicle: Vehicle, names: list[str]) -> Problem:
    """Return the problem of thrust, torque and the named terms of the vehicle.

    Call it and the problem's `linearise` in double precision. Raises NotMeasured when the flights lack a channel.
    """
    by_accelerometer = all("specific_force_body" in table for table in tables)
    each_rotor = all(_has_each_rotor(table) for table in tables if "rotor_speed" in table)
    parameters = parameters_from_vehicle(vehicle, np.float64)
    flights = [_flight(table, vehicle, parameters, by_accelerometer, each_rotor) for table in tables]
    coefficients = _coefficients(vehicle, parameters, names)
    before = np.array([c.start for c in coefficients])
    model = Model(flights, parameters, tuple(c.path for c in coefficients), before, not by_accelerometer)
    tolerances = model.tolerances()
    coefficients = [replace(c, tolerance=tolerance) for c, tolerance in zip(coefficients, tolerances, strict=True)]
    linearise = affine_if_so(model.linearise, before, tolerances)
    coefficients += _delays(by_accelerometer, each_rotor)
    linearise = _with_delays(linearise, flights, each_rotor)
    if each_rotor:
        coefficients += _responses()
        linearise = _with_responses(linearise, flights)
    if by_accelerometer:
        coefficients += _biases()
        linearise = _with_biases(linearise, flights)

    space = "body" if by_accelerometer else "world"
    channels = [(f"specific force {axis}, {space}", "m/s^2") for axis in AXES]
    channels += [(f"angular acceleration {axis}", "rad/s^2") for axis in AXES] if each_rotor else []
    notes = (
        ()
        if each_rotor
        else ("moments are left out: all rotor speeds are equal, so each rotor's own speed was not measured",)
    )
    arrays = map(np.concatenate, zip(*_measured(flights), strict=True))
    name = "forces and moments"
    return Problem(name, tuple(coefficients), tuple(channels), *arrays, _cached(linearise), notes)


def _measured(flights: list[Flight]):
    """Yield measured, channel, cluster and t (N,) of each flight."""
    begin = 0
    for flight in flights:
        reach, step = flight.filter.reach, flight.filter.rows
        t = flight.t[reach:-reach:step][flight.good]
        channels = flight.measured.shape[1]
        seconds = begin + np.floor(t - flight.t[0]).astype(int)
        yield (
            by_channel(flight, flight.measured),
            np.repeat(np.arange(channels), len(t)),
            np.tile(seconds, channels),
            np.tile(t, channels),
        )
        begin += int(flight.t[-1] - flight.t[0]) + 3  # clusters of two flights are not adjacent


def _has_each_rotor(table: FlightTable) -> bool:
    """Return whether each rotor's own speed was measured."""
    speeds = table["rotor_speed"].values
    return bool(np.abs(speeds - speeds[:, :1]).max() > 0)


def _flight(table: FlightTable, vehicle: Vehicle, parameters, by_accelerometer: bool, each_rotor: bool) -> Flight:
    """Return a flight table on the grid. Raises NotMeasured when it lacks a channel or its channels hardly overlap."""
    for name, columns in NEEDED.items():
        if name not in table:
            raise NotMeasured(f"{table.name} has no {columns}")
    count = table["rotor_speed"].values.shape[1]
    if count != len(vehicle.rotors):
        raise NotMeasured(f"{table.name} has {count} rotors, the vehicle {len(vehicle.rotors)}")
    used = list(NEEDED)
    used += ["v_world"] if "v_world" in table else []
    used += ["specific_force_body"] if by_accelerometer else []
    t = grid.uniform_times(table, *used)
    low_pass = grid.Filter(float(t[1] - t[0]) if len(t) > 1 else 1.0)
    if len(t) <= 4 * low_pass.reach:
        raise NotMeasured(f"in {table.name} {', '.join(used)} hardly overlap in time")
    q, v_world = grid.attitude_at(table["q_world_body"], t), grid.velocity_at(table, t)
    p_world, speed = grid.at(table["p_world"], t), grid.at(table["rotor_speed"], t)
    motion = registry.Motion(
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
    return Flight(t, motion, low_pass, good, np.concatenate([force, turn] if each_rotor else [force], axis=1))


def _wind(p_world, parameters) -> np.ndarray:
    """Return the velocity (n, 3) m/s of the file's steady wind and draughts; gusts of a recording are unknown."""
    air = registry.air_velocity(vector(jnp.asarray(p_world)), {}, parameters)
    return np.stack([np.broadcast_to(part, len(p_world)) for part in air], axis=-1)


def _airborne(motion: registry.Motion, vehicle: Vehicle) -> np.ndarray:
    """Return the rows (n,) in which rotors and air alone carry the vehicle, not the ground."""
    lift = vehicle.thrust_coefficient * np.sum(motion.rotor_speed**2, axis=1) / vehicle.mass
    still = np.linalg.norm(motion.v_body, axis=1) < STILL_SPEED
    still &= np.linalg.norm(motion.omega_body, axis=1) < STILL_RATE
    return ~(still & (lift < RESTING_THRUST * GRAVITY))


def _coefficients(vehicle: Vehicle, parameters, names) -> list[Coefficient]:
    """Return thrust and torque coefficient, and every coefficient of the named terms."""
    found = [
        Coefficient(key, unit_of(key, vehicle), getattr(vehicle, key), 0.0, manoeuvre(key, vehicle), (key,), low=0.0)
        for key in ("thrust_coefficient", "torque_coefficient")
    ]
    for name in names:
        for keys, value in _numbers(parameters.terms[name]):
            if keys[0] in NO_WRENCH:
                continue
            text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in ("terms", name, *keys))[1:]
            unit = registry.PHYSICS[name].unit(name, keys[0], vehicle, keys[1:])
            path = ("terms", name, *keys)
            found.append(Coefficient(text, unit, value, 0.0, manoeuvre(name, vehicle), path))
    return found


def _numbers(coefficients) -> Iterator[tuple[tuple, float]]:
    """Yield (keys, value) of each number of a term's coefficients: names, then the indices of a vector."""
    for keys, leaf in jax.tree_util.tree_leaves_with_path(coefficients):
        names = tuple(getattr(key, "name", getattr(key, "key", None)) for key in keys)
        for index in np.ndindex(np.shape(leaf)):
            yield (*names, *index), float(np.asarray(leaf)[index])


def _delays(by_accelerometer: bool, each_rotor: bool) -> list[Coefficient]:
    """Return the delays of the sensors behind the rotor speeds."""
    who = ["accelerometer" if by_accelerometer else "velocity"] + (["gyro"] if each_rotor else [])
    return [Coefficient(f"{name} delay", "s", 0.0, np.inf, prior=DELAY_S) for name in who]


def _with_delays(linearise, flights: list[Flight], each_rotor: bool):
    """Return `linearise` with one more coefficient: the delay (s) of the first three channels behind the rotor speeds.

    With `each_rotor` the other channels have a delay as well. Causes are the sensor's filter, averaging and clock.
    """
    channel = np.concatenate([np.arange(f.measured.shape[1]).repeat(f.good.sum()) for f in flights])
    late = np.stack([channel < 3, channel >= 3][: 1 + each_rotor], axis=-1).astype(float)
    count = late.shape[1]

    def with_delays(theta):
        (smooth, slope), (by_smooth, by_slope) = linearise(theta[:-count])
        delay = late @ theta[-count:]
        return smooth - delay * slope, np.concatenate(
            [by_smooth - delay[:, None] * by_slope, -late * slope[:, None]], axis=1
        )

    return with_delays


def _responses() -> list[Coefficient]:
    """Return the factors of the angular accelerations in roll and pitch."""
    return [
        Coefficient(f"response in {axis} over the file's", "", 1.0, np.inf, prior=INERTIA_SHARE)
        for axis in ("roll", "pitch")
    ]


def _with_responses(linearise, flights: list[Flight]):
    """Return `linearise` with two more coefficients: factors of the angular accelerations in roll and in pitch.

    They absorb errors of the inertia, which must not bias the thrust coefficient that the forces determine.
    """
    channel = np.concatenate([np.arange(f.measured.shape[1]).repeat(f.good.sum()) for f in flights])
    turning = np.stack([channel == 3, channel == 4], axis=-1).astype(float)

    def with_responses(theta):
        predicted, jacobian = linearise(theta[:-2])
        share = 1.0 + turning @ (theta[-2:] - 1.0)
        return share * predicted, np.concatenate([share[:, None] * jacobian, turning * predicted[:, None]], axis=1)

    return with_responses


def _biases() -> list[Coefficient]:
    """Return the biases of the accelerometer."""
    return [Coefficient(f"accelerometer bias {axis}", "m/s^2", 0.0, np.inf, prior=ACCELEROMETER_BIAS) for axis in AXES]


def _with_biases(linearise, flights: list[Flight]):
    """Return `linearise` with three more coefficients: biases of the first three channels."""
    columns = np.concatenate([np.eye(f.measured.shape[1])[:, :3].repeat(f.good.sum(), axis=0) for f in flights])

    def with_biases(theta):
        predicted, jacobian = linearise(theta[:-3])
        return predicted + columns @ theta[-3:], np.concatenate([jacobian, columns], axis=1)

    return with_biases


def _cached(linearise):
    """Return `linearise` with a cache of its last result: the solver evaluates the same point twice."""
    last: dict = {}

    def evaluated(theta):
        key = theta.tobytes()
        if key not in last:
            last.clear()
            last[key] = linearise(theta)
        return last[key]

    return evaluated
