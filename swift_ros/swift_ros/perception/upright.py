"""The upright panorama: the fisheye image rotated by the vehicle's attitude so that gravity points down.

The input of the detector is an equirectangular view (azimuth to the right, elevation downwards) centred on the azimuth
of the optical axis and on the horizon. Vertical edges of a gate are columns at any roll and pitch, so that the four
corner classes are unambiguous, and a gate has the same appearance everywhere in the view. One `cv2.remap` computes the
view from the published image; points are converted back to its pixels exactly, through rays. Only the direction of
gravity is used: an attitude error tilts the view by the same angle, but does not move a corner in the published image.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from swift_ros.camera import model as lens
from swift_ros.configuration import within

COARSE = 4  # px; the map is computed at every fourth pixel and interpolated, with errors below 0.02 px
MIN_HORIZONTAL = 0.05  # horizontal component of the optical axis below which its azimuth is undefined


def r_upright_camera(r_world_camera) -> np.ndarray:
    """Return the rotation (3, 3) from the optical frame to the upright frame (x forward on the horizon, y left, z up).

    Forward is the azimuth of the optical axis. If the axis is vertical, it is that of the camera's up vector, negated
    when the camera looks up: the limit of the axis' azimuth.
    """
    r_world_camera = np.asarray(r_world_camera, dtype=float)
    ahead = r_world_camera[:2, 2]
    if np.hypot(*ahead) < MIN_HORIZONTAL:
        ahead = r_world_camera[:2, 1] * np.sign(r_world_camera[2, 2])
    cosine, sine = ahead / np.hypot(*ahead)
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ r_world_camera


@dataclass(frozen=True)
class Panorama:
    """The square view. A pixel centre has integer coordinates.

    Attributes:
        side: px.
        pixels_per_radian: in azimuth and elevation.
    """

    side: int = within(1, 4096)
    pixels_per_radian: float = within(1.0, 10_000.0)

    def rays(self, points) -> np.ndarray:
        """Return unit rays (..., 3) in the upright frame of points (..., 2) in px."""
        points = np.asarray(points, dtype=float)
        angles = ((self.side - 1) / 2 - points) / self.pixels_per_radian
        azimuth, elevation = angles[..., 0], angles[..., 1]
        flat = np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)

    def points(self, rays) -> np.ndarray:
        """Return points (..., 2) in px of rays (..., 3) of any length in the upright frame."""
        rays = np.asarray(rays, dtype=float)
        azimuth = np.arctan2(rays[..., 1], rays[..., 0])
        elevation = np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
        return (self.side - 1) / 2 - self.pixels_per_radian * np.stack([azimuth, elevation], axis=-1)


class UprightView:
    """Converts published images of one camera to the panorama, and points of the panorama back."""

    def __init__(self, camera, panorama: Panorama):
        self.camera, self.panorama = camera, panorama
        count = -(-panorama.side // COARSE)
        # cv2.resize places sample k of the coarse map at pixel COARSE k + (COARSE - 1) / 2; one more on every side.
        positions = COARSE * np.arange(-1, count + 1) + (COARSE - 1) / 2
        self._rays = panorama.rays(np.stack(np.meshgrid(positions, positions), axis=-1))
        self._full = COARSE * (count + 2)

    def warp(self, image, r_world_camera) -> np.ndarray:
        """Return the panorama (side, side) uint8 of an image (H, W); black outside of the image."""
        rays_camera = self._rays @ r_upright_camera(r_world_camera)
        coarse, _ = lens.project(self.camera, rays_camera)
        fine = cv2.resize(coarse.astype(np.float32), (self._full, self._full), interpolation=cv2.INTER_LINEAR)
        side = self.panorama.side
        fine = fine[COARSE : COARSE + side, COARSE : COARSE + side]
        second: Any = None  # not needed with a map of pairs (x, y), which cv2's annotations do not know
        return cv2.remap(image, fine, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)

    def to_image(self, points, r_world_camera) -> np.ndarray:
        """Return the pixels (..., 2) in the published image of points (..., 2) of the panorama."""
        pixels, _ = lens.project(self.camera, self.panorama.rays(points) @ r_upright_camera(r_world_camera))
        return pixels

    def from_rays(self, rays_camera, r_world_camera) -> np.ndarray:
        """Return points (..., 2) of the panorama of rays (..., 3) in the optical frame."""
        return self.panorama.points(np.asarray(rays_camera) @ r_upright_camera(r_world_camera).T)
