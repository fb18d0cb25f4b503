"""Data types that the cores exchange: frozen records of arrays in SI units, with frames in the names.

Stamps are integer nanoseconds, so that they are equal after a conversion to a ROS message and back.
"""

from dataclasses import dataclass, field

import numpy as np

MAX_REST_SPEED, MAX_REST_RATE = 0.3, 0.3  # m/s and rad/s of a vehicle at rest, with the noise of its odometry


@dataclass(frozen=True)
class Odometry:
    """A rigid-body state: pose of `base_link` in a world frame (map or odom), twist in the body frame.

    Attributes:
        stamp_ns: time, ns.
        p_world: position (3,), m.
        q_world_body: attitude (4,), x y z w.
        v_body: velocity (3,), m/s.
        omega_body: body rates (3,), rad/s.
        covariance_pose: (6, 6) of position (m^2, world axes) and rotation (rad^2, body axes); None when unknown.
    """

    stamp_ns: int
    p_world: np.ndarray
    q_world_body: np.ndarray
    v_body: np.ndarray
    omega_body: np.ndarray
    covariance_pose: np.ndarray | None = None

    @property
    def is_at_rest(self) -> bool:
        """Whether the vehicle stands still."""
        speed, rate = np.linalg.norm(self.v_body), np.linalg.norm(self.omega_body)
        return bool(speed <= MAX_REST_SPEED and rate <= MAX_REST_RATE)


@dataclass(frozen=True)
class ImuSample:
    """A measurement of the IMU, in the body frame.

    Attributes:
        stamp_ns: time, ns.
        omega_body: angular rate (3,), rad/s.
        specific_force_body: (3,), m/s^2.
    """

    stamp_ns: int
    omega_body: np.ndarray
    specific_force_body: np.ndarray


@dataclass(frozen=True)
class GateCorners:
    """One gate detected in an image.

    Attributes:
        corners_px: (4, 2) px: top-left, top-right, bottom-right, bottom-left with gravity pointing down; NaN for a
            corner of an incomplete gate that was not seen.
        confidence: (4,) of each corner, 0 to 1; 0 for a corner that was not seen.
    """

    corners_px: np.ndarray
    confidence: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """The mask (4,) of the corners that were seen."""
        return np.isfinite(self.corners_px).all(axis=1) & (self.confidence > 0.0)

    @property
    def edges_px(self) -> np.ndarray:
        """The edges (n, 2, 2) between neighbouring corners that were both seen, px."""
        edges = np.stack([self.corners_px, np.roll(self.corners_px, -1, axis=0)], axis=1)
        return edges[self.seen & np.roll(self.seen, -1)]


@dataclass(frozen=True)
class RelativeGatePose:
    """One gate relative to the vehicle at the stamp of an image.

    Attributes:
        p_body: position (3,) in `base_link`, m.
        q_body_gate: attitude (4,) in `base_link`.
        covariance: (3, 3) of p_body, m^2.
        rays_body: (4, 3) unit rays to the corners: top-left, top-right, bottom-right, bottom-left.
        confidence: the smallest of the four corners'.
        reprojection_error: RMS, relative to the gate's diagonal in the image.
        alternative_p_body, alternative_q_body_gate, alternative_reprojection_error: second solution of IPPE.
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
class IncompleteGate:
    """Two or three corners of one gate at the stamp of an image.

    Attributes:
        rays_body: (4, 3) unit rays in `base_link`, in the order of `RelativeGatePose`; NaN for a corner not seen.
        confidence: the smallest of the seen corners'.
    """

    rays_body: np.ndarray
    confidence: float


@dataclass(frozen=True)
class GateUpdate:
    """Result of one gate observation in the state estimator.

    Attributes:
        gate: index of the gate in the map, -1 without an association.
        innovation: (3,) of the position, m, map axes; NaN of an incomplete gate.
        mahalanobis: Mahalanobis distance, standard deviations.
        accepted: the observation corrected the state.
        reason: why it was refused, "" when accepted.
    """

    gate: int
    innovation: np.ndarray
    mahalanobis: float
    accepted: bool
    reason: str


@dataclass(frozen=True)
class BodyRateThrust:
    """A command.

    Attributes:
        stamp_ns: stamp of the state from which it was computed, ns.
        thrust: mass-normalised collective thrust, m/s^2.
        omega_body: body rates (3,), rad/s.
    """

    stamp_ns: int
    thrust: float
    omega_body: np.ndarray = field(default_factory=lambda: np.zeros(3))
