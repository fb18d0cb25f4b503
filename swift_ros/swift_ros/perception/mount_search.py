"""Detects gates on the podium although the mount in camera.yaml may turn the images wrongly.

A gate detector finds gates in images that are turned upright. With exchanged axes or signs in the mount they are turned
the wrong way, and no gate may be found. While a vehicle at rest sees none, every second image is therefore turned as
with another mount. This takes no time beyond that of an image, and where the corners are in the published image does
not depend on the mount: from them the state estimator names the mount that is right. In flight the given mount is used.
"""

import numpy as np

from swift_ros import geometry
from swift_ros.camera.mounts import other_mounts
from swift_ros.perception.gate_detector import GateDetector
from swift_ros.types import GateCorners, Odometry

EMPTY_IMAGES = 10  # successive images without gates before another mount is tried


class MountSearch:
    """Detector that tries other mounts until the vehicle first moves.

    Args:
        detector: with the given mount.
    """

    def __init__(self, detector: GateDetector):
        self._detector = detector
        q_camera_body = geometry.quaternion_conjugate(detector.camera.q_body_camera)
        # A body that carries the given mount as the vehicle carries the other one.
        self._turns = [
            geometry.quaternion_multiply(other.q_body_camera, q_camera_body)
            for other in other_mounts(detector.camera).values()
        ]
        self._empty = 0  # successive images in which no gate was found with the given mount
        self._tries_other = False
        self._other = 0  # index of the mount that is tried next
        self._finished = not self._turns

    def odometry(self, odometry: Odometry) -> None:
        """Add odometry, in the order of the stamps."""
        self._finished = self._finished or not odometry.is_at_rest

    def detect_all(self, image, q_world_body) -> tuple[list[GateCorners], list[GateCorners]]:
        """Return the complete and the incomplete gates in an image; arguments and errors as for `GateDetector.detect`.

        Of gates that are found with another mount, the corner that is named the top left one may be another one. They
        are complete.
        """
        self._tries_other = not self._tries_other and self._empty >= EMPTY_IMAGES and not self._finished
        if not self._tries_other:
            gates, incomplete = self._detector.detect_all(image, q_world_body)
            self._empty = 0 if gates else self._empty + 1
            return gates, incomplete
        turned = geometry.quaternion_multiply(np.asarray(q_world_body, dtype=float), self._turns[self._other])
        gates = self._detector.detect(image, turned)
        if not gates:
            self._other = (self._other + 1) % len(self._turns)
        return gates, []
