"""Draws coloured faces into an image, from far to near (painter's algorithm)."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

NEAR_M = 0.15  # m in front of the camera, where faces are cut
SHIFT = 4  # bits of a pixel's fraction in OpenCV's coordinates
FARTHEST_PX = 1 << 14  # beyond, fixed-point coordinates would overflow


@dataclass(frozen=True)
class View:
    """A pinhole camera.

    Attributes:
        width, height: of an image, px.
        focal_px: focal length, px; the principal point is the centre.
        p_world: (3,) m, optical centre.
        rotation: R_world_camera (3, 3).
    """

    width: int
    height: int
    focal_px: float
    p_world: np.ndarray
    rotation: np.ndarray

    def to_camera(self, p_world) -> np.ndarray:
        """Return points (..., 3) of the world in the optical frame, m."""
        return (p_world - self.p_world) @ self.rotation

    def to_pixels(self, p_camera) -> np.ndarray:
        """Return the pixels (..., 2) of points (..., 3) in front of the camera."""
        plane = self.focal_px * p_camera[..., :2] / p_camera[..., 2:]
        return plane + [0.5 * self.width - 0.5, 0.5 * self.height - 0.5]


class Faces(NamedTuple):
    """Convex faces with equal numbers of corners.

    Attributes:
        corners: (n, k, 3) m, in the world.
        colors: (n, 3), BGR.
        opacity: (n,), 0 to 1.
    """

    corners: np.ndarray
    colors: np.ndarray
    opacity: np.ndarray


def paint(image, view: View, batches: list[Faces]) -> None:
    """Draw faces into an image (H, W, 3), the nearer over the farther; those behind the camera are not drawn."""
    drawn = []
    for corners, colors, opacity in batches:
        camera = view.to_camera(corners)
        depth = camera[..., 2]
        visible = np.flatnonzero((depth.max(axis=1) > NEAR_M) & (opacity > 0) & _in_front(view, camera))
        distance = np.linalg.norm(camera.mean(axis=1), axis=-1)
        whole = depth.min(axis=1) >= NEAR_M
        pixels = view.to_pixels(np.where(whole[:, None, None], camera, 1.0))
        for i in visible:
            drawn.append(
                (distance[i], pixels[i] if whole[i] else view.to_pixels(_cut(camera[i])), colors[i], opacity[i])
            )
    for _, pixels, color, opacity in sorted(drawn, key=lambda face: -face[0]):
        fill(image, pixels, color, opacity)


def _in_front(view: View, camera) -> np.ndarray:
    """Return which faces (n, k, 3) are not wholly outside one side of the image."""
    half = np.array([view.width, view.height]) / 2 / view.focal_px
    outside = np.abs(camera[..., :2]) > half * camera[..., 2:]
    same_side = np.all(outside, axis=1) & np.all(np.sign(camera[..., :2]) == np.sign(camera[:, :1, :2]), axis=1)
    return ~same_side.any(axis=-1)


def _cut(corners) -> np.ndarray:
    """Return the part of a face (k, 3) that is at least `NEAR_M` in front of the camera (Sutherland and Hodgman)."""
    kept = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if a[2] >= NEAR_M:
            kept.append(a)
        if (a[2] >= NEAR_M) != (b[2] >= NEAR_M):
            kept.append(a + (NEAR_M - a[2]) / (b[2] - a[2]) * (b - a))
    return np.array(kept)


def fill(image, pixels, color, opacity: float = 1.0) -> None:
    """Draw a convex polygon (k, 2) px with smooth edges."""
    pixels = np.minimum(np.maximum(pixels, -FARTHEST_PX), FARTHEST_PX)
    color = color.tolist() if isinstance(color, np.ndarray) else color
    if opacity >= 1.0:
        cv2.fillConvexPoly(image, _fixed(pixels), color, cv2.LINE_AA, SHIFT)
        return
    (left, top), (right, bottom) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
    left, top = max(int(left) - 1, 0), max(int(top) - 1, 0)
    part = image[top : max(int(bottom) + 2, 0), left : max(int(right) + 2, 0)]
    if part.size:
        filled = part.copy()
        cv2.fillConvexPoly(filled, _fixed(pixels - [left, top]), color, cv2.LINE_AA, SHIFT)
        cv2.addWeighted(filled, opacity, part, 1.0 - opacity, 0.0, dst=part)


def _fixed(pixels) -> np.ndarray:
    return (pixels * (1 << SHIFT) + 0.5).astype(np.int32)
