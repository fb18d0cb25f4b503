"""What the estimator refuses to take in: values that no vehicle reaches or that are no numbers, and old odometry."""

from collections.abc import Sequence

import numpy as np

from swift_ros.types import IncompleteGate, Odometry, RelativeGatePose

MAX_VALUE = 1e6  # m, m/s and rad/s: no vehicle reaches them, and sums and squares keep their precision


def odometry_refusal(odometry: Odometry, newest: Odometry | None) -> str:
    """Return why odometry that follows the newest one is refused, "" when it is taken in."""
    if newest is not None and odometry.stamp_ns <= newest.stamp_ns:
        return f"odometry with stamp {odometry.stamp_ns} ns follows stamp {newest.stamp_ns} ns; it was refused"
    values = np.concatenate([odometry.p_world, odometry.q_world_body, odometry.v_body, odometry.omega_body])
    if not _is_usable(values):
        return f"odometry with stamp {odometry.stamp_ns} ns has a value that is absurd or not a number; it was refused"
    return ""


def gates_refusal(stamp_ns: int, observations: Sequence[RelativeGatePose], incomplete: Sequence[IncompleteGate]) -> str:
    """Return why the gates of the image with a stamp (ns) are refused, "" when they are taken in."""
    usable = all(_is_usable(gate.rays_body) and _is_usable(gate.covariance) for gate in observations)
    usable &= all(_is_usable(gate.confidence) for gate in [*observations, *incomplete])
    if usable and all(_has_seen_corners(gate.rays_body) for gate in incomplete):
        return ""
    return f"gates with stamp {stamp_ns} ns hold a value that is absurd or not a number; they were refused"


def _is_usable(values) -> bool:
    return bool(np.all(np.abs(values) <= MAX_VALUE))  # false for NaN


def _has_seen_corners(rays_body) -> bool:
    """Return whether two or three of the rays (4, 3) are those of seen corners, and the others not a number."""
    seen = np.isfinite(rays_body).all(axis=1)
    return bool(2 <= seen.sum() <= 3 and _is_usable(rays_body[seen]) and np.isnan(rays_body[~seen]).all())
