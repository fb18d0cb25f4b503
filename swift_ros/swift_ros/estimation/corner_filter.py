"""Extended Kalman filter on the rays to corners, with the attitude error of the odometry in its state.

The orientation of an observed gate is less accurate than the attitude of the odometry, whose error limits all filters
on positions: 1 degree at 10 m is 0.17 m. The rays to the corners distinguish this error from the drift.

State, in map axes: drift (3) m, its rate (3) m/s (a Gauss-Markov process), attitude error (3) rad, scale error of the
odometry. Corrected pose: p = p_odometry + drift, q = q_turn * q_odometry. The drift grows with its rate, and with the
flown distance times the heading and scale errors. Its noise grows with the body rate, which blurs the images. The
odometry comes with its position on the path of its velocity (`velocity_path`): rate and scale are errors of both.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.corner_rays import ray_residuals
from swift_ros.estimation.assignment import (
    MAX_ITERATIONS,
    MAX_LINEAR_M,
    Match,
    PoseEstimate,
    displaced,
    squared_distance,
)
from swift_ros.estimation.calibration_evidence import CalibrationEvidence, Observation, calibration_slopes
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry

DRIFT, RATE, TURN, SCALE = slice(0, 3), slice(3, 6), slice(6, 9), 9  # rows of the error state
SIZE = 10  # of the error state
POSE = np.r_[0:3, 6:9]  # rows of drift and turn, the errors of the pose
INCONSISTENT = "no pose near the estimate is consistent with all gates of this image"


@dataclass(frozen=True)
class CornerState:
    """State of the filter at the stamp of `odometry`.

    Attributes:
        odometry: newest odometry.
        drift: position error (3,), m.
        rate: rate of the drift (3,), m/s.
        q_turn: attitude correction (4,).
        scale: scale error.
        covariance: (10, 10).
        evidence: on the calibration of the camera.
    """

    odometry: Odometry
    drift: np.ndarray
    rate: np.ndarray
    q_turn: np.ndarray
    scale: float
    covariance: np.ndarray
    evidence: CalibrationEvidence


class CornerFilter:
    """The filter.

    Args:
        settings: of the estimator.
        camera: the camera.
        first: first odometry, in the map.

    Attributes:
        is_inertial: whether the path of the odometry is that of a velocity which the accelerometer smooths.
    """

    is_inertial = False

    def __init__(self, settings: EstimatorSettings, camera: Camera, first: Odometry):
        self._settings = settings
        self._camera = camera
        self._tilt = np.radians(settings.vio_tilt_deg)
        start_turn = np.array([self._tilt, self._tilt, np.radians(settings.start_yaw_sigma_deg)])
        sigmas = np.concatenate([np.full(3, settings.start_sigma_m), np.zeros(3), start_turn, [settings.vio_scale]])
        self._state = CornerState(
            odometry=first,
            drift=np.zeros(3),
            rate=np.zeros(3),
            q_turn=np.array([0.0, 0.0, 0.0, 1.0]),
            scale=0.0,
            covariance=np.diag(sigmas**2),
            evidence=CalibrationEvidence.none(SIZE),
        )

    @property
    def evidence(self) -> CalibrationEvidence:
        """What the corners say about the calibration of the camera."""
        return self._state.evidence

    def pose_estimate(self, odometry: Odometry) -> PoseEstimate:
        """Return the pose in the map at the stamp of `odometry`, which must not be older than the last correction."""
        return _pose_estimate(self._predict(odometry))

    def correct(self, odometry: Odometry, matches: list[Match], observations) -> list[str]:
        """Apply all gates of an image in one update.

        Args:
            odometry: at the stamp of the image.
            matches: associated gates with their rays.
            observations: not used by this filter.

        Returns:
            The reason why each match was refused, "" when it was accepted.
        """
        state = self._predict(odometry)
        used = [match for match in matches if match.gate >= 0]
        corrected = None
        if used:
            corrected = _update(state, used, self._camera, self._settings.gate_chi_square * len(used))
        self._state = corrected or state
        return [match.reason or ("" if corrected else INCONSISTENT) for match in matches]

    def observe(self, odometry: Odometry, matches: list[Match]) -> None:
        """Add refused gates to the evidence on the calibration; the state stays as it is.

        Args:
            odometry: at the stamp of the image.
            matches: gates with the association that they have if the calibration is wrong.
        """
        state = self._predict(odometry)
        observation, _ = _observation(state, matches, self._camera, np.zeros(SIZE))
        self._state = replace(state, evidence=state.evidence.observed(observation))

    def add_position_variance(self, sigma_m: float) -> None:
        """Increase the uncertainty of the position by a standard deviation `sigma_m`, m."""
        covariance = self._state.covariance.copy()
        covariance[DRIFT, DRIFT] += sigma_m**2 * np.eye(3)
        self._state = replace(self._state, covariance=covariance)

    def _predict(self, odometry: Odometry) -> CornerState:
        before = self._state
        dt = (odometry.stamp_ns - before.odometry.stamp_ns) * 1e-9
        if dt <= 0:
            return before
        s = self._settings
        flown = odometry.p_world - before.odometry.p_world
        walk, share, memory_s = s.vio_walk, s.vio_rate_share, s.vio_rate_memory_s
        if self.is_inertial:
            walk, share, memory_s = s.imu_walk, s.imu_rate_share, s.imu_rate_memory_s
        keep_rate, keep_tilt = np.exp(-dt / memory_s), np.exp(-dt / s.vio_tilt_memory_s)
        rate_time = memory_s * (1.0 - keep_rate)
        turn = geometry.rotation_vector_from_quaternion(before.q_turn)
        heading = geometry.quaternion_from_yaw(turn[2])
        turned = geometry.rotate(heading, flown)

        transition = np.eye(SIZE)
        transition[DRIFT, RATE] = rate_time * np.eye(3)
        transition[0:3, 8] = [-turned[1], turned[0], 0.0]
        transition[DRIFT, SCALE] = flown
        transition[RATE, RATE] *= keep_rate
        transition[6, 6] = transition[7, 7] = keep_tilt

        path = float(np.linalg.norm(flown))
        noise = np.zeros(SIZE)
        growth = 1.0 + float(np.linalg.norm(odometry.omega_body)) / s.vio_rotation_ref
        noise[DRIFT] = walk**2 * path * growth + s.vio_still_walk**2 * dt
        noise[RATE] = (share * path / dt) ** 2 * growth * (1.0 - keep_rate**2)
        noise[6:8] = self._tilt**2 * (1.0 - keep_tilt**2)
        noise[8] = np.radians(s.vio_yaw_walk_deg) ** 2 * dt
        return CornerState(
            odometry=odometry,
            drift=before.drift + rate_time * before.rate + turned - flown + before.scale * flown,
            rate=keep_rate * before.rate,
            q_turn=geometry.quaternion_from_rotation_vector(turn * np.array([keep_tilt, keep_tilt, 1.0])),
            scale=before.scale,
            covariance=transition @ before.covariance @ transition.T + np.diag(noise),
            evidence=before.evidence.predicted(transition),
        )


def _pose_estimate(state: CornerState) -> PoseEstimate:
    q_map_body = geometry.normalize(geometry.quaternion_multiply(state.q_turn, state.odometry.q_world_body))
    return PoseEstimate(
        p_map=state.odometry.p_world + state.drift,
        q_map_body=q_map_body,
        covariance=state.covariance[np.ix_(POSE, POSE)],
        drift_rate_map=state.rate + state.scale * geometry.rotate(q_map_body, state.odometry.v_body),
    )


def _observation(state: CornerState, matches: list[Match], camera: Camera, step) -> tuple[Observation, np.ndarray]:
    """Return the innovations of the seen corners of matched gates and their derivatives, and their variances (m,).

    Args:
        state: before the update.
        matches: associated gates.
        camera: the camera.
        step: error state (10,) at which the derivatives are computed.
    """
    corners = np.array([match.corners_map for match in matches])
    rays = np.array([match.rays_body for match in matches])
    seen = np.repeat(np.isfinite(rays[..., 0]), 2)
    variances = np.repeat([match.sigma_rad**2 for match in matches], 8)[seen]
    pose = displaced(_pose_estimate(state), step[POSE])
    residuals, pose_slopes, _ = ray_residuals(rays, corners, *pose, camera.p_body_camera)
    slopes = np.zeros((len(variances), SIZE))
    slopes[:, POSE] = pose_slopes.reshape(-1, 6)[seen]
    twist = np.concatenate([pose[1] @ state.odometry.v_body, pose[1] @ state.odometry.omega_body])
    observation = Observation(
        innovation=residuals.ravel()[seen] + slopes @ step,
        covariance=slopes @ state.covariance @ slopes.T + np.diag(variances),
        state_slopes=slopes,
        calibration_slopes=calibration_slopes(camera, rays, corners, pose_slopes, twist).reshape(len(seen), -1)[seen],
    )
    return observation, variances


def _update(state: CornerState, matches: list[Match], camera: Camera, max_chi_square: float) -> CornerState | None:
    """Return the state after an update with all corners of all matched gates (Joseph form).

    A large step is linearised again at its end. Returns None if the gates are then not consistent.

    Args:
        state: before the update.
        matches: associated gates.
        camera: the camera.
        max_chi_square: largest chi-square of a large step and the residuals after it.
    """
    step = np.zeros(SIZE)
    observation, variances = _observation(state, matches, camera, step)
    gain = np.zeros((SIZE, 0))
    for i in range(MAX_ITERATIONS):
        if i:
            observation, _ = _observation(state, matches, camera, step)
        gain = np.linalg.solve(observation.covariance, observation.state_slopes @ state.covariance).T
        before, step = step, gain @ observation.innovation
        if np.linalg.norm((step - before)[DRIFT]) < MAX_LINEAR_M:
            break
    slopes = observation.state_slopes
    if np.linalg.norm(step[DRIFT]) > MAX_LINEAR_M:
        here, _ = _observation(state, matches, camera, step)
        residuals = here.innovation - here.state_slopes @ step
        distance2 = squared_distance(_pose_estimate(state), step[POSE])
        if distance2 + np.sum(residuals**2 / variances) > max_chi_square:
            return None
    reduction = np.eye(SIZE) - gain @ slopes
    return replace(
        state,
        drift=state.drift + step[DRIFT],
        rate=state.rate + step[RATE],
        q_turn=geometry.quaternion_multiply(geometry.quaternion_from_rotation_vector(step[TURN]), state.q_turn),
        scale=state.scale + float(step[SCALE]),
        covariance=reduction @ state.covariance @ reduction.T + (gain * variances) @ gain.T,
        evidence=state.evidence.observed(observation, gain),
    )
