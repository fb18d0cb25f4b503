"""Extended Kalman filter on the rays to corners, odometry and accelerometer.

The orientation of an observed gate is less accurate than the attitude of the odometry, whose error limits all filters
on positions: 1 degree at 10 m is 0.17 m. The rays to the corners distinguish this error from that of the position.
`corner_state` describes the state, `corner_motion` its motion between the images.
"""

from dataclasses import replace

import numpy as np

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
from swift_ros.estimation.corner_motion import CornerMotion
from swift_ros.estimation.corner_state import POSE, POSITION, SIZE, CornerState
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.estimation.specific_force import SpecificForce
from swift_ros.timeline import Timeline
from swift_ros.types import Odometry

INCONSISTENT = "no pose near the estimate is consistent with all gates of this image"


class CornerFilter:
    """The filter.

    Args:
        settings: of the estimator.
        camera: the camera.
        timeline: of the odometry in the map, with its first sample; the caller adds the others.
        forces: samples of the accelerometer, which the caller adds.
    """

    def __init__(self, settings: EstimatorSettings, camera: Camera, timeline: Timeline, forces: SpecificForce):
        self._settings = settings
        self._camera = camera
        self._timeline = timeline
        self._motion = CornerMotion(settings, forces)
        assert timeline.newest is not None
        # At the last correction and at the odometry since then of which all samples of the accelerometer are there.
        self._states = [CornerState.begin(settings, timeline.newest)]

    @property
    def evidence(self) -> CalibrationEvidence:
        """What the corners say about the calibration of the camera."""
        return self._states[0].evidence

    @property
    def accelerometer_agrees(self) -> bool:
        """Whether the accelerometer agrees with the odometry, as far as is known."""
        return self._motion.agrees(self._states[-1])

    def pose_estimate(self, odometry: Odometry) -> PoseEstimate:
        """Return the pose in the map at the stamp of `odometry`, which must not be older than the last correction."""
        return _pose_estimate(self._at(odometry))

    def correct(self, odometry: Odometry, matches: list[Match], observations) -> list[str]:
        """Apply all gates of an image in one update.

        Args:
            odometry: at the stamp of the image.
            matches: associated gates with their rays.
            observations: not used by this filter.

        Returns:
            The reason why each match was refused, "" when it was accepted.
        """
        state = self._at(odometry)
        used = [match for match in matches if match.gate >= 0]
        corrected = None
        if used:
            corrected = _update(state, used, self._camera, self._settings.gate_chi_square * len(used))
        later = [] if corrected else [each for each in self._states if each.odometry.stamp_ns > odometry.stamp_ns]
        self._states = [corrected or state, *later]
        return [match.reason or ("" if corrected else INCONSISTENT) for match in matches]

    def observe(self, odometry: Odometry, matches: list[Match]) -> None:
        """Add refused gates to the evidence on the calibration; the state stays as it is.

        Args:
            odometry: at the stamp of the image.
            matches: gates with the association that they have if the calibration is wrong.
        """
        state = self._at(odometry)
        observation, _ = _observation(state, matches, self._camera, np.zeros(SIZE))
        self._states = [replace(state, evidence=state.evidence.observed(observation))]

    def add_position_variance(self, sigma_m: float) -> None:
        """Increase the uncertainty of the position by a standard deviation `sigma_m`, m."""
        if not sigma_m:
            return
        covariance = self._states[0].covariance.copy()
        covariance[POSITION, POSITION] += sigma_m**2 * np.eye(3)
        self._states = [replace(self._states[0], covariance=covariance)]

    def _at(self, odometry: Odometry) -> CornerState:
        """Return the state at the stamp of an odometry, by way of all odometry of the source until then."""
        newest = self._timeline.newest
        assert newest is not None
        before = (each for each in reversed(self._states) if each.odometry.stamp_ns <= odometry.stamp_ns)
        state = next(before, self._states[0])
        for sample in self._timeline.between(state.odometry.stamp_ns, odometry.stamp_ns):
            state = self._motion.advanced(state, sample, newest.stamp_ns)
            self._states.append(state)
        return self._motion.advanced(state, odometry, newest.stamp_ns)


def _pose_estimate(state: CornerState) -> PoseEstimate:
    return PoseEstimate(
        p_map=state.p_map,
        q_map_body=state.q_map_body,
        covariance=state.covariance[POSE, POSE],
        v_map=state.v_map,
    )


def _observation(state: CornerState, matches: list[Match], camera: Camera, step) -> tuple[Observation, np.ndarray]:
    """Return the innovations of the seen corners of matched gates and their derivatives, and their variances (m,).

    Args:
        state: before the update.
        matches: associated gates.
        camera: the camera.
        step: error state (16,) at which the derivatives are computed.
    """
    corners = np.array([match.corners_map for match in matches])
    rays = np.array([match.rays_body for match in matches])
    seen = np.repeat(np.isfinite(rays[..., 0]), 2)
    variances = np.repeat([match.sigma_rad**2 for match in matches], 8)[seen]
    pose = displaced(_pose_estimate(state), step[POSE])
    residuals, pose_slopes, _ = ray_residuals(rays, corners, *pose, camera.p_body_camera)
    slopes = np.zeros((len(variances), SIZE))
    slopes[:, POSE] = pose_slopes.reshape(-1, 6)[seen]
    twist = np.concatenate([state.v_map, pose[1] @ state.odometry.omega_body])
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
        if np.linalg.norm((step - before)[POSITION]) < MAX_LINEAR_M:
            break
    slopes = observation.state_slopes
    if np.linalg.norm(step[POSITION]) > MAX_LINEAR_M:
        here, _ = _observation(state, matches, camera, step)
        residuals = here.innovation - here.state_slopes @ step
        distance2 = squared_distance(_pose_estimate(state), step[POSE])
        if distance2 + np.sum(residuals**2 / variances) > max_chi_square:
            return None
    reduction = np.eye(SIZE) - gain @ slopes
    covariance = reduction @ state.covariance @ reduction.T + (gain * variances) @ gain.T
    return state.corrected(step, covariance=covariance, evidence=state.evidence.observed(observation, gain))
