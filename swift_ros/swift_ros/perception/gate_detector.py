"""From a published image and the vehicle's attitude to gates: upright view, network, peaks, grouping, and back."""

from collections import deque

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.perception.corner_grouping import GroupingSettings, edge_scores, find_peaks, joined, quadrilaterals
from swift_ros.perception.corner_network import CornerNetwork
from swift_ros.perception.upright import UprightView
from swift_ros.timeline import Timeline
from swift_ros.types import GateCorners, Odometry


class GateDetector:
    """One camera, one network.

    grouping: thresholds; its stride is the network's.
    """

    def __init__(self, camera, network: CornerNetwork, grouping: GroupingSettings):
        if grouping.stride != network.shape.stride:
            raise UsageError(f"the detector's maps have stride {network.shape.stride}, not {grouping.stride}")
        self.camera, self.network, self.grouping = camera, network, grouping
        self.view = UprightView(camera, network.shape.panorama)

    def r_world_camera(self, q_world_body) -> np.ndarray:
        """Return the attitude (3, 3) of the optical frame of a body's (4,)."""
        q_world_body = geometry.normalize(np.asarray(q_world_body, dtype=float))
        return geometry.rotation_matrix(geometry.quaternion_multiply(q_world_body, self.camera.q_body_camera))

    def detect(self, image, q_world_body) -> list[GateCorners]:
        """Return the whole gates in an image (H, W) uint8 taken at an attitude (4,), corners in its pixels.

        Raises ValueError when the image is not of the camera's size or the attitude is no number.
        """
        peaks, scores, r_world_camera = self._look(image, q_world_body)
        gates = []
        for gate in quadrilaterals(peaks, scores, self.network.shape.panorama, self.grouping):
            points = np.stack([peaks[k].points[i] for k, i in enumerate(gate)])
            confidence = np.array([peaks[k].confidence[i] for k, i in enumerate(gate)])
            gates.append(GateCorners(self.view.to_image(points, r_world_camera), confidence))
        return gates

    def corners(self, image, q_world_body) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return for TL, TR, BR, BL the corners (n, 2) px of the image that an edge joins to another, and their
        confidence (n,): what the network sees, gates that are not whole included."""
        peaks, scores, r_world_camera = self._look(image, q_world_body)
        kept = joined(scores, self.grouping)
        return [
            (self.view.to_image(p.points[keep], r_world_camera), p.confidence[keep])
            for p, keep in zip(peaks, kept, strict=True)
        ]

    def _look(self, image, q_world_body):
        if image.shape != (self.camera.height, self.camera.width):
            height, width = image.shape
            wanted = f"{self.camera.width} x {self.camera.height}"
            raise ValueError(f"an image of {width} x {height} came, camera.yaml says {wanted}; correct one of them")
        if not np.all(np.isfinite(q_world_body)):
            raise ValueError("the attitude at the image's stamp is no number; look at vio/odometry")
        r_world_camera = self.r_world_camera(q_world_body)
        corner_maps, fields = self.network.maps(self.view.turn(image, r_world_camera))
        peaks = find_peaks(corner_maps, self.grouping)
        return peaks, edge_scores(peaks, fields, self.network.shape.panorama, self.grouping), r_world_camera


class AttitudeAtStamp:
    """The vehicle's attitude at an image's stamp, from odometry.

    In lockstep an image waits until odometry of its stamp or later is there. In real time the newest is turned on by
    its body rates, and one that is older than `patience_s` says nothing.
    """

    def __init__(self, wait: bool, patience_s: float):
        self._wait, self._patience_ns = wait, int(patience_s * 1e9)
        self._timeline = Timeline(1.0)
        self._images: deque[tuple[int, object]] = deque()

    def add_odometry(self, state: Odometry) -> None:
        """Add odometry. Raises ValueError when its stamp is not newer than the last one."""
        self._timeline.add(state)

    def add_image(self, stamp_ns: int, image) -> None:
        """Add an image, of any type."""
        self._images.append((stamp_ns, image))

    def ready_images(self):
        """Yield (image, q_world_body (4,) or None where unknown) of all images that can be processed now, in order."""
        while self._images:
            stamp_ns, image = self._images[0]
            newest = self._timeline.newest
            if self._wait and (newest is None or newest.stamp_ns < stamp_ns):
                return
            self._images.popleft()
            yield image, self._attitude(stamp_ns)

    def _attitude(self, stamp_ns: int):
        state = self._timeline.at(stamp_ns)
        if state is not None:
            return state.q_world_body
        newest = self._timeline.newest
        if newest is None or not 0 < stamp_ns - newest.stamp_ns <= self._patience_ns:
            return None
        dt = (stamp_ns - newest.stamp_ns) * 1e-9
        return geometry.integrate_quaternion(newest.q_world_body, newest.omega_body, dt)
