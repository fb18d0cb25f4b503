"""The upright panorama: the fisheye image rotated by the vehicle's attitude so that gravity points down.

The input of the detector is an equirectangular view (azimuth to the right, elevation downwards) centred on the azimuth
of the optical axis. Vertical edges of a gate are columns at any roll and pitch, so that the four corner classes are
unambiguous, and a gate has the same appearance everywhere in the view. One `cv2.remap` computes the view from the
published image; points are converted back to its pixels exactly, through rays. Only the direction of gravity is used:
an attitude error tilts the view by the same angle, but does not move a corner in the published image.

The view fits the lens. That of a wide lens is centred on the horizon. That of a narrow one is denser, and follows the
optical axis up and down within the elevations that the view of a wide lens shows.
"""

import math
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

    elevation = 0.0  # of the centre, rad; no setting

    def angles(self, points) -> np.ndarray:
        """Return azimuth (to the left) and elevation (..., 2), rad, of points (..., 2) in px."""
        angles = ((self.side - 1) / 2 - np.asarray(points, dtype=float)) / self.pixels_per_radian
        # Columns are denser by 1 / cos(elevation) of the centre, where a gate so has its shape.
        return angles / [np.cos(self.elevation), 1.0] + [0.0, self.elevation]

    def rays(self, points) -> np.ndarray:
        """Return unit rays (..., 3) in the upright frame of points (..., 2) in px."""
        angles = self.angles(points)
        azimuth, elevation = angles[..., 0], angles[..., 1]
        flat = np.cos(elevation)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)

    def points(self, rays) -> np.ndarray:
        """Return points (..., 2) in px of rays (..., 3) of any length in the upright frame."""
        rays = np.asarray(rays, dtype=float)
        azimuth = np.arctan2(rays[..., 1], rays[..., 0]) * np.cos(self.elevation)
        elevation = np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1])) - self.elevation
        return (self.side - 1) / 2 - self.pixels_per_radian * np.stack([azimuth, elevation], axis=-1)


@dataclass(frozen=True)
class RaisedPanorama(Panorama):
    """A panorama whose centre is not on the horizon.

    Attributes:
        elevation: of its centre, rad. Columns have `pixels_per_radian` times its cosine.
    """

    elevation: float = 0.0


def panorama_of_lens(camera, panorama: Panorama) -> Panorama:
    """Return the panorama of a lens for a network.

    Its side shows the field of view of the lens, whatever the roll. It is never coarser than the panorama with which
    the network was trained: of a wider lens the margin is left out.

    Args:
        camera: the lens.
        panorama: with which the network was trained.
    """
    density = panorama.side / (2.0 * camera.half_angle)
    return Panorama(panorama.side, max(panorama.pixels_per_radian, float(density)))


class UprightView:
    """Converts published images of one camera to the panorama of its lens, and points of the panorama back.

    Args:
        camera: the lens.
        panorama: with which the network was trained.
        zoom: scale of the panorama of the lens; other than 1 only in training, where gates have other sizes by it.

    Attributes:
        panorama: of the lens, centred on the horizon; `panorama_at` is that of an image.
    """

    def __init__(self, camera, panorama: Panorama, zoom: float = 1.0):
        self.camera = camera
        fitted = panorama_of_lens(camera, panorama)
        self.panorama = Panorama(fitted.side, zoom * fitted.pixels_per_radian)
        halves = [0.5 * one.side / one.pixels_per_radian for one in (panorama, fitted)]
        self._most_elevation = halves[0] - halves[1]  # so that no view reaches nearer to the poles than the trained one
        count = -(-fitted.side // COARSE)
        # cv2.resize places sample k of the coarse map at pixel COARSE k + (COARSE - 1) / 2; one more on every side.
        positions = COARSE * np.arange(-1, count + 1) + (COARSE - 1) / 2
        self._grid = np.stack(np.meshgrid(positions, positions), axis=-1)
        self._full = COARSE * (count + 2)
        self._last = self.panorama, self._rays_of(self.panorama)
        self._reduced_size = self._size_for(self.panorama.pixels_per_radian)

    def _size_for(self, density: float) -> tuple[int, int] | None:
        """Return the size to which an image is reduced before it is turned; None where it has no more detail.

        Each pixel of the panorama is interpolated between four of the image. Where there are more below it, they are
        averaged first: patterns finer than a pixel would otherwise become noise.
        """
        camera = self.camera
        slope = float(camera.lens.slope(0.0, camera.distortion))
        factor = int(slope * min(camera.fx, camera.fy) / density)
        return (-(-camera.width // factor), -(-camera.height // factor)) if factor > 1 else None

    def panorama_at(self, r_world_camera) -> Panorama:
        """Return the panorama of an image with an attitude (3, 3)."""
        axis = min(max(float(r_world_camera[2, 2]), -1.0), 1.0)
        elevation = min(max(math.asin(axis), -self._most_elevation), self._most_elevation)
        if elevation == 0.0:
            return self.panorama
        return RaisedPanorama(self.panorama.side, self.panorama.pixels_per_radian, elevation)

    def _rays(self, panorama: Panorama) -> np.ndarray:
        """Return the rays of the coarse map (3, n), which are kept for the next image."""
        if self._last[0] != panorama:
            self._last = panorama, self._rays_of(panorama)
        return self._last[1]

    def _rays_of(self, panorama: Panorama) -> np.ndarray:
        # One row for each component: rotation and projection are faster than with rows of three.
        return np.ascontiguousarray(panorama.rays(self._grid).reshape(-1, 3).T)

    def warp(self, image, r_world_camera) -> np.ndarray:
        """Return the panorama (side, side) uint8 of an image (H, W); black outside of the image."""
        rays = r_upright_camera(r_world_camera).T @ self._rays(self.panorama_at(r_world_camera))
        rays_camera = rays.T.reshape(*self._grid.shape[:2], 3)
        coarse, _ = lens.project(self.camera, rays_camera)
        if self._reduced_size:
            scale = np.array(self._reduced_size) / [self.camera.width, self.camera.height]
            coarse = (coarse + 0.5) * scale - 0.5
            image = cv2.resize(image, self._reduced_size, interpolation=cv2.INTER_AREA)
        fine = cv2.resize(coarse.astype(np.float32), (self._full, self._full), interpolation=cv2.INTER_LINEAR)
        side = self.panorama.side
        fine = fine[COARSE : COARSE + side, COARSE : COARSE + side]
        second: Any = None  # not needed with a map of pairs (x, y), which cv2's annotations do not know
        return cv2.remap(image, fine, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)

    def to_image(self, points, r_world_camera) -> np.ndarray:
        """Return the pixels (..., 2) in the published image of points (..., 2) of the panorama."""
        return self._project(points, r_world_camera)[0]

    def border_px(self, points, r_world_camera) -> np.ndarray:
        """Return the distances (...) px of points (..., 2) of the panorama from the border, negative outside.

        The border is that of the image and that of what the lens images.
        """
        camera, density = self.camera, self.panorama.pixels_per_radian
        pixels, angles = self._project(points, r_world_camera)
        inside = lens.inside_px(camera, pixels) / min(camera.fx, camera.fy)
        return density * np.minimum(inside, camera.half_angle - angles)

    def _project(self, points, r_world_camera) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels of the published image (..., 2), and angles from the optical axis (...), of points (..., 2)."""
        rays = self.panorama_at(r_world_camera).rays(points)
        return lens.project(self.camera, rays @ r_upright_camera(r_world_camera))

    def from_rays(self, rays_camera, r_world_camera) -> np.ndarray:
        """Return points (..., 2) of the panorama of rays (..., 3) in the optical frame."""
        rays = np.asarray(rays_camera) @ r_upright_camera(r_world_camera).T
        return self.panorama_at(r_world_camera).points(rays)
