"""Detects gates in an image with the vehicle's attitude: upright panorama, network, peaks, grouping."""

from collections import deque
from typing import Any

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.perception.corner_grouping import (
    GroupingSettings,
    connected_corners,
    edge_scores,
    find_peaks,
    quadrilaterals,
)
from swift_ros.perception.corner_network import CornerNetwork
from swift_ros.perception.incomplete_gates import MIN_BORDER_PX, incomplete_gates, seen_corners
from swift_ros.perception.upright import UprightView
from swift_ros.timeline import Timeline
from swift_ros.types import GateCorners, Odometry

HISTORY_S = 1.0  # s; odometry kept for images that come late


class GateDetector:
    """Detector for one camera with one network.

    Args:
        camera: the camera.
        network: its network.
        grouping: settings of the grouping, with the stride of the network.

    Raises:
        UsageError: the strides differ.
    """

    def __init__(self, camera, network: CornerNetwork, grouping: GroupingSettings):
        if grouping.stride != network.shape.stride:
            raise UsageError(f"the detector's maps have stride {network.shape.stride}, not {grouping.stride}")
        self.camera, self.network, self.grouping = camera, network, grouping
        self.view = UprightView(camera, network.shape.panorama)

    def r_world_camera(self, q_world_body) -> np.ndarray:
        """Return the attitude (3, 3) of the optical frame for an attitude (4,) of the body."""
        q_world_body = geometry.normalize(np.asarray(q_world_body, dtype=float))
        return geometry.rotation_matrix(geometry.quaternion_multiply(q_world_body, self.camera.q_body_camera))

    def detect(self, image, q_world_body) -> list[GateCorners]:
        """Return the complete gates in an image, with corners in px of the image.

        Args:
            image: (H, W) uint8.
            q_world_body: attitude (4,) at the stamp of the image.

        Raises:
            ValueError: the image has not the camera's size, or the attitude is not a number.
        """
        return self.detect_all(image, q_world_body)[0]

    def detect_all(self, image, q_world_body) -> tuple[list[GateCorners], list[GateCorners]]:
        """Return the complete and the incomplete gates in an image; arguments and errors as for `detect`."""
        peaks, scores, r_world_camera = self._peaks_and_scores(image, q_world_body)
        panorama, usable = self.view.panorama_at(r_world_camera), self._far_from_border(peaks, r_world_camera)
        gates = [dict(enumerate(gate)) for gate in quadrilaterals(peaks, scores, panorama, self.grouping)]
        complete = len(gates)
        for gate in gates:
            for k, i in gate.items():
                usable[k][i] = False
        gates += incomplete_gates(scores, usable, self.grouping)
        if not gates:
            return [], []
        points, confidence = seen_corners(gates, peaks, self.grouping)
        found = list(map(GateCorners, self.view.to_image(points, r_world_camera), confidence))
        return found[:complete], found[complete:]

    def _far_from_border(self, peaks, r_world_camera) -> list[np.ndarray]:
        """Return for each class a mask (n,) of the peaks that an incomplete gate may have."""
        points = np.concatenate([p.points for p in peaks])
        far = self.view.border_px(points, r_world_camera) > MIN_BORDER_PX
        return np.split(far, np.cumsum([len(p.points) for p in peaks])[:-1])

    def corners(self, image, q_world_body) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return for TL, TR, BR, BL the corners (n, 2) px connected to another corner, and their confidence (n,).

        Corners of incomplete gates are included. Arguments and errors as for `detect`.
        """
        peaks, scores, r_world_camera = self._peaks_and_scores(image, q_world_body)
        kept = connected_corners(scores, self.grouping)
        return [
            (self.view.to_image(p.points[keep], r_world_camera), p.confidence[keep])
            for p, keep in zip(peaks, kept, strict=True)
        ]

    def _peaks_and_scores(self, image, q_world_body):
        if image.shape != (self.camera.height, self.camera.width):
            height, width = image.shape
            wanted = f"{self.camera.width} x {self.camera.height}"
            raise ValueError(f"the image has {width} x {height} px, camera.yaml {wanted}; correct one of them")
        if not np.all(np.isfinite(q_world_body)):
            raise ValueError("the attitude at the image's stamp is not a number; see vio/odometry")
        r_world_camera = self.r_world_camera(q_world_body)
        corner_maps, fields = self.network.maps(self.view.warp(image, r_world_camera))
        peaks = find_peaks(corner_maps, self.grouping)
        panorama = self.view.panorama_at(r_world_camera)
        return peaks, edge_scores(peaks, fields, panorama, self.grouping), r_world_camera


class AttitudeAtStamp:
    """The vehicle's attitude at the stamp of an image, from odometry.

    Args:
        wait: in lockstep, an image waits for odometry of its stamp or later. In real time the newest attitude is
            extrapolated with its body rates.
        max_age_s: in real time, largest age of the odometry, s; the attitude is unknown for an older one.
    """

    def __init__(self, wait: bool, max_age_s: float):
        self._wait, self._max_age_ns = wait, int(max_age_s * 1e9)
        self._timeline = Timeline(HISTORY_S)
        self._images: deque[tuple[int, Any]] = deque()

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
        if newest is None or not 0 < stamp_ns - newest.stamp_ns <= self._max_age_ns:
            return None
        dt = (stamp_ns - newest.stamp_ns) * 1e-9
        return geometry.integrate_quaternion(newest.q_world_body, newest.omega_body, dt)
