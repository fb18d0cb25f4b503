"""The camera's calibration before take-off: a vehicle at rest on its podium sees gates at known places.

A gate that no gate of the map matches by the filter's covariance is compared again with the errors that a calibration
may have. If even these do not explain it, mounts with exchanged axes or signs are tried.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.corner_rays import ORDER_FROM_BEHIND, ray_residuals
from swift_ros.estimation.assignment import Assignment, Match, PoseEstimate, displaced
from swift_ros.estimation.calibration_evidence import PRIOR_INFORMATION, lens_slopes
from swift_ros.types import Odometry

MAX_SPEED, MAX_RATE = 0.3, 0.3  # m/s and rad/s of a vehicle at rest, with the noise of its odometry
LEAST_IMAGES = 10  # images without any explanation before another mount is named
LEAST_SHARE = 0.8  # of them, that the other mount explains
LEAST_TURN_DEG = 10.0  # between two mounts; a smaller error is one of the calibration's


class PodiumCheck:
    """Explains gates that match no gate of the map, until the vehicle first moves.

    Args:
        camera: as assumed.
        corners_map: corners (n, 4, 3) of the map's gates, m, in the order along the passage.
        assignment: of the estimator.
        max_chi_square: of the eight residuals of a gate.
    """

    def __init__(self, camera: Camera, corners_map, assignment: Assignment, max_chi_square: float):
        self._camera = camera
        self._corners = np.concatenate([corners_map, corners_map[:, ORDER_FROM_BEHIND]])
        self._assignment = assignment
        self._max_chi_square = max_chi_square
        self._mounts = other_mounts(camera)
        self._explained: Counter[str] = Counter()
        self._unexplained = 0
        self._finished = False

    def explain(self, odometry: Odometry, pose_estimate: PoseEstimate, matches: list[Match]) -> list[Match]:
        """Return the matches of an image's gates that a wrong calibration explains.

        Args:
            odometry: at the stamp of the image.
            pose_estimate: of the filter.
            matches: of all gates of the image.
        """
        moves = np.linalg.norm(odometry.v_body) > MAX_SPEED or np.linalg.norm(odometry.omega_body) > MAX_RATE
        self._finished = self._finished or bool(moves)
        refused = [match for match in matches if match.gate < 0]
        if self._finished or not refused:
            return []
        found = [self._nearest(match, pose_estimate) for match in refused]
        found = [match for match in found if match is not None]
        if not found and len(refused) == len(matches):
            self._try_mounts(refused, pose_estimate)
        return found

    def mount_warning(self) -> str:
        """Return a sentence on a mount that explains what the given one does not, "" without one."""
        if self._unexplained < LEAST_IMAGES or not self._explained:
            return ""
        name, count = self._explained.most_common(1)[0]
        if count < LEAST_SHARE * self._unexplained:
            return ""
        return (
            f"no gate of the map is where the camera sees gates in {self._unexplained} images, and with {name} in "
            f"camera.yaml gates are there in {count} of them: correct the mount of the camera"
        )

    def _nearest(self, match: Match, pose_estimate: PoseEstimate) -> Match | None:
        """Return the match with the only gate of the map that a wrong calibration explains, None without one."""
        rays = match.rays_body[None]
        here = displaced(pose_estimate, np.zeros(6))
        residuals, slopes, ahead = ray_residuals(rays, self._corners, *here, self._camera.p_body_camera)
        residuals, slopes = residuals.reshape(-1, 8), slopes.reshape(-1, 8, 6)
        lens = lens_slopes(self._camera, rays)
        noise = match.sigma_rad**2 * np.eye(8) + lens / PRIOR_INFORMATION @ np.swapaxes(lens, -1, -2)
        spread = slopes @ pose_estimate.covariance @ np.swapaxes(slopes, -1, -2) + noise
        distance2 = np.sum(residuals * np.linalg.solve(spread, residuals[..., None])[..., 0], axis=-1)
        distance2 = np.where(ahead, distance2, np.inf)
        nearest = np.flatnonzero(distance2 < self._max_chi_square)
        if len(nearest) != 1:
            return None
        pick = int(nearest[0])
        gates = len(self._corners) // 2
        return replace(match, gate=pick % gates, corners_map=self._corners[pick], reason="")

    def _try_mounts(self, refused: list[Match], pose_estimate: PoseEstimate) -> None:
        self._unexplained += 1
        r_camera_body = geometry.rotation_matrix(self._camera.q_body_camera).T
        sigma = np.array([match.sigma_rad for match in refused])
        for name, camera in self._mounts.items():
            turn = geometry.rotation_matrix(camera.q_body_camera) @ r_camera_body
            rays = np.array([upright_order(match.rays_body @ turn.T) for match in refused])
            matches = self._assignment.assign(rays, sigma, pose_estimate)
            self._explained[name] += any(match.gate >= 0 for match in matches)


def other_mounts(camera: Camera) -> dict[str, Camera]:
    """Return mounts with exchanged axes or signs, by the keys of camera.yaml and their values."""
    pitch, yaw, roll = camera.pitch_deg, camera.yaw_deg, camera.roll_deg
    changes = [{"pitch_deg": -pitch}, {"yaw_deg": -yaw}, {"roll_deg": -roll}]
    changes += [{"roll_deg": (roll + turn + 180.0) % 360.0 - 180.0} for turn in (90.0, 180.0, 270.0)]
    changes += [{"pitch_deg": yaw, "yaw_deg": pitch}, {"pitch_deg": yaw, "yaw_deg": -pitch}]
    changes += [{"pitch_deg": roll, "roll_deg": pitch}, {"pitch_deg": roll, "roll_deg": -pitch}]
    mounts: dict[str, Camera] = {}
    for change in changes:
        other = replace(camera, **change)
        cosines = [abs(other.q_body_camera @ one.q_body_camera) for one in (camera, *mounts.values())]
        if max(cosines) < np.cos(np.radians(LEAST_TURN_DEG / 2)):
            mounts[" and ".join(f"{key} {value + 0.0:g}" for key, value in change.items())] = other
    return mounts


def upright_order(rays_body) -> np.ndarray:
    """Return the rays (4, 3) to the corners of a gate, turned in their order so that the first is the top left one."""
    left, up = rays_body[:, 1], rays_body[:, 2]
    signs_left, signs_up = np.array([1, -1, -1, 1]), np.array([1, 1, -1, -1])
    turned = [np.roll(np.arange(4), -shift) for shift in range(4)]
    return rays_body[max(turned, key=lambda order: float(signs_left @ left[order] + signs_up @ up[order]))]
