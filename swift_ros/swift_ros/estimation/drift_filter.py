"""The paper's filter: Kalman filter on the drift of the odometry (Methods, eqs 12-14), with filterpy.

State, in map axes: position drift (3) m and its rate (3) m/s. The measurement of a gate is the vehicle's position from
IPPE's translation and the odometry's attitude, which is more accurate than IPPE's orientation. Its covariance is that
of the translation plus the effect of the attitude error. Only the translation is corrected; the heading between
odometry and map is averaged over the first seconds and then constant.
"""

import numpy as np
from filterpy.kalman import KalmanFilter

from swift_ros import geometry
from swift_ros.estimation.assignment import Match, PoseEstimate, observed_gate_rotation
from swift_ros.estimation.calibration_evidence import CalibrationEvidence
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry, RelativeGatePose

DRIFT = slice(0, 3)  # rows of the state


class DriftFilter:
    """The filter.

    Args:
        settings: of the estimator.
        first: first odometry, in the map.
    """

    def __init__(self, settings: EstimatorSettings, first: Odometry):
        self._settings = settings
        self._odometry = first
        self._yaw = 0.0
        self._yaw_variance = np.radians(settings.start_yaw_sigma_deg) ** 2
        self._yaw_until_ns = None
        self._filter = KalmanFilter(dim_x=6, dim_z=3)
        self._filter.P = np.diag([settings.start_sigma_m**2] * 3 + [settings.drift_rate_sigma**2] * 3)

    def pose_estimate(self, odometry: Odometry) -> PoseEstimate:
        """Return the pose in the map at the stamp of `odometry`, which must not be older than the last correction."""
        transition, noise, turned = self._process(odometry)
        drift, covariance = self._filter.get_prediction(F=transition, Q=noise)
        return self._pose(odometry, drift[DRIFT, 0] + turned, covariance[DRIFT, DRIFT])

    def correct(self, odometry: Odometry, matches: list[Match], observations: list[RelativeGatePose]) -> list[str]:
        """Apply all gates of an image in one update.

        Args:
            odometry: at the stamp of the image.
            matches: associated gates.
            observations: their poses, with IPPE's ambiguity resolved.

        Returns:
            The reason why each match was refused, "" when it was accepted.
        """
        transition, noise, turned = self._process(odometry)
        self._filter.predict(F=transition, Q=noise)
        self._filter.x[DRIFT, 0] += turned
        self._odometry = odometry
        self._average_yaw(odometry, matches, observations)
        pose_estimate = self._pose(odometry, self._filter.x[DRIFT, 0], self._filter.P[DRIFT, DRIFT])
        reasons = [match.reason for match in matches]
        rows = []
        for i, (match, observation) in enumerate(zip(matches, observations, strict=True)):
            if match.gate < 0:
                continue
            row = _position(match, observation, pose_estimate)
            chi_square = self._chi_square(row, pose_estimate)
            if chi_square > self._settings.drift_chi_square:
                reasons[i] = (
                    f"its position is {np.sqrt(chi_square):.1f} standard deviations off, more than "
                    f"{np.sqrt(self._settings.drift_chi_square):.1f}"
                )
            else:
                rows.append(row)
        if rows:
            self._update(rows, pose_estimate)
        return reasons

    @property
    def evidence(self) -> CalibrationEvidence:
        """None: this filter does not observe corners."""
        return CalibrationEvidence.none(self._filter.dim_x)

    def observe(self, odometry: Odometry, matches: list[Match]) -> None:
        """Take no evidence on the calibration from refused gates."""

    def add_position_variance(self, sigma_m: float) -> None:
        """Increase the uncertainty of the position by a standard deviation `sigma_m`, m."""
        self._filter.P[DRIFT, DRIFT] += sigma_m**2 * np.eye(3)

    def _process(self, odometry: Odometry):
        """Return transition, process noise and drift (3,) by the heading offset since the last correction."""
        dt = max((odometry.stamp_ns - self._odometry.stamp_ns) * 1e-9, 0.0)
        transition = np.eye(6)
        transition[:3, 3:] = dt * np.eye(3)
        sigma, rate_sigma = self._settings.drift_sigma, self._settings.drift_rate_sigma
        noise = np.diag([sigma**2 * dt] * 3 + [rate_sigma**2 * dt] * 3)
        flown = odometry.p_world - self._odometry.p_world
        return transition, noise, geometry.rotate(geometry.quaternion_from_yaw(np.float64(self._yaw)), flown) - flown

    def _pose(self, odometry: Odometry, drift, covariance) -> PoseEstimate:
        heading = geometry.quaternion_from_yaw(np.float64(self._yaw))
        tilt = np.radians(self._settings.vio_tilt_deg)
        full = np.zeros((6, 6))
        full[:3, :3] = covariance
        full[3:, 3:] = np.diag([tilt**2, tilt**2, tilt**2 + self._yaw_variance])
        q_map_body = geometry.normalize(geometry.quaternion_multiply(heading, odometry.q_world_body))
        v_map = geometry.rotate(q_map_body, odometry.v_body)
        return PoseEstimate(odometry.p_world + drift, q_map_body, full, v_map)

    def _chi_square(self, row, pose_estimate: PoseEstimate) -> float:
        innovation, covariance, lever = row
        spread = pose_estimate.covariance[:3, :3] + covariance + lever @ pose_estimate.covariance[3:, 3:] @ lever.T
        return float(innovation @ np.linalg.solve(spread, innovation))

    def _update(self, rows, pose_estimate: PoseEstimate) -> None:
        """Update with all gates at once. R is not block-diagonal, because they share the attitude error."""
        levers = np.concatenate([lever for _, _, lever in rows])
        noise = levers @ pose_estimate.covariance[3:, 3:] @ levers.T
        for i, (_, covariance, _) in enumerate(rows):
            noise[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += covariance
        measured = np.concatenate([innovation for innovation, _, _ in rows])[:, None]
        selection = np.tile(np.eye(3, 6), (len(rows), 1))
        self._filter.update(measured + selection @ self._filter.x, R=noise, H=selection)

    def _average_yaw(self, odometry: Odometry, matches, observations) -> None:
        for match, observation in zip(matches, observations, strict=True):
            if match.gate < 0:
                continue
            if self._yaw_until_ns is None:
                self._yaw_until_ns = odometry.stamp_ns + int(self._settings.drift_yaw_s * 1e9)
            if odometry.stamp_ns > self._yaw_until_ns:
                return
            error = _yaw_error(match, observation, self._pose(odometry, np.zeros(3), np.zeros((3, 3))).q_map_body)
            gain = self._yaw_variance / (self._yaw_variance + np.radians(self._settings.drift_yaw_sigma_deg) ** 2)
            self._yaw += gain * error
            self._yaw_variance *= 1.0 - gain


def _position(match: Match, observation: RelativeGatePose, pose_estimate: PoseEstimate):
    """Return the measurement of the position by one gate, in map axes.

    Returns:
        Innovation (3,) m, covariance (3, 3) m^2, derivative (3, 3) of the position with respect to the attitude (rad).
    """
    assert match.corners_map is not None  # of an associated gate
    rotation = geometry.rotation_matrix(pose_estimate.q_map_body)
    arm = rotation @ observation.p_body
    innovation = match.corners_map.mean(axis=0) - arm - pose_estimate.p_map
    return innovation, rotation @ observation.covariance @ rotation.T, geometry.skew(arm)


def _yaw_error(match: Match, observation: RelativeGatePose, q_map_body) -> float:
    """Return the heading error (rad): that implied by the gate's orientation minus that of `q_map_body`."""
    observed = geometry.quaternion_multiply(q_map_body, observation.q_body_gate)
    expected = geometry.quaternion_from_matrix(observed_gate_rotation(match.corners_map))
    turn = geometry.quaternion_multiply(expected, geometry.quaternion_conjugate(observed))
    return float(geometry.rotation_vector_from_quaternion(turn)[2])
