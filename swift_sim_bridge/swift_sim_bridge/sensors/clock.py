"""Clocks that disagree: what is stamped t shows the truth of t - d(t), with d(t) = delay + drift t."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swift_ros import geometry

LONGEST_S = 0.5


@dataclass(frozen=True)
class Delay:
    """`time_offset` (pose against IMU, 0.001 to 0.03), `vio_latency`, `processing_latency` (0.02 to 0.06 beyond the
    camera file's): s by which what is seen is older than its stamp; negative: younger."""

    delay: float

    def __post_init__(self):
        if not abs(self.delay) <= LONGEST_S:
            raise ValueError(f"'delay' must lie between -{LONGEST_S} and {LONGEST_S} s")


@dataclass(frozen=True)
class Drift:
    """`clock_drift`: parts per million by which the pose's clock runs fast against the IMU's, 10 to 100."""

    ppm: float


class Moving(NamedTuple):
    """A moving body: p_world (..., 3) m, q_world_body (..., 4), v_world (..., 3) m/s, omega_body (..., 3) rad/s."""

    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray


def pose_delay(t, terms: dict):
    """Return the age (...) s of the pose stamped t (...) s after the start, of time_offset and clock_drift."""
    delay = terms["time_offset"].delay if "time_offset" in terms else 0.0
    drift = 1e-6 * terms["clock_drift"].ppm if "clock_drift" in terms else 0.0
    return delay + drift * np.asarray(t)


def _hermite(first, last, first_slope, last_slope, share):
    """Return the cubic between two values with these slopes (a whole interval long) at `share` 0..1 of the way."""
    squared, cubed = share**2, share**3
    weights = (1 - 3 * squared + 2 * cubed, 3 * squared - 2 * cubed, cubed - 2 * squared + share, cubed - squared)
    return weights[0] * first + weights[1] * last + weights[2] * first_slope + weights[3] * last_slope


def moving_at(t, stamps, moving: Moving) -> Moving:
    """Return the body at the times t (m,) s, of n >= 2 known ones at rising `stamps` (n,) s.

    Cubic between two, with a constant twist after the last, at rest in the first pose before it.
    """
    t, stamps = np.asarray(t, dtype=float), np.asarray(stamps)
    k = np.clip(np.searchsorted(stamps, t, side="right") - 1, 0, len(stamps) - 2)
    span = (stamps[k + 1] - stamps[k])[..., None]
    share = np.clip((t - stamps[k])[..., None] / span, 0.0, 1.0)
    first, last = (Moving(*(field[i] for field in moving)) for i in (k, k + 1))
    p_world = _hermite(first.p_world, last.p_world, span * first.v_world, span * last.v_world, share)
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(first.q_world_body), last.q_world_body)
    turn = geometry.rotation_vector_from_quaternion(turn)
    turn = _hermite(np.zeros(3), turn, span * first.omega_body, span * last.omega_body, share)
    q_world_body = geometry.quaternion_multiply(first.q_world_body, geometry.quaternion_from_rotation_vector(turn))
    twist = (a + share * (b - a) for a, b in zip(first[2:], last[2:], strict=True))
    beyond = np.maximum(t - stamps[-1], 0.0)[..., None]
    return coasted(Moving(p_world, q_world_body, *twist), beyond)


def coasted(moving: Moving, dt) -> Moving:
    """Return the body dt (..., 1) s later, its twist unchanged."""
    turn = geometry.quaternion_from_rotation_vector(dt * moving.omega_body)
    q_world_body = geometry.quaternion_multiply(moving.q_world_body, turn)
    return moving._replace(p_world=moving.p_world + dt * moving.v_world, q_world_body=q_world_body)


class History:
    """The last second of a moving body, for sensors that see what is past."""

    def __init__(self):
        self._known: deque[tuple[float, Moving]] = deque()

    def add(self, t: float, moving: Moving) -> None:
        """Keep where the body is at t s, later than before."""
        self._known.append((t, moving))
        while t - self._known[0][0] > 2 * LONGEST_S:
            self._known.popleft()

    def before(self, delay: float) -> Moving:
        """Return the body `delay` s before what was added last; 0 gives that itself."""
        now, newest = self._known[-1]
        if delay == 0:
            return newest
        if delay < 0 or len(self._known) == 1:
            return coasted(newest, np.array([max(-delay, 0.0)]))
        first = next((i for i in range(len(self._known) - 2, 0, -1) if self._known[i][0] <= now - delay), 0)
        stamps, bodies = zip(self._known[first], self._known[first + 1], strict=True)
        return moving_at(now - delay, stamps, Moving(*(np.stack(rows) for rows in zip(*bodies, strict=True))))
