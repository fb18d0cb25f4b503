"""Errors of the state estimate in recorded flights with ground truth, as the training of the policy draws them."""

from pathlib import Path

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording.comparison import STATE, TRUTH, read_perception
from swift_ros.types import Odometry
from swift_sim_bridge.pilot.episodes.randomization import EstimateErrors

FLYING_M_S = 1.0  # a slower vehicle stands on its podium, or has crashed
LEAST_S = 2.0  # of flight; less has no correlation time
TICK_S = 0.01  # s, of the correlations
DIGITS = 2  # of the figures, which differ more than this from race to race


def measure(bags: list[Path]) -> EstimateErrors:
    """Return the errors over all flights. Raises UsageError where a bag has no flight with estimate and truth."""
    return statistics([flight_errors(bag) for bag in bags])


def statistics(flights: list[np.ndarray]) -> EstimateErrors:
    """Return deviations and memories of errors (n, 9) every TICK_S, columns as in `randomization.initial_error`."""
    figures = {}
    for name, unit, columns in (
        ("position", "m", slice(0, 3)),
        ("velocity", "m_s", slice(3, 6)),
        ("tilt", "rad", slice(6, 8)),
        ("yaw", "rad", slice(8, 9)),
    ):
        series = [flight[:, columns] for flight in flights]
        deviation = np.sqrt(np.mean(np.concatenate(series) ** 2))
        figures |= {f"{name}_{unit}": _rounded(deviation), f"{name}_s": _rounded(_memory_s(series))}
    return EstimateErrors(**figures)


def flight_errors(bag: Path) -> np.ndarray:
    """Return the errors (n, 9) in flight, for `statistics`. Raises UsageError where there is no flight."""
    odometry = read_perception(bag).odometry
    estimate, truth = odometry[STATE], odometry[TRUTH]
    if len(estimate) < 2 or len(truth) < 2:
        raise UsageError(f"{bag} has no state estimate or no ground truth; give a race that `swiftros race` recorded")
    t_estimate, t_truth = (np.array([one.stamp_ns for one in states]) * 1e-9 for states in (estimate, truth))
    t = np.arange(max(t_estimate[0], t_truth[0]), min(t_estimate[-1], t_truth[-1]), TICK_S)
    p, q, v = _at(estimate, t_estimate, t)
    p_true, q_true, v_true = _at(truth, t_truth, t)
    between = geometry.quaternion_multiply(geometry.quaternion_conjugate(q_true), q)
    turn = geometry.rotation_vector_from_quaternion(between)
    turn_map = geometry.rotate(q_true, turn)
    flying = np.linalg.norm(v_true, axis=1) > FLYING_M_S
    if np.sum(flying) * TICK_S < LEAST_S:
        raise UsageError(f"{bag} has less than {LEAST_S:g} s of flight; give a longer one")
    # The policy observes the velocity in the map. In body axes it has an error of the attitude, too, which cancels.
    velocity_map = geometry.rotate(q, v) - geometry.rotate(q_true, v_true)
    velocity = geometry.rotate_inverse(q_true, velocity_map)
    return np.concatenate([p - p_true, velocity, turn[:, :2], turn_map[:, 2:]], axis=1)[flying]


def _at(states: list[Odometry], times, t):
    """Return position (n, 3), attitude (n, 4) and velocity (n, 3) in the body frame at times t."""
    p, q, v = (np.array([getattr(one, name) for one in states]) for name in ("p_world", "q_world_body", "v_body"))
    q = q * np.cumprod(np.where(np.sum(q * np.roll(q, 1, axis=0), axis=1) < 0, -1, 1))[:, None]  # no change of sign
    position, attitude, velocity = (np.stack([np.interp(t, times, c) for c in one.T], axis=1) for one in (p, q, v))
    return position, geometry.normalize(attitude), velocity


def _memory_s(series: list[np.ndarray]) -> float:
    """Return the time after which the autocorrelation of zero-mean series (n, k) has fallen to exp(-1), s."""
    power = sum(np.sum(one**2) for one in series)
    before = 1.0
    for lag in range(1, min(len(one) for one in series)):
        now = sum(np.sum(one[lag:] * one[:-lag]) * len(one) / (len(one) - lag) for one in series) / power
        if now < np.exp(-1.0):
            return TICK_S * (lag - 1 + (before - np.exp(-1.0)) / (before - now))
        before = now
    return TICK_S * min(len(one) for one in series)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
