"""The physics behind a flight's forces and moments, as a function of coefficients of the vehicle file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.identification import grid
from swift_sim_bridge.physics.state import Parameters
from swift_sim_bridge.physics.terms import registry

USEFUL_FORCE, USEFUL_TURN = 0.25, 1.0  # m/s^2, rad/s^2 in a race: a coarser answer is none
RACING_SPEED = 10.0  # m/s
WAYS = np.array([*np.eye(3), *-np.eye(3), *np.stack(np.meshgrid(*[(-0.6, 0.6)] * 3), axis=-1).reshape(-1, 3)])
RACE = len(WAYS) + 2  # instants of `race`


@dataclass(frozen=True)
class Flight:
    """One flight on its grid: t (n,) s, motion (n, ...), the filter, which filtered samples (m,) are good, and what was
    measured (m, channels): specific force (in the body by accelerometer, in the world by velocity), then the angular
    acceleration where each rotor was measured singly."""

    t: np.ndarray
    motion: registry.Motion
    filter: grid.Filter
    good: np.ndarray
    measured: np.ndarray


def race(parameters: Parameters) -> registry.Motion:
    """Return instants (RACE, ...) of a race: fast all ways with all rotors at hover, and each diagonal pair alone."""
    spin = np.asarray(parameters.rotors.spin)
    hover = np.sqrt(parameters.mass * GRAVITY / np.sum(parameters.rotors.thrust_coefficient))
    pairs = np.where(spin * np.array([[1.0], [-1.0]]) > 0, hover, 0.0)
    speed = np.concatenate([np.full((len(WAYS), len(spin)), hover), pairs])
    v_body = np.concatenate([RACING_SPEED * WAYS, np.zeros((2, 3))])
    level = np.tile([0.0, 0.0, 0.0, 1.0], (RACE, 1))
    return registry.Motion(v_body + [0.0, 0.0, 50.0], level, v_body, v_body[:, [1, 2, 0]], speed, 10.0 * speed)


def with_values(parameters: Parameters, before, paths, theta) -> Parameters:
    """Return parameters with theta (k,) at k paths of the vehicle file that they were made from, where it has `before`.

    Thrust and torque of each rotor change by the same share, whatever else is wrong with one of them.
    """
    rotors, built = parameters.rotors, dict(parameters.terms)
    for path, was, value in zip(paths, before, theta, strict=True):
        if path in (("thrust_coefficient",), ("torque_coefficient",)):
            rotors = replace(rotors, **{path[0]: getattr(rotors, path[0]) * (value / was)})
        else:
            _, name, key, *index = path
            leaf = jnp.asarray(getattr(built[name], key))
            built[name] = replace(built[name], **{key: leaf.at[tuple(index)].set(value)})
    return replace(parameters, rotors=rotors, terms=built)


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
    """What accelerometer and gyro should have said of some flights, given k coefficients of the vehicle file.

    paths: where they stand in it; before: their values there. Make and call it in double precision.
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
        """Return the standard error (k,) of each coefficient that in a race leaves a useful answer at the worst, and in
        the flights but for their wildest hundredth."""
        effects = []
        for direction in np.eye(len(self._before)):
            force, turn = self._along(self._before, direction)[1]
            effect = np.maximum(np.abs(force) / USEFUL_FORCE, np.abs(turn) / USEFUL_TURN).max(axis=1)
            effects.append(max(effect[:RACE].max(), np.percentile(effect[RACE:], 99)))
        return 1.0 / np.maximum(effects, 1e-300)

    def linearise(self, theta) -> tuple[np.ndarray, np.ndarray]:
        """Return the filtered predictions (N,) of the good samples, by flight and channel, and their slopes in time,
        (2, N) in all, and the derivatives (2, N, k) of both."""
        columns = []
        for direction in np.eye(len(self._before)):
            value, column = self._along(jnp.asarray(theta), direction)
            columns.append(self._rows(*column))
        return self._rows(*value), np.stack(columns, axis=-1)

    def _rows(self, force, turn) -> np.ndarray:
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
    """Return the good rows of (m, channels or more) one channel after the other."""
    return filtered[flight.good, : flight.measured.shape[1]].T.ravel()


def affine_if_so(linearise: Callable, start, step) -> Callable:
    """Return `linearise`, or where it is affine from start (k,) to start + step, as with most terms, its like that
    evaluates nothing any more."""
    predicted, jacobian = linearise(start)
    moved, _ = linearise(start + step)
    if np.abs(moved - predicted - jacobian @ step).max(initial=0.0) > 1e-9 * np.abs(moved).max(initial=0.0):
        return linearise
    return lambda theta: (predicted + jacobian @ (theta - start), jacobian)
