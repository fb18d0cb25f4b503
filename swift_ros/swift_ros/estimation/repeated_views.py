"""What images of an unchanged view add: a part of a corner's error is the same in each of them.

The error of a detected corner has a part that depends on the view, such as its place on the pixel grid, the light, and
the calibration of the lens. Of n images of one view, each with independent noise of variance w and a common error of
variance b, the mean has the variance b + w / n. A Kalman filter that takes errors for independent gets the same
information when image n has the variance (b n + w) (b (n - 1) + w) / w. A vehicle at rest before a single gate
therefore learns no more than the common error allows.
"""

from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.estimation.assignment import Match, PoseEstimate


class RepeatedViews:
    """Counts the images of a view of each gate.

    Args:
        bias_share: b / (b + w), 0 up to less than 1; with 0 all errors are independent.
        view_change_deg: motion of the corners' rays after which exp(-1) of a view remains, degrees.
        p_body_camera: optical centre (3,) in the body frame, m.
    """

    def __init__(self, bias_share: float, view_change_deg: float, p_body_camera):
        self._bias = bias_share
        self._change = np.radians(view_change_deg)
        self._p_body_camera = p_body_camera
        self._views: dict[int, tuple[float, np.ndarray]] = {}  # number of images, rays (4, 3) in the newest one

    def weighed(self, match: Match, pose_estimate: PoseEstimate) -> Match:
        """Count one more image of the associated gate, and return the match with the deviation of what it adds."""
        # The expected rays are compared: the noise of the observed ones is no change of the view.
        r_map_body = geometry.rotation_matrix(pose_estimate.q_map_body)
        arms = (match.corners_map - pose_estimate.p_map) @ r_map_body
        rays = geometry.normalize(arms - self._p_body_camera)
        count, before = self._views.get(match.gate, (0.0, rays))
        motion = float(np.sqrt(np.mean(np.sum((rays - before) ** 2, axis=-1))))
        count = 1.0 + count * np.exp(-motion / self._change)
        self._views[match.gate] = count, rays
        noise = 1.0 - self._bias
        factor = (self._bias * count + noise) * (self._bias * (count - 1.0) + noise) / noise
        return replace(match, sigma_rad=float(match.sigma_rad * np.sqrt(factor)))
