"""The paper's filter: a Kalman filter on the odometry's drift (Methods, eqs 12-14), on filterpy.

State: position drift (3) m and its rate (3) m/s, map axes. A gate's measurement is the position that its IPPE
translation implies with the odometry's attitude (IPPE's own orientation is never better); its covariance is the one
sent with it plus what the attitude error makes of the distance. Only translation is corrected; the heading between
odometry and map is averaged over the first seconds and then held.
"""

import numpy as np
from filterpy.kalman import KalmanFilter

from swift_ros import geometry
from swift_ros.estimation.assignment import Belief, Match, gate_attitude_seen
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry, RelativeGatePose

DRIFT = slice(0, 3)


class DriftFilter:
    def __init__(self, settings: EstimatorSettings, first: Odometry):
        self._settings = settings
        self._odometry = first
        self._yaw = 0.0
        self._yaw_variance = np.radians(settings.start_yaw_sigma_deg) ** 2
        self._yaw_until_ns = None
        self._filter = KalmanFilter(dim_x=6, dim_z=3)
        self._filter.P = np.diag([settings.start_sigma_m**2] * 3 + [settings.drift_rate_sigma**2] * 3)

    def belief(self, odometry: Odometry) -> Belief:
        """Return the pose in the map at the stamp of `odometry`, not older than the last correction."""
        transition, noise, turned = self._process(odometry)
        drift, covariance = self._filter.get_prediction(F=transition, Q=noise)
        return self._pose(odometry, drift[DRIFT, 0] + turned, covariance[DRIFT, DRIFT])

    def correct(self, odometry: Odometry, matches: list[Match], sightings: list[RelativeGatePose]) -> list[str]:
        """Apply the gates of an image taken at the stamp of `odometry`, all in one update: `sightings` with IPPE's pose
        resolved. Returns for each match why it did not count, empty when it did."""
        transition, noise, turned = self._process(odometry)
        self._filter.predict(F=transition, Q=noise)
        self._filter.x[DRIFT, 0] += turned
        self._odometry = odometry
        self._average_yaw(odometry, matches, sightings)
        belief = self._pose(odometry, self._filter.x[DRIFT, 0], self._filter.P[DRIFT, DRIFT])
        reasons = [match.reason for match in matches]
        rows = []
        for i, (match, sighting) in enumerate(zip(matches, sightings, strict=True)):
            if match.gate < 0:
                continue
            row = _position(match, sighting, belief)
            chi_square = self._chi_square(row, belief)
            if chi_square > self._settings.drift_chi_square:
                reasons[i] = (
                    f"its position is {np.sqrt(chi_square):.1f} standard deviations off, at most "
                    f"{np.sqrt(self._settings.drift_chi_square):.1f} are believed"
                )
            else:
                rows.append(row)
        if rows:
            self._update(rows, belief)
        return reasons

    def widen(self, sigma_m: float) -> None:
        """Doubt the position by `sigma_m` more."""
        self._filter.P[DRIFT, DRIFT] += sigma_m**2 * np.eye(3)

    def _process(self, odometry: Odometry):
        """Return (F, Q, what the heading's offset adds to the drift (3,)) from the last correction to `odometry`."""
        dt = max((odometry.stamp_ns - self._odometry.stamp_ns) * 1e-9, 0.0)
        transition = np.eye(6)
        transition[:3, 3:] = dt * np.eye(3)
        sigma, rate_sigma = self._settings.drift_sigma, self._settings.drift_rate_sigma
        noise = np.diag([sigma**2 * dt] * 3 + [rate_sigma**2 * dt] * 3)
        flown = odometry.p_world - self._odometry.p_world
        return transition, noise, geometry.rotate(geometry.quaternion_from_yaw(np.float64(self._yaw)), flown) - flown

    def _pose(self, odometry: Odometry, drift, covariance) -> Belief:
        heading = geometry.quaternion_from_yaw(np.float64(self._yaw))
        tilt = np.radians(self._settings.vio_tilt_deg)
        full = np.zeros((6, 6))
        full[:3, :3] = covariance
        full[3:, 3:] = np.diag([tilt**2, tilt**2, tilt**2 + self._yaw_variance])
        q_map_body = geometry.normalize(geometry.quaternion_multiply(heading, odometry.q_world_body))
        return Belief(odometry.p_world + drift, q_map_body, full)

    def _chi_square(self, row, belief: Belief) -> float:
        innovation, covariance, lever = row
        spread = belief.covariance[:3, :3] + covariance + lever @ belief.covariance[3:, 3:] @ lever.T
        return float(innovation @ np.linalg.solve(spread, innovation))

    def _update(self, rows, belief: Belief) -> None:
        """Stack all gates: their errors share the one error of the attitude, which is why R is not block-diagonal."""
        levers = np.concatenate([lever for _, _, lever in rows])
        noise = levers @ belief.covariance[3:, 3:] @ levers.T
        for i, (_, covariance, _) in enumerate(rows):
            noise[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += covariance
        measured = np.concatenate([innovation for innovation, _, _ in rows])[:, None]
        selection = np.tile(np.eye(3, 6), (len(rows), 1))
        self._filter.update(measured + selection @ self._filter.x, R=noise, H=selection)

    def _average_yaw(self, odometry: Odometry, matches, sightings) -> None:
        for match, sighting in zip(matches, sightings, strict=True):
            if match.gate < 0:
                continue
            if self._yaw_until_ns is None:
                self._yaw_until_ns = odometry.stamp_ns + int(self._settings.drift_yaw_s * 1e9)
            if odometry.stamp_ns > self._yaw_until_ns:
                return
            error = _yaw_error(match, sighting, self._pose(odometry, np.zeros(3), np.zeros((3, 3))).q_map_body)
            gain = self._yaw_variance / (self._yaw_variance + np.radians(self._settings.drift_yaw_sigma_deg) ** 2)
            self._yaw += gain * error
            self._yaw_variance *= 1.0 - gain


def _position(match: Match, sighting: RelativeGatePose, belief: Belief):
    """Return (innovation (3,) m, covariance (3, 3) m^2, lever (3, 3)) of the position a gate implies, map axes; the
    lever is how the position moves with a turn of the estimate (rad)."""
    rotation = geometry.rotation_matrix(belief.q_map_body)
    arm = rotation @ sighting.p_body
    innovation = match.corners_map.mean(axis=0) - arm - belief.p_map
    return innovation, rotation @ sighting.covariance @ rotation.T, geometry.skew(arm)


def _yaw_error(match: Match, sighting: RelativeGatePose, q_map_body) -> float:
    """Return by how much (rad) the heading `q_map_body` lags behind the one that the gate's orientation implies."""
    seen = geometry.quaternion_multiply(q_map_body, sighting.q_body_gate)
    wanted = gate_attitude_seen(match.corners_map)
    turn = geometry.quaternion_multiply(wanted, geometry.quaternion_conjugate(seen))
    return float(geometry.rotation_vector_from_quaternion(turn)[2])
