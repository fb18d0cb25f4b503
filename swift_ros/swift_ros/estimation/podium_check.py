"""The camera's calibration before take-off: a vehicle at rest on its podium sees gates at known places.

Where no gate of the map matches by the filter's covariance, mounts with exchanged axes or signs are tried. A gate that
is refused is compared again with the errors that a calibration may have. The number of gates that are found is compared
with those in view.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.camera.mounts import other_mounts
from swift_ros.corner_rays import ORDER_FROM_BEHIND, ray_residuals
from swift_ros.estimation.assignment import Assignment, Match, PoseEstimate, displaced
from swift_ros.estimation.calibration_evidence import PRIOR_INFORMATION, lens_slopes
from swift_ros.estimation.missing_gates import MissingGates
from swift_ros.track import Track
from swift_ros.types import Odometry

LEAST_IMAGES = 10  # images with gates of the map by another mount, before this mount is named
# Of the images without any gate of the map. In a wrongly turned image the detector finds more that is no gate, while
# that is where a gate of the map is by another mount in none of some hundred images.
LEAST_SHARE = 0.25


class PodiumCheck:
    """Explains gates that match no gate of the map, and counts the others, until the vehicle first moves.

    Args:
        camera: as assumed.
        track: with the gates of the map.
        assignment: of the estimator.
        max_chi_square: of the eight residuals of a gate.
    """

    def __init__(self, camera: Camera, track: Track, assignment: Assignment, max_chi_square: float):
        self._camera = camera
        self._corners = np.concatenate([track.corners, track.corners[:, ORDER_FROM_BEHIND]])
        self._assignment = assignment
        self._max_chi_square = max_chi_square
        self._mounts = other_mounts(camera)
        self._explained: Counter[str] = Counter()
        self._unexplained = 0
        # A vehicle at rest stays at its first pose, and refused images only widen the uncertainty of later ones.
        self._pose: PoseEstimate | None = None
        self._mount = ""  # what was said about it
        self._missing = MissingGates(camera, track)
        self._finished = False

    def explain(self, odometry: Odometry, pose_estimate: PoseEstimate, matches: list[Match]) -> list[Match]:
        """Return the matches of an image's gates that a wrong calibration explains.

        Args:
            odometry: at the stamp of the image.
            pose_estimate: of the filter.
            matches: of all gates of the image.
        """
        self._finished = self._finished or not odometry.is_at_rest
        if self._finished:
            return []
        self._pose = pose_estimate = self._pose or pose_estimate
        refused = [match for match in matches if match.gate < 0]
        if refused and len(refused) == len(matches):
            self._try_mounts(refused, pose_estimate)
        nearest = [self._nearest(match, pose_estimate) or match for match in refused]
        accepted = [match for match in matches if match.gate >= 0]
        self._missing.count(odometry.stamp_ns, pose_estimate, accepted + nearest)
        return [match for match in nearest if match.gate >= 0]

    def mount_warning(self) -> str:
        """Return a sentence on a mount that explains what the given one does not, "" without one."""
        self._mount = self._mount or self._right_mount()
        return self._mount

    def missing_warning(self) -> str:
        """Return a sentence when too few gates are found while the vehicle is at rest, "" otherwise."""
        return "" if self._finished else self._missing.warning()

    def _right_mount(self) -> str:
        name, count = max(self._explained.items(), key=lambda entry: entry[1], default=("", 0))
        if count < max(LEAST_IMAGES, LEAST_SHARE * self._unexplained):
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


def upright_order(rays_body) -> np.ndarray:
    """Return the rays (4, 3) to the corners of a gate, turned in their order so that the first is the top left one."""
    left, up = rays_body[:, 1], rays_body[:, 2]
    signs_left, signs_up = np.array([1, -1, -1, 1]), np.array([1, 1, -1, -1])
    turned = [np.roll(np.arange(4), -shift) for shift in range(4)]
    return rays_body[max(turned, key=lambda order: float(signs_left @ left[order] + signs_up @ up[order]))]
