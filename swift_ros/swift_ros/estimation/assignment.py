"""Data association: the gate of the map, and its side, for each observed gate.

All gates look the same, also from behind. The association depends on the pose estimate: the residuals of the observed
rays to the corners of each gate of the map. All gates of one image share one pose error and are therefore associated
jointly. Ambiguous observations are dropped.
"""

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from swift_ros import geometry
from swift_ros.corner_rays import ORDER_FROM_BEHIND, ray_residuals
from swift_ros.types import RelativeGatePose

MAX_COMBINATIONS = 200  # joint hypotheses of one image; with more, no gate is associated, to bound the time
AMBIGUOUS = "two gates of the map match it nearly equally well"
NO_GATE_MATCHES = "no gate of the map is at its position"
TAKEN = "its gate is seen elsewhere in this image"
# m; up to this position uncertainty one linearisation is used. At 3 m from a gate it neglects angles of the order of
# (0.3 / 3)^2 = 0.01 rad. Smaller is more accurate and slower.
MAX_LINEAR_M = 0.3
MAX_ITERATIONS = 3  # linearisations above that uncertainty; each takes as long as the first
REGULARIZATION = 1e-12  # m^2 and rad^2 added to a covariance before its inversion: deviations of 1e-6


@dataclass(frozen=True)
class PoseEstimate:
    """A pose in the map with its covariance.

    Attributes:
        p_map: position (3,), m.
        q_map_body: attitude (4,).
        covariance: (6, 6) of the position (m, map axes) and of the rotation vector from the estimate to the true
            attitude (rad, map axes).
        v_map: velocity (3,), m/s.
    """

    p_map: np.ndarray
    q_map_body: np.ndarray
    covariance: np.ndarray
    v_map: np.ndarray = field(default_factory=lambda: np.zeros(3))


def displaced(pose_estimate: PoseEstimate, step) -> tuple[np.ndarray, np.ndarray]:
    """Return position (..., 3) and rotation (..., 3, 3) of a pose after steps (..., 6): translation and rotation."""
    turn = geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(step[..., 3:]))
    return pose_estimate.p_map + step[..., :3], turn @ geometry.rotation_matrix(pose_estimate.q_map_body)


def squared_distance(pose_estimate: PoseEstimate, step) -> np.ndarray:
    """Return the squared Mahalanobis distance (...) of pose errors (..., 6)."""
    return np.sum(
        step * np.linalg.solve(pose_estimate.covariance + REGULARIZATION * np.eye(6), step[..., None])[..., 0], axis=-1
    )


@dataclass(frozen=True)
class Match:
    """An observed gate and its association.

    Attributes:
        gate: index of the gate in the map, -1 for none.
        corners_map: its corners (4, 3) in the order of the observation, m; None without a gate.
        rays_body: observed rays (4, 3), NaN for a corner that was not seen.
        sigma_rad: standard deviation of the rays, rad.
        mahalanobis: Mahalanobis distance to the nearest gate, standard deviations.
        reason: why no gate was associated, "" otherwise.
    """

    gate: int
    corners_map: np.ndarray | None
    rays_body: np.ndarray
    sigma_rad: float
    mahalanobis: float
    reason: str


class Assignment:
    """Associates observed gates with gates of the map.

    Args:
        corners_map: corners (n, 4, 3) of the map's gates, m, in the order along the passage.
        p_body_camera: optical centre (3,) in the body frame, m.
        gate: largest chi-square of the eight residuals of a whole gate. With fewer corners it is less in proportion,
            and so stricter (94 instead of 98 % with two): they say less about which gate they belong to.
        margin: smallest chi-square difference to any other hypothesis.
    """

    def __init__(self, corners_map, p_body_camera, gate: float, margin: float):
        self._corners = np.concatenate([corners_map, corners_map[:, ORDER_FROM_BEHIND]])
        self._gates = len(corners_map)
        self._p_body_camera = p_body_camera
        self._gate = gate
        self._margin = margin

    def assign(self, rays_body, sigma_rad, pose_estimate: PoseEstimate, taken=frozenset()) -> list[Match]:
        """Return one Match for each observed gate.

        Args:
            rays_body: observed rays (k, 4, 3), NaN for corners that were not seen.
            sigma_rad: their standard deviations (k,), rad.
            pose_estimate: at the stamp of the image.
            taken: gates of the map that other observations of the image show; they are rivals, but never the result.
        """
        if len(rays_body) == 0:
            return []
        residuals, slopes, distance2 = self._compare(rays_body, sigma_rad, pose_estimate)
        # Also hypotheses slightly beyond the limit: a match that is hardly better than one of them is ambiguous.
        limits = self._gate * np.isfinite(rays_body[..., 0]).mean(axis=1)
        candidates = [list(np.flatnonzero(row)) for row in distance2 < limits[:, None] + self._margin]
        chosen = self._choose(candidates, residuals, slopes, sigma_rad, pose_estimate, limits)
        matches = []
        for i, pick in enumerate(chosen):
            is_taken = pick is not None and pick % self._gates in taken
            if pick is None or is_taken or distance2[i, pick] >= limits[i]:
                reason = TAKEN if is_taken else AMBIGUOUS if pick is None and candidates[i] else NO_GATE_MATCHES
                nearest = float(np.sqrt(distance2[i].min()))
                matches.append(Match(-1, None, rays_body[i], sigma_rad[i], nearest, reason))
                continue
            distance = float(np.sqrt(distance2[i, pick]))
            corners = self._corners[pick]
            matches.append(Match(int(pick % self._gates), corners, rays_body[i], sigma_rad[i], distance, ""))
        return matches

    def _compare(self, rays_body, sigma_rad, pose_estimate: PoseEstimate):
        """Compare each observation with each gate from the front, then with each gate from behind.

        With a position uncertainty above MAX_LINEAR_M the residuals are not linear in the pose. Each hypothesis is then
        linearised again at the pose that it implies, and its distance is the sum of those of this pose and of the
        remaining residuals.

        Returns:
            Innovations (k, 2n, 8), derivatives (k, 2n, 8, 6), squared Mahalanobis distances (k, 2n).
        """
        rays_body, sigma_rad = rays_body[:, None], np.asarray(sigma_rad)[:, None]
        noise = sigma_rad[..., None, None] ** 2 * np.eye(8)
        uncertain = np.trace(pose_estimate.covariance[:3, :3]) > MAX_LINEAR_M**2
        step = np.zeros(6)
        for _ in range(MAX_ITERATIONS if uncertain else 1):
            residuals, slopes, ahead = self._residuals(rays_body, pose_estimate, step)
            innovations = residuals + (slopes @ step[..., None])[..., 0]
            weighted = slopes @ pose_estimate.covariance
            scaled = np.linalg.solve(weighted @ np.swapaxes(slopes, -1, -2) + noise, innovations[..., None])
            step = (np.swapaxes(weighted, -1, -2) @ scaled)[..., 0]
        distance2 = np.sum(innovations * scaled[..., 0], axis=-1)
        if uncertain:
            residuals, _, ahead = self._residuals(rays_body, pose_estimate, step)
            distance2 = squared_distance(pose_estimate, step) + np.sum(residuals**2, axis=-1) / sigma_rad**2
        return innovations, slopes, np.where(ahead, distance2, np.inf)

    def _residuals(self, rays_body, pose_estimate: PoseEstimate, step):
        """Return residuals (k, 2n, 8), derivatives (k, 2n, 8, 6) and mask (k, 2n) at the poses displaced by steps.

        Args:
            rays_body: observed rays (k, 1, 4, 3).
            pose_estimate: before the steps.
            step: of all hypotheses (6,), or of each one (k, 2n, 6).
        """
        position, rotation = displaced(pose_estimate, step)
        residuals, slopes, ahead = ray_residuals(rays_body, self._corners, position, rotation, self._p_body_camera)
        return residuals.reshape(*ahead.shape, 8), slopes.reshape(*ahead.shape, 8, 6), ahead

    def _choose(self, candidates, residuals, slopes, sigma_rad, pose_estimate, limits):
        """Return the index of the hypothesis of each observation, None for none."""
        nearest = [row[0] if row else None for row in candidates]
        gates = [pick % self._gates for pick in nearest if pick is not None]
        if all(len(row) <= 1 for row in candidates) and len(set(gates)) == len(gates):
            return nearest
        if np.prod([len(row) + 1.0 for row in candidates]) > MAX_COMBINATIONS:
            return [None] * len(candidates)
        return self._choose_jointly(candidates, residuals, slopes, sigma_rad, pose_estimate, limits)

    def _choose_jointly(self, candidates, residuals, slopes, sigma_rad, pose_estimate, limits):
        """Return the most likely of the combinations with the largest number of matches.

        Observations in which a nearly equally likely combination differs are set to None.
        """
        ranked = []
        for picks in product(*[[*row, None] for row in candidates]):
            gates = [pick % self._gates for pick in picks if pick is not None]
            if not gates or len(set(gates)) < len(gates):
                continue
            distance2, volume = self._joint_cost(picks, residuals, slopes, sigma_rad, pose_estimate)
            limit = sum(limits[i] + self._margin for i, pick in enumerate(picks) if pick is not None)
            if distance2 < limit:
                ranked.append((-len(gates), distance2 + volume, picks))
        if not ranked:
            return [None] * len(candidates)
        ranked.sort(key=lambda entry: entry[:2])
        most, best_cost, best = ranked[0]
        alternatives = [picks for count, cost, picks in ranked[1:] if count == most and cost < best_cost + self._margin]
        return [pick if all(other[i] == pick for other in alternatives) else None for i, pick in enumerate(best)]

    def _joint_cost(self, picks, residuals, slopes, sigma_rad, pose_estimate) -> tuple[float, float]:
        rows = [(i, pick) for i, pick in enumerate(picks) if pick is not None]
        residual = np.concatenate([residuals[i, pick] for i, pick in rows])
        slope = np.concatenate([slopes[i, pick] for i, pick in rows])
        noise = np.repeat([sigma_rad[i] ** 2 for i, _ in rows], 8)
        spread = slope @ pose_estimate.covariance @ slope.T + np.diag(noise)
        return float(residual @ np.linalg.solve(spread, residual)), float(np.linalg.slogdet(spread)[1])


def observed_gate_rotation(corners_map) -> np.ndarray:
    """Return the rotation (3, 3) of a gate, gate to map; its x axis points away from the observer.

    Args:
        corners_map: its corners (4, 3) in the order of the observation.
    """
    left = geometry.normalize(corners_map[0] - corners_map[1])
    up = geometry.normalize(corners_map[0] - corners_map[3])
    return np.array([geometry.cross(left, up), left, up]).T


def to_scale(observation: RelativeGatePose, ratio: float, p_body_camera) -> RelativeGatePose:
    """Return the poses of a gate that is larger than assumed by `ratio`: it is as much further from the camera.

    Args:
        observation: poses of the gate.
        ratio: side of its opening over the assumed one.
        p_body_camera: optical centre (3,) in the body frame, m.
    """
    if ratio == 1.0:
        return observation
    return replace(
        observation,
        p_body=p_body_camera + ratio * (observation.p_body - p_body_camera),
        alternative_p_body=p_body_camera + ratio * (observation.alternative_p_body - p_body_camera),
        covariance=ratio**2 * observation.covariance,
    )


def resolve_ambiguity(observation: RelativeGatePose, match: Match, q_map_body) -> RelativeGatePose:
    """Select from IPPE's two poses of a gate the one whose orientation is nearer to that of the matched gate.

    Args:
        observation: poses of the gate.
        match: its association with a gate.
        q_map_body: attitude (4,) of the vehicle.
    """
    expected = geometry.rotation_matrix(q_map_body).T @ observed_gate_rotation(match.corners_map)
    # The trace of the rotation between two attitudes is the larger, the smaller its angle.
    traces = [
        np.sum(geometry.rotation_matrix(q) * expected)
        for q in (observation.q_body_gate, observation.alternative_q_body_gate)
    ]
    if traces[0] >= traces[1]:
        return observation
    return replace(
        observation,
        p_body=observation.alternative_p_body,
        q_body_gate=observation.alternative_q_body_gate,
        reprojection_error=observation.alternative_reprojection_error,
        alternative_p_body=observation.p_body,
        alternative_q_body_gate=observation.q_body_gate,
        alternative_reprojection_error=observation.reprojection_error,
    )
