"""Which gate of the map each observed gate is, and from which side.

All gates look alike, from behind too: the pose estimate decides, by how well each gate's corners explain the rays. The
gates of one image share one pose error, so that they are told apart together; what stays too close to call is dropped.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from swift_ros import geometry
from swift_ros.corner_rays import ORDER_FROM_BEHIND, ray_residuals
from swift_ros.types import RelativeGatePose

MOST_COMBINATIONS = 200
CLOSE_CALL = "two gates of the map explain it nearly as well"
NO_GATE = "no gate of the map lies there"
LINEAR_M = 0.3
LOOKS = 3
TINY = 1e-12


@dataclass(frozen=True)
class Belief:
    """A pose in the map and how sure it is: p_map (3,) m, q_map_body (4,), covariance (6, 6) of position (m, map axes)
    and of the rotation vector that turns the estimate into the truth (rad, map axes)."""

    p_map: np.ndarray
    q_map_body: np.ndarray
    covariance: np.ndarray


def moved(belief: Belief, step) -> tuple[np.ndarray, np.ndarray]:
    """Return position (..., 3) and rotation (..., 3, 3) of a pose after steps (..., 6): a shift, then a turn."""
    turn = geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(step[..., 3:]))
    return belief.p_map + step[..., :3], turn @ geometry.rotation_matrix(belief.q_map_body)


def cost(belief: Belief, step) -> np.ndarray:
    """Return how unlikely it is (...), in squared standard deviations, that the pose is off by steps (..., 6)."""
    return np.sum(step * np.linalg.solve(belief.covariance + TINY * np.eye(6), step[..., None])[..., 0], axis=-1)


@dataclass(frozen=True)
class Match:
    """An observed gate and what it was taken for: gate index (-1: none) and its corners_map (4, 3) in the order seen;
    rays_body (4, 3) and their sigma_rad; mahalanobis: length of the residuals to the nearest gate in standard
    deviations; reason: why it was taken for none."""

    gate: int
    corners_map: np.ndarray | None
    rays_body: np.ndarray
    sigma_rad: float
    mahalanobis: float
    reason: str


class Assignment:
    """Assigns observed gates to those of the map.

    corners_map (n, 4, 3): the map's gates, order along the passage; p_body_camera (3,); gate: largest chi-square of
    the eight residuals of a gate; margin: by how much a rival must explain the image worse (in the same units).
    """

    def __init__(self, corners_map, p_body_camera, gate: float, margin: float):
        self._corners = np.concatenate([corners_map, corners_map[:, ORDER_FROM_BEHIND]])
        self._gates = len(corners_map)
        self._p_body_camera = p_body_camera
        self._gate = gate
        self._margin = margin

    def assign(self, rays_body, sigma_rad, belief: Belief) -> list[Match]:
        """Return one Match for each observed gate: rays_body (k, 4, 3), sigma_rad (k,) of their corners."""
        if len(rays_body) == 0:
            return []
        residuals, slopes, distance2 = self._compare(rays_body, sigma_rad, belief)
        # A rival may lie a little beyond the gate: what is hardly better than it is no sure thing either.
        candidates = [list(np.flatnonzero(row < self._gate + self._margin)) for row in distance2]
        chosen = self._choose(candidates, residuals, slopes, sigma_rad, belief)
        matches = []
        for i, pick in enumerate(chosen):
            if pick is None or distance2[i, pick] >= self._gate:
                reason = CLOSE_CALL if pick is None and candidates[i] else NO_GATE
                nearest = float(np.sqrt(distance2[i].min()))
                matches.append(Match(-1, None, rays_body[i], sigma_rad[i], nearest, reason))
                continue
            distance = float(np.sqrt(distance2[i, pick]))
            corners = self._corners[pick]
            matches.append(Match(int(pick % self._gates), corners, rays_body[i], sigma_rad[i], distance, ""))
        return matches

    def _compare(self, rays_body, sigma_rad, belief: Belief):
        """Return innovations (k, 2n, 8), slopes (k, 2n, 8, 6) and squared Mahalanobis distances (k, 2n) of each
        observation against each gate from the front, then from behind.

        In doubt about more than LINEAR_M the rays bend with the position: each hypothesis is then looked at again from
        where it would put the vehicle, and its distance is what it costs to be there.
        """
        rays_body, sigma_rad = rays_body[:, None], np.asarray(sigma_rad)[:, None]
        noise = sigma_rad[..., None, None] ** 2 * np.eye(8)
        in_doubt = np.trace(belief.covariance[:3, :3]) > LINEAR_M**2
        step = np.zeros((len(rays_body), 2 * self._gates, 6))
        for _ in range(LOOKS if in_doubt else 1):
            residuals, slopes, ahead = self._residuals(rays_body, belief, step)
            innovations = residuals + (slopes @ step[..., None])[..., 0]
            weighted = slopes @ belief.covariance
            scaled = np.linalg.solve(weighted @ np.swapaxes(slopes, -1, -2) + noise, innovations[..., None])
            step = (np.swapaxes(weighted, -1, -2) @ scaled)[..., 0]
        distance2 = np.sum(innovations * scaled[..., 0], axis=-1)
        if in_doubt:
            residuals, _, ahead = self._residuals(rays_body, belief, step)
            distance2 = cost(belief, step) + np.sum(residuals**2, axis=-1) / sigma_rad**2
        return innovations, slopes, np.where(ahead, distance2, np.inf)

    def _residuals(self, rays_body, belief: Belief, step):
        """Return residuals (k, 2n, 8), slopes (k, 2n, 8, 6) and ahead (k, 2n) from poses moved by step (k, 2n, 6)."""
        position, rotation = moved(belief, step)
        residuals, slopes, ahead = ray_residuals(rays_body, self._corners, position, rotation, self._p_body_camera)
        return residuals.reshape(*step.shape[:2], 8), slopes.reshape(*step.shape[:2], 8, 6), ahead

    def _choose(self, candidates, residuals, slopes, sigma_rad, belief):
        """Return for each observation the index of its hypothesis, or None."""
        alone = [row[0] if row else None for row in candidates]
        gates = [pick % self._gates for pick in alone if pick is not None]
        if all(len(row) <= 1 for row in candidates) and len(set(gates)) == len(gates):
            return alone
        if np.prod([len(row) + 1.0 for row in candidates]) > MOST_COMBINATIONS:
            return [None] * len(candidates)
        return self._choose_together(candidates, residuals, slopes, sigma_rad, belief)

    def _choose_together(self, candidates, residuals, slopes, sigma_rad, belief):
        """Of all combinations that explain most observations, return the likeliest, without the observations in which
        a nearly as likely one differs."""
        ranked = []
        for picks in product(*[[*row, None] for row in candidates]):
            gates = [pick % self._gates for pick in picks if pick is not None]
            if not gates or len(set(gates)) < len(gates):
                continue
            distance2, volume = self._together(picks, residuals, slopes, sigma_rad, belief)
            if distance2 < (self._gate + self._margin) * len(gates):
                ranked.append((-len(gates), distance2 + volume, picks))
        if not ranked:
            return [None] * len(candidates)
        ranked.sort(key=lambda entry: entry[:2])
        most, best_cost, best = ranked[0]
        rivals = [picks for count, cost, picks in ranked[1:] if count == most and cost < best_cost + self._margin]
        return [pick if all(rival[i] == pick for rival in rivals) else None for i, pick in enumerate(best)]

    def _together(self, picks, residuals, slopes, sigma_rad, belief) -> tuple[float, float]:
        rows = [(i, pick) for i, pick in enumerate(picks) if pick is not None]
        residual = np.concatenate([residuals[i, pick] for i, pick in rows])
        slope = np.concatenate([slopes[i, pick] for i, pick in rows])
        noise = np.repeat([sigma_rad[i] ** 2 for i, _ in rows], 8)
        spread = slope @ belief.covariance @ slope.T + np.diag(noise)
        return float(residual @ np.linalg.solve(spread, residual)), float(np.linalg.slogdet(spread)[1])


def gate_attitude_seen(corners_map) -> np.ndarray:
    """Return the attitude (4,) of a gate in the map from its corners (4, 3) in the order seen; x leads away."""
    left = corners_map[0] - corners_map[1]
    up = corners_map[0] - corners_map[3]
    left, up = left / np.linalg.norm(left), up / np.linalg.norm(up)
    return geometry.quaternion_from_matrix(np.stack([np.cross(left, up), left, up], axis=1))


def resolve(sighting: RelativeGatePose, match: Match, q_map_body) -> RelativeGatePose:
    """Return the sighting with that of IPPE's two poses first whose orientation is nearer to the matched gate's, as the
    attitude `q_map_body` sees it; unchanged where nothing was matched."""
    if match.gate < 0:
        return sighting
    q_body_map = geometry.quaternion_conjugate(q_map_body)
    expected = geometry.quaternion_multiply(q_body_map, gate_attitude_seen(match.corners_map))
    if abs(sighting.q_body_gate @ expected) >= abs(sighting.alternative_q_body_gate @ expected):
        return sighting
    return replace(
        sighting,
        p_body=sighting.alternative_p_body,
        q_body_gate=sighting.alternative_q_body_gate,
        reprojection_error=sighting.alternative_reprojection_error,
        alternative_p_body=sighting.p_body,
        alternative_q_body_gate=sighting.q_body_gate,
        alternative_reprojection_error=sighting.reprojection_error,
    )
