"""The better filter: an extended Kalman filter on the corner rays themselves, with the odometry's attitude error in it.

A gate's own orientation is never better than the odometry's, and the odometry's is what limits every filter on
positions: 1 degree at 10 m is 0.17 m. Seen through the corners, that error can be told apart from the drift.

State, all in map axes: drift (3) m, its rate (3) m/s (a Gauss-Markov process), turn (3) rad, scale of the odometry.
Corrected pose: p = p_odometry + drift, q = turn * q_odometry. The drift grows by its rate and because odometry that is
turned about the vertical, or scaled, also puts every metre flown there.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros import geometry
from swift_ros.corner_rays import ray_residuals
from swift_ros.estimation.assignment import LINEAR_M, LOOKS, Belief, Match, cost, moved
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry

DRIFT, RATE, TURN, SCALE = slice(0, 3), slice(3, 6), slice(6, 9), 9
SIZE = 10
POSE = np.r_[0:3, 6:9]
TOO_FAR = "no pose near the estimate explains the gates of this image together"


@dataclass(frozen=True)
class CornerState:
    """The filter at the stamp of `odometry`: drift (3,) m, rate (3,) m/s, q_turn (4,), scale, covariance (10, 10)."""

    odometry: Odometry
    drift: np.ndarray
    rate: np.ndarray
    q_turn: np.ndarray
    scale: float
    covariance: np.ndarray


class CornerFilter:
    def __init__(self, settings: EstimatorSettings, p_body_camera, first: Odometry):
        self._settings = settings
        self._p_body_camera = p_body_camera
        self._tilt = np.radians(settings.vio_tilt_deg)
        start_turn = np.array([self._tilt, self._tilt, np.radians(settings.start_yaw_sigma_deg)])
        sigmas = np.concatenate([np.full(3, settings.start_sigma_m), np.zeros(3), start_turn, [settings.vio_scale]])
        self._state = CornerState(
            first, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 0.0, np.diag(sigmas**2)
        )

    def belief(self, odometry: Odometry) -> Belief:
        """Return the pose in the map at the stamp of `odometry`, not older than the last correction."""
        return _belief(self._predict(odometry))

    def correct(self, odometry: Odometry, matches: list[Match], sightings) -> list[str]:
        """Apply the gates of an image taken at the stamp of `odometry`, all in one update. The rays are in the matches;
        `sightings` are not needed. Returns for each match why it did not count, empty when it did."""
        state = self._predict(odometry)
        used = [match for match in matches if match.gate >= 0]
        corrected = None
        if used:
            corrected = _update(state, used, self._p_body_camera, self._settings.gate_chi_square * len(used))
        self._state = corrected or state
        return [match.reason or ("" if corrected else TOO_FAR) for match in matches]

    def widen(self, sigma_m: float) -> None:
        """Doubt the position by `sigma_m` more."""
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
        keep_rate, keep_tilt = np.exp(-dt / s.vio_rate_memory_s), np.exp(-dt / s.vio_tilt_memory_s)
        rate_time = s.vio_rate_memory_s * (1.0 - keep_rate)
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
        noise[DRIFT] = s.vio_walk**2 * path + s.vio_still_walk**2 * dt
        noise[RATE] = (s.vio_rate_share * path / dt) ** 2 * (1.0 - keep_rate**2)
        noise[6:8] = self._tilt**2 * (1.0 - keep_tilt**2)
        noise[8] = np.radians(s.vio_yaw_walk_deg) ** 2 * dt
        return CornerState(
            odometry=odometry,
            drift=before.drift + rate_time * before.rate + turned - flown + before.scale * flown,
            rate=keep_rate * before.rate,
            q_turn=geometry.quaternion_from_rotation_vector(turn * np.array([keep_tilt, keep_tilt, 1.0])),
            scale=before.scale,
            covariance=transition @ before.covariance @ transition.T + np.diag(noise),
        )


def _belief(state: CornerState) -> Belief:
    return Belief(
        p_map=state.odometry.p_world + state.drift,
        q_map_body=geometry.normalize(geometry.quaternion_multiply(state.q_turn, state.odometry.q_world_body)),
        covariance=state.covariance[np.ix_(POSE, POSE)],
    )


def _update(state: CornerState, matches: list[Match], p_body_camera, largest: float) -> CornerState | None:
    """Return the state after all corners of all matched gates (Joseph's form), linearised again where it moved far;
    None when from there the gates are farther off than `largest`, in squared standard deviations."""
    corners = np.array([match.corners_map for match in matches])
    rays = np.array([match.rays_body for match in matches])
    variances = np.repeat([match.sigma_rad**2 for match in matches], 8)
    belief, step = _belief(state), np.zeros(SIZE)
    for _ in range(LOOKS):
        residuals, slopes, _ = ray_residuals(rays, corners, *moved(belief, step[POSE]), p_body_camera)
        slope = np.zeros((8 * len(matches), SIZE))
        slope[:, POSE] = slopes.reshape(-1, 6)
        gain = np.linalg.solve(slope @ state.covariance @ slope.T + np.diag(variances), slope @ state.covariance).T
        before, step = step, gain @ (residuals.ravel() + slope @ step)
        if np.linalg.norm((step - before)[DRIFT]) < LINEAR_M:
            break
    if np.linalg.norm(step[DRIFT]) > LINEAR_M:
        residuals, _, _ = ray_residuals(rays, corners, *moved(belief, step[POSE]), p_body_camera)
        if cost(belief, step[POSE]) + np.sum(residuals.ravel() ** 2 / variances) > largest:
            return None
    rest = np.eye(SIZE) - gain @ slope
    return replace(
        state,
        drift=state.drift + step[DRIFT],
        rate=state.rate + step[RATE],
        q_turn=geometry.quaternion_multiply(geometry.quaternion_from_rotation_vector(step[TURN]), state.q_turn),
        scale=state.scale + float(step[SCALE]),
        covariance=rest @ state.covariance @ rest.T + (gain * variances) @ gain.T,
    )
