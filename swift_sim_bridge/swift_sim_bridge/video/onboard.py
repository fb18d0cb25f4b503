"""The recorded image in a corner of the frame, with the corners of detected gates and the gates of the map."""

import cv2
import numpy as np

from swift_ros.camera.model import Camera
from swift_ros.camera.projected_gates import gate_edges
from swift_ros.track import Track
from swift_ros.types import GateCorners
from swift_sim_bridge.rendering.renderer import pixel_rays
from swift_sim_bridge.video.flight import Path3
from swift_sim_bridge.video.shapes import AMBER, BLUE, GREEN

BORDER = (235, 235, 235)


class Onboard:
    """Draws recorded images into a square of a frame."""

    def __init__(self, side: int, camera: Camera | None, track: Track | None):
        """Make it.

        Args:
            side: of the square, px.
            camera: that took the images; None: unknown, no gate of the map is drawn.
            track: whose gates are drawn; None for none.
        """
        self._side, self._camera, self._track = side, camera, track
        self._inside: np.ndarray | None = None

    def draw(self, place, image, gates: list[GateCorners], pose: Path3 | None) -> None:
        """Draw an image.

        Args:
            place: (side, side, 3) BGR of the frame.
            image: grey levels (H, W).
            gates: detected in it, whole and incomplete ones.
            pose: estimated at its stamp, one row; None: the gates of the map are not drawn.
        """
        height, width = image.shape
        scale = self._side / max(height, width)
        size = round(scale * width), round(scale * height)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        picture = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
        if pose is not None and self._camera is not None and self._track is not None:
            for _, line in gate_edges(self._camera, self._track.corners, pose.p_world[0], pose.q_world_body[0]):
                _polylines(picture, [_scaled(line, scale)], AMBER)
        for gate in gates:
            color = GREEN if gate.seen.all() else BLUE
            _polylines(picture, _scaled(gate.edges_px, scale), color)
            for corner in _scaled(gate.corners_px[gate.seen], scale):
                cv2.circle(picture, np.round(corner).astype(int).tolist(), 3, color, -1, cv2.LINE_AA)
        inside = self._mask(image.shape, size)
        left, top = (self._side - size[0]) // 2, (self._side - size[1]) // 2
        target = place[top : top + size[1], left : left + size[0]]
        np.copyto(target, picture, where=inside[..., None])
        rims, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(target, rims, -1, BORDER, max(1, self._side // 150), cv2.LINE_AA)

    def _mask(self, shape, size) -> np.ndarray:
        """Return the pixels (h, w) within the image circle; all without a camera of the image's size."""
        if self._inside is None or self._inside.shape != size[::-1]:
            camera = self._camera
            known = camera is not None and shape == (camera.height, camera.width)
            inside = pixel_rays(camera)[0] if known else np.ones(shape, bool)
            self._inside = cv2.resize(inside.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        return self._inside


def _scaled(pixels, scale: float) -> np.ndarray:
    """Return pixels (..., 2) in the image of another size; the centre of the first one lies at 0 in both."""
    return scale * (pixels + 0.5) - 0.5


def _polylines(image, lines, color) -> None:
    cv2.polylines(image, [np.round(16 * line).astype(np.int32) for line in lines], False, color, 1, cv2.LINE_AA, 4)
