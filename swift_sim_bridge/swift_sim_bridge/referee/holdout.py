"""Evaluation of vehicle files by rollouts with the referee's simulator.

From the true state at the start of each window, the nominal, the repaired and the true vehicle fly the recorded motor
commands. The error of the true vehicle comes from process noise and cannot be removed. A repair is evaluated on a
flight that the tool has not seen. Whether what a case conceals acts at all is seen in the flight that the tool gets.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.referee.simulator.flight import LOOP_S, STEP_S, STEPS, Truth, in_parts, rk4
from swift_sim_bridge.referee.simulator.plant import Inputs, State, plant_of
from swift_sim_bridge.referee.simulator.polynomial import summands_of
from swift_sim_bridge.referee.simulator.vectors import parts

WINDOW_S = 0.5  # duration of a rollout
SHORT_WINDOW_S = 0.1  # likewise, to see whether something acts: there are many, with little process noise in each
FIRST_S = 2.0  # start of the first window: after the vehicle has gathered speed
MIN_ERROR_RATIO = 1.1  # nominal error relative to the true vehicle's, below which there is nothing to remove
MIN_ERROR = 1e-6  # m and rad, added to that bound, and m/s and rad/s of process noise, against rounding errors


def rollout_errors(truth: Truth, contents: Sequence[dict]) -> np.ndarray:
    """Return the root mean square errors (2, v) after WINDOW_S for the contents of v vehicle files.

    The first row has those of the position in m, the second those of the attitude in rad.
    """
    ends, end = _rollouts(truth, contents, WINDOW_S)
    errors = end.p - truth.p[ends].T[:, None]
    cosine = np.abs(np.sum(end.q * truth.q[ends].T[:, None], axis=0)) / np.linalg.norm(end.q, axis=0)
    turned = 2.0 * np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.sqrt(np.mean([np.sum(errors**2, axis=0), turned**2], axis=2))


def significance(truth: Truth, nominal: dict, true: dict) -> float:
    """Return by how many standard deviations of the process noise what a flight's vehicle hides acts in the flight.

    Its share of velocities and body rates after short windows is known here; no tool can see it more clearly.

    Args:
        truth: flight of the true vehicle.
        nominal: content of the vehicle file that the tool gets.
        true: content of the true vehicle file.
    """
    ends, end = _rollouts(truth, (nominal, true), SHORT_WINDOW_S)
    reached = np.concatenate([end.v, end.w])
    hidden = reached[:, 1] - reached[:, 0]
    noise = np.concatenate([truth.v[ends].T, truth.w[ends].T]) - reached[:, 1]
    covariance = noise @ noise.T / len(ends) + MIN_ERROR**2 * np.eye(len(noise))
    return float(np.sqrt(np.sum(hidden * np.linalg.solve(covariance, hidden))))


def removed_share(truth: Truth, nominal: dict, repaired: dict, true: dict) -> float | None:
    """Return the share of the removable error that a repair removes, None if there is hardly any.

    The error is that of position or attitude, of which the nominal vehicle's is the larger multiple of the true one's.

    Args:
        truth: flight of the true vehicle.
        nominal: content of the vehicle file that the tool had.
        repaired: content of the repaired vehicle file.
        true: content of the true vehicle file.
    """
    errors = rollout_errors(truth, (nominal, repaired, true))
    before, after, least = max(errors, key=lambda row: row[0] / (row[2] + MIN_ERROR))
    return None if before < MIN_ERROR_RATIO * least + MIN_ERROR else float((before - after) / (before - least))


def _rollouts(truth: Truth, contents: Sequence[dict], seconds: float) -> tuple[np.ndarray, State]:
    """Return the passes (w,) at which w windows of a flight end, and the states (k, v, w) of v vehicles there.

    Args:
        truth: the flight.
        contents: contents of the vehicle files.
        seconds: duration of each window.
    """
    passes = round(seconds / LOOP_S)
    begins = np.arange(round(FIRST_S / LOOP_S), len(truth.t) - passes, passes)
    with jax.enable_x64(True):
        summands = summands_of(contents)
        built = [plant_of(content, summands, contents) for content in contents]
        plant = jax.tree.map(lambda *rows: np.repeat(np.stack(rows, axis=-1), len(begins), axis=-1), *built)
        start = State(*(_tiled(getattr(truth, name)[begins], len(contents)) for name in State._fields))
        if not plant["blind"]:  # a memory of laws that act in another flight of the group
            start = start._replace(memory=start.memory[:0])
        commands = np.stack([truth.u[i : i + passes] for i in begins], axis=-1)
        commands = np.concatenate([commands] * len(contents), axis=-1)
        end = _rolled(start, commands, plant)
        return begins + passes, State(*(np.asarray(one).reshape(-1, len(contents), len(begins)) for one in end))


def _tiled(values, count: int):
    """Return values (n, ...) repeated for each vehicle along a last axis."""
    return np.concatenate([values.T] * count, axis=-1)


@jax.jit
def _rolled(start: State, commands, plant) -> State:
    """Return the states (k, b) at the ends of b windows, with commands (passes, rotors, b)."""
    state = in_parts(start)
    nothing = (0.0, 0.0, 0.0)

    def step(state, u):
        held = Inputs(parts(u), nothing, nothing, nothing, (0.0,) * len(u))
        return jax.lax.fori_loop(0, STEPS, lambda _, at: rk4(at, held, plant, STEP_S), state), None

    return State(*(jnp.asarray(one) for one in jax.lax.scan(step, state, commands)[0]))
