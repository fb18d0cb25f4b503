"""Gates of the map that a vehicle at rest should see, and too few of them in its images.

A gate detector finds a gate in clear view with a probability that depends on the angle of its shortest side, that is on
size, distance and direction. Images of one view show the same and count as one draw: the number of gates that are found
has a Poisson-binomial distribution. With a covered lens, a wrong mount or a wrong place any number is as likely as
another. Gates are missing when this explains their number twenty times better.
"""

from collections import deque
from statistics import median_high

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.camera.projected_gates import whole_gates
from swift_ros.estimation.assignment import AMBIGUOUS, Match, PoseEstimate
from swift_ros.track import Track

# Share of the gates in clear view that the shipped detector found, by their shortest side: of 1,316 gates in 1,400
# rendered images of random tracks by a level camera. Gates behind one another and those steeply above are found less
# often, and are not expected.
SIDES_DEG = (2.5, 3.2, 3.7, 4.7, 6.5)
FOUND_SHARES = (0.47, 0.74, 0.84, 0.94, 0.96)
LEAST_APART_DEG, MOST_ELEVATION_DEG = 10.0, 35.0
LEAST_BAYES_FACTOR = 20.0  # "strong evidence" (Kass and Raftery 1995): one gate, which any look may hide, is too few
LEAST_TIME_S, MOST_IMAGES = 1.0, 300  # at rest; the newest images that count


class MissingGates:
    """Counts the gates in the images of a vehicle at rest.

    Args:
        camera: as assumed.
        track: with the gates of the map.
    """

    def __init__(self, camera: Camera, track: Track):
        self._camera = camera
        self._track = track
        self._images: deque[tuple[int, int, int]] = deque(maxlen=MOST_IMAGES)  # stamp ns, gates of the map, elsewhere
        self._pose: PoseEstimate | None = None  # of the newest image

    def count(self, stamp_ns: int, pose_estimate: PoseEstimate, matches: list[Match]) -> None:
        """Count the gates of an image.

        Args:
            stamp_ns: of the image.
            pose_estimate: of the filter at this stamp.
            matches: of all detected gates, those included that a wrong calibration explains.
        """
        elsewhere = sum(match.gate < 0 and match.reason != AMBIGUOUS for match in matches)
        self._images.append((stamp_ns, len(matches) - elsewhere, elsewhere))
        self._pose = pose_estimate

    def warning(self) -> str:
        """Return a sentence when too few of the gates are found that should be, "" otherwise."""
        if self._pose is None or self._images[-1][0] - self._images[0][0] < LEAST_TIME_S * 1e9:
            return ""
        shares = found_shares(self._camera, self._track, self._pose)
        found, elsewhere = (median_high(image[i] for image in self._images) for i in (1, 2))
        if not are_missing(found, shares):
            return ""
        return (
            f"at rest the camera should see {np.sum(shares):.0f} gates of the map, and in {len(self._images)} images "
            f"{found} of them and {elsewhere} elsewhere are detected: check lens cover and exposure, signs and axes of "
            "the mount in camera.yaml, track.yaml, and place and heading of the vehicle"
        )


def found_shares(camera: Camera, track: Track, pose_estimate: PoseEstimate) -> np.ndarray:
    """Return the probabilities (n,) with which each gate in clear view is found.

    Args:
        camera: as assumed.
        track: with the gates of the map.
        pose_estimate: of the vehicle.
    """
    p_map, q_map_body = pose_estimate.p_map, pose_estimate.q_map_body
    rays = geometry.normalize(track.corners - p_map - geometry.rotate(q_map_body, camera.p_body_camera))
    steepness = np.abs(rays[..., 2]).max(axis=1)
    directions = geometry.normalize(rays.sum(axis=1))
    nearness = directions @ directions.T - 2.0 * np.eye(len(directions))
    clear = steepness < np.sin(np.radians(MOST_ELEVATION_DEG))
    clear &= nearness.max(axis=1) < np.cos(np.radians(LEAST_APART_DEG))
    sides = whole_gates(camera, track, p_map, q_map_body)
    sides_deg = np.degrees([side for gate, side in sides.items() if clear[gate]])
    return np.interp(sides_deg[sides_deg >= SIDES_DEG[0]], SIDES_DEG, FOUND_SHARES)


def are_missing(found: int, shares) -> bool:
    """Return whether too few gates are found.

    Args:
        found: number of gates.
        shares: probabilities (n,) with which each gate in view is found.
    """
    if found >= np.sum(shares):
        return False
    likelihood = np.ones(1)  # of each number of found gates
    for share in shares:
        likelihood = np.convolve(likelihood, [1.0 - share, share])
    return bool(1.0 / len(likelihood) >= LEAST_BAYES_FACTOR * likelihood[found])
