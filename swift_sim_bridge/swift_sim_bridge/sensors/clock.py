"""Errors of time stamps: a sample stamped t is the truth of t - d(t), with d(t) = delay + drift t."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swift_ros import geometry

MAX_DELAY_S = 0.5  # s, half of the past motion that `History` keeps


@dataclass(frozen=True)
class Delay:
    """Delay of a sensor: `time_offset` of the pose against the IMU, `vio_latency`, `processing_latency`.

    Attributes:
        delay: s by which a sample is older than its stamp; negative: younger. 0.001 to 0.03 for `time_offset`, 0.02 to
            0.06 for `processing_latency`, in addition to the camera file's.
    """

    delay: float

    def __post_init__(self):
        if not abs(self.delay) <= MAX_DELAY_S:
            raise ValueError(f"'delay' must lie between -{MAX_DELAY_S} and {MAX_DELAY_S} s")


@dataclass(frozen=True)
class Drift:
    """Drift of the pose's clock against the IMU's.

    Attributes:
        ppm: parts per million by which it runs fast, 10 to 100.
    """

    ppm: float


class Moving(NamedTuple):
    """A moving body.

    Attributes:
        p_world: (..., 3) m.
        q_world_body: (..., 4).
        v_world: (..., 3) m/s.
        omega_body: (..., 3) rad/s.
    """

    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray


def pose_delay(t, terms: dict):
    """Return the age (...) s of a pose stamped t (...) s after the start, by `time_offset` and `clock_drift`."""
    delay = terms["time_offset"].delay if "time_offset" in terms else 0.0
    drift = 1e-6 * terms["clock_drift"].ppm if "clock_drift" in terms else 0.0
    return delay + drift * np.asarray(t)


def _hermite(first, last, first_slope, last_slope, share):
    """Return the cubic between two values at `share` 0..1 of the interval; slopes are per interval."""
    squared, cubed = share**2, share**3
    weights = (1 - 3 * squared + 2 * cubed, 3 * squared - 2 * cubed, cubed - 2 * squared + share, cubed - squared)
    return weights[0] * first + weights[1] * last + weights[2] * first_slope + weights[3] * last_slope


def moving_at(t, stamps, moving: Moving) -> Moving:
    """Return the body at other times.

    Cubic interpolation; constant twist after the last time, at rest in the first pose before the first.

    Args:
        t: (m,) s.
        stamps: (n,) s, n >= 2, increasing.
        moving: the body at `stamps`.
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
    """Return the body dt (..., 1) s later at a constant twist."""
    turn = geometry.quaternion_from_rotation_vector(dt * moving.omega_body)
    q_world_body = geometry.quaternion_multiply(moving.q_world_body, turn)
    return moving._replace(p_world=moving.p_world + dt * moving.v_world, q_world_body=q_world_body)


class History:
    """The last second of a moving body, for sensors with a delay."""

    def __init__(self):
        self._known: deque[tuple[float, Moving]] = deque()

    def add(self, t: float, moving: Moving) -> None:
        """Add the body at t s, later than all before."""
        self._known.append((t, moving))
        while t - self._known[0][0] > 2 * MAX_DELAY_S:
            self._known.popleft()

    def before(self, delay: float) -> Moving:
        """Return the body `delay` s before the newest sample; for 0 the newest sample."""
        now, newest = self._known[-1]
        if delay == 0:
            return newest
        if delay < 0 or len(self._known) == 1:
            return coasted(newest, np.array([max(-delay, 0.0)]))
        first = next((i for i in range(len(self._known) - 2, 0, -1) if self._known[i][0] <= now - delay), 0)
        (begin, earlier), (end, later) = self._known[first], self._known[first + 1]
        bodies = Moving(*(np.stack(rows) for rows in zip(earlier, later, strict=True)))
        return moving_at(now - delay, (begin, end), bodies)
