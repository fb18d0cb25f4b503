"""Forces and moments of a flight as a function of coefficients of the vehicle file."""

from collections.abc import Callable
from dataclasses import dataclass, is_dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.identification import grid
from swift_sim_bridge.physics.state import Parameters
from swift_sim_bridge.physics.terms import registry

USEFUL_FORCE, USEFUL_TURN = 0.25, 1.0  # m/s^2, rad/s^2: largest useful error of the prediction in a race
RACING_SPEED = 10.0  # m/s in the instants of `race`; the paper's fastest race has a mean of 13.1 m/s
# Directions of flight in the body: along its axes both ways, and along 8 diagonals.
DIRECTIONS = np.array([*np.eye(3), *-np.eye(3), *np.stack(np.meshgrid(*[(-0.6, 0.6)] * 3), axis=-1).reshape(-1, 3)])
RACE = len(DIRECTIONS) + 2  # instants of `race`


@dataclass(frozen=True)
class Flight:
    """One flight on its grid.

    Attributes:
        t: (n,) s.
        motion: (n, ...).
        filter: low-pass of the grid.
        good: (m,), which filtered samples are used.
        measured: (m, channels), filtered: specific force (body frame by accelerometer, world frame by velocity), then
            the angular acceleration where the speed of each rotor was measured.
    """

    t: np.ndarray
    motion: registry.Motion
    filter: grid.Filter
    good: np.ndarray
    measured: np.ndarray


def race(parameters: Parameters) -> registry.Motion:
    """Return instants (RACE, ...) of a race: fast in all directions, and with each diagonal pair of rotors alone."""
    spin = np.asarray(parameters.rotors.spin)
    hover = np.sqrt(parameters.mass * GRAVITY / np.sum(parameters.rotors.thrust_coefficient))
    pairs = np.where(spin * np.array([[1.0], [-1.0]]) > 0, hover, 0.0)
    speed = np.concatenate([np.full((len(DIRECTIONS), len(spin)), hover), pairs])
    v_body = np.concatenate([RACING_SPEED * DIRECTIONS, np.zeros((2, 3))])
    level = np.tile([0.0, 0.0, 0.0, 1.0], (RACE, 1))
    return registry.Motion(v_body + [0.0, 0.0, 50.0], level, v_body, v_body[:, [1, 2, 0]], speed, 10.0 * speed)


def with_values(parameters: Parameters, before, paths, theta) -> Parameters:
    """Return parameters with other values at k paths of the vehicle file.

    Thrust and torque coefficients change by the same factor for all rotors, also where one rotor is damaged.

    Args:
        parameters: of the vehicle file.
        before: (k,) values of the file.
        paths: k paths.
        theta: (k,) new values.
    """
    rotors, built = parameters.rotors, dict(parameters.terms)
    for path, was, value in zip(paths, before, theta, strict=True):
        if path in (("thrust_coefficient",), ("torque_coefficient",)):
            rotors = replace(rotors, **{path[0]: getattr(rotors, path[0]) * (value / was)})
        else:
            _, name, *keys = path
            built[name] = _with_value(built[name], keys, value)
    return replace(parameters, rotors=rotors, terms=built)


def _with_value(coefficients, keys: list, value):
    """Return the coefficients of a term with another number at keys: names, then the indices of a vector."""
    if isinstance(coefficients, dict):
        key, *rest = keys
        return {**coefficients, key: _with_value(coefficients[key], rest, value)}
    if is_dataclass(coefficients):
        key, *rest = keys
        return replace(coefficients, **{key: _with_value(getattr(coefficients, key), rest, value)})
    return jnp.asarray(coefficients).at[tuple(keys)].set(value)


def accelerations(theta, motion: registry.Motion, parameters: Parameters, before, paths):
    """Return specific force (n, 3) m/s^2 and angular acceleration (n, 3) rad/s^2 in the body frame."""
    parameters = with_values(parameters, before, paths, theta)
    force, moment = registry.wrench(motion, parameters)
    moment = moment - geometry.cross(motion.omega_body, motion.omega_body @ parameters.inertia)
    return force / parameters.mass, moment @ parameters.inertia_inverse


@partial(jax.jit, static_argnames="paths")
def _along(theta, direction, motion, parameters, before, paths):
    """Return `accelerations` at theta (k,) and their derivatives along a direction (k,)."""
    return jax.jvp(lambda theta: accelerations(theta, motion, parameters, before, paths), (theta,), (direction,))


class Model:
    """Predicted measurements of accelerometer and gyro in some flights, given k coefficients of the vehicle file.

    Construct and call it in double precision.

    Args:
        flights: with their motion.
        parameters: of the vehicle file.
        paths: k paths of the coefficients.
        before: (k,) values of the file.
        in_world: whether the specific force is compared in the world frame.
    """

    def __init__(self, flights: list[Flight], parameters: Parameters, paths: tuple, before, in_world: bool):
        self._flights, self._in_world = flights, in_world
        motions = zip(race(parameters), *(flight.motion for flight in flights), strict=True)
        self._motion = registry.Motion(*(jnp.asarray(np.concatenate(parts)) for parts in motions))
        self._along = partial(
            _along, motion=self._motion, parameters=parameters, before=np.asarray(before), paths=paths
        )
        self._before = np.asarray(before, dtype=float)

    def tolerances(self) -> np.ndarray:
        """Return the largest useful standard error (k,) of each coefficient.

        With it, the prediction is useful at the worst instant of a race and at 99 % of the flights' instants.
        """
        effects = []
        for direction in np.eye(len(self._before)):
            force, turn = self._along(self._before, direction)[1]
            effect = np.maximum(np.abs(force) / USEFUL_FORCE, np.abs(turn) / USEFUL_TURN).max(axis=1)
            effects.append(max(effect[:RACE].max(), np.percentile(effect[RACE:], 99)))
        return 1.0 / np.maximum(effects, 1e-300)

    def linearise(self, theta) -> tuple[np.ndarray, np.ndarray]:
        """Return predictions (2, N) and their derivatives (2, N, k) at theta (k,).

        The first row has the filtered predictions of the good samples by flight and channel, the second their time
        derivatives.
        """
        columns = []
        for direction in np.eye(len(self._before)):
            value, column = self._along(jnp.asarray(theta), direction)
            columns.append(self._rows(*column))
        return self._rows(*value), np.stack(columns, axis=-1)

    def _rows(self, force, turn) -> np.ndarray:
        """Return specific force and angular acceleration of all instants as the two rows of `linearise`."""
        force, turn = np.asarray(force), np.asarray(turn)
        if self._in_world:
            force = geometry.rotate(np.asarray(self._motion.q_world_body), force)
        ends = np.cumsum([RACE, *(len(flight.t) for flight in self._flights)])[:-1]
        _, *both = np.split(np.concatenate([force, turn], axis=1), ends)
        pairs = list(zip(self._flights, both, strict=True))
        smooth = [by_channel(flight, flight.filter.smooth(part)) for flight, part in pairs]
        slope = [by_channel(flight, flight.filter.slope(part)) for flight, part in pairs]
        return np.stack([np.concatenate(smooth), np.concatenate(slope)])


def by_channel(flight: Flight, filtered) -> np.ndarray:
    """Return the good rows of `filtered` (m, channels or more), concatenated by channel."""
    return filtered[flight.good, : flight.measured.shape[1]].T.ravel()


def affine_if_so(linearise: Callable, start, step) -> Callable:
    """Return `linearise`, or an affine function without further evaluations where it is affine.

    With most terms it is; the check is from start (k,) to start + step (k,).
    """
    predicted, jacobian = linearise(start)
    moved, _ = linearise(start + step)
    if np.abs(moved - predicted - jacobian @ step).max(initial=0.0) > 1e-9 * np.abs(moved).max(initial=0.0):
        return linearise
    return lambda theta: (predicted + jacobian @ (theta - start), jacobian)
