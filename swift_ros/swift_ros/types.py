"""What the cores exchange: plain frozen records of arrays, SI, frames in the names.

Stamps are whole nanoseconds, so that they compare equal after a trip over a topic.
"""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Odometry:
    """A stamped rigid-body state: pose of `base_link` in a world-like frame, twist in the body frame.

    stamp_ns: ns; p_world (3,) m; q_world_body (4,) x y z w; v_body (3,) m/s; omega_body (3,) rad/s;
    covariance_pose (6, 6): position (m^2, world axes) then rotation (rad^2, body axes), or None when unknown.
    """

    stamp_ns: int
    p_world: np.ndarray
    q_world_body: np.ndarray
    v_body: np.ndarray
    omega_body: np.ndarray
    covariance_pose: np.ndarray | None = None


@dataclass(frozen=True)
class GateCorners:
    """One gate seen in an image: corners_px (4, 2) in the order top-left, top-right, bottom-right, bottom-left of the
    gate upright under gravity, as seen; confidence (4,) in 0..1."""

    corners_px: np.ndarray
    confidence: np.ndarray


@dataclass(frozen=True)
class RelativeGatePose:
    """One gate relative to the vehicle at the image's stamp.

    p_body (3,) m and q_body_gate (4,): pose in `base_link`; covariance (3, 3) m^2 of p_body; rays_body (4, 3): unit
    rays to the corners TL, TR, BR, BL; confidence: the smallest of the four;
    reprojection_error: RMS, as a share of the gate's diagonal in pixels; `alternative_*`: IPPE's second pose.
    """

    p_body: np.ndarray
    q_body_gate: np.ndarray
    covariance: np.ndarray
    rays_body: np.ndarray
    confidence: float
    reprojection_error: float
    alternative_p_body: np.ndarray
    alternative_q_body_gate: np.ndarray
    alternative_reprojection_error: float


@dataclass(frozen=True)
class GateUpdate:
    """What the estimator did with one observed gate: gate index in the map (-1: none), innovation (3,) m in map axes,
    Mahalanobis distance (standard deviations), accepted, and the reason it was refused."""

    gate: int
    innovation: np.ndarray
    mahalanobis: float
    accepted: bool
    reason: str


@dataclass(frozen=True)
class BodyRateThrust:
    """A command: stamp_ns of the state that caused it, thrust (m/s^2, mass-normalised), omega_body (3,) rad/s."""

    stamp_ns: int
    thrust: float
    omega_body: np.ndarray = field(default_factory=lambda: np.zeros(3))
