"""The upright panorama: the fisheye image turned by the vehicle's attitude so that gravity points down.

The detector looks at an equirectangular view (azimuth across, elevation down) centred on the azimuth of the optical
axis and on the horizon. Vertical gate edges are vertical columns at any roll and pitch, so the four corner classes
are never ambiguous, and a gate looks alike wherever it stands in the image. The view takes one `cv2.remap` from the
published image; points go back to its pixels exactly, through rays. Only the direction of gravity is used: an error of
the attitude tilts the picture by as much and moves no corner of the published image.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from swift_ros.camera import model as lens

COARSE = 4  # the map is computed at every fourth pixel and interpolated: exact to 0.02 px
LEAST_HORIZONTAL = 0.05  # part of the optical axis below which its azimuth says nothing


def r_upright_camera(r_world_camera) -> np.ndarray:
    """Return (3, 3): optical-frame vectors to the upright frame (x ahead on the horizon, y left, z up).

    Ahead is the azimuth of the optical axis; where that points straight up or down, of the camera's up vector (negated
    when looking up), which is where the axis came from.
    """
    r_world_camera = np.asarray(r_world_camera, dtype=float)
    ahead = r_world_camera[:2, 2]
    if np.hypot(*ahead) < LEAST_HORIZONTAL:
        ahead = r_world_camera[:2, 1] * np.sign(r_world_camera[2, 2])
    cosine, sine = ahead / np.hypot(*ahead)
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ r_world_camera


@dataclass(frozen=True)
class Panorama:
    """The square view: side px; pixels_per_radian in azimuth and elevation. A pixel centre has integer coordinates."""

    side: int
    pixels_per_radian: float

    def rays(self, points) -> np.ndarray:
        """Return unit rays (..., 3) in the upright frame of points (..., 2) in px."""
        points = np.asarray(points, dtype=float)
        angles = ((self.side - 1) / 2 - points) / self.pixels_per_radian
        azimuth, elevation = angles[..., 0], angles[..., 1]
        flat = np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)

    def points(self, rays) -> np.ndarray:
        """Return points (..., 2) in px of rays (..., 3) in the upright frame, of any length."""
        rays = np.asarray(rays, dtype=float)
        azimuth = np.arctan2(rays[..., 1], rays[..., 0])
        elevation = np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
        return (self.side - 1) / 2 - self.pixels_per_radian * np.stack([azimuth, elevation], axis=-1)


class UprightView:
    """Turns published images of one camera into the panorama and points of the panorama back."""

    def __init__(self, camera, panorama: Panorama):
        self.camera, self.panorama = camera, panorama
        count = -(-panorama.side // COARSE)
        # cv2.resize puts sample k of the coarse map at pixel COARSE k + (COARSE - 1) / 2; one more on every side.
        places = COARSE * np.arange(-1, count + 1) + (COARSE - 1) / 2
        self._rays = panorama.rays(np.stack(np.meshgrid(places, places), axis=-1))
        self._full = COARSE * (count + 2)

    def turn(self, image, r_world_camera) -> np.ndarray:
        """Return the panorama (side, side) uint8 of an image (H, W), black where the image shows nothing."""
        rays_camera = self._rays @ r_upright_camera(r_world_camera)
        coarse, _ = lens.project(self.camera, rays_camera)
        fine = cv2.resize(coarse.astype(np.float32), (self._full, self._full), interpolation=cv2.INTER_LINEAR)
        side = self.panorama.side
        fine = fine[COARSE : COARSE + side, COARSE : COARSE + side]
        return cv2.remap(image, fine, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)

    def to_image(self, points, r_world_camera) -> np.ndarray:
        """Return pixels (..., 2) of the published image of points (..., 2) of the panorama."""
        pixels, _ = lens.project(self.camera, self.panorama.rays(points) @ r_upright_camera(r_world_camera))
        return pixels

    def from_rays(self, rays_camera, r_world_camera) -> np.ndarray:
        """Return points (..., 2) of the panorama of rays (..., 3) in the optical frame."""
        return self.panorama.points(np.asarray(rays_camera) @ r_upright_camera(r_world_camera).T)
