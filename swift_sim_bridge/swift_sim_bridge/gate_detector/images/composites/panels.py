"""Flat pictures in space and their image through any lens.

A scene is a list of panels, painted from the farthest to the nearest. The ray of each pixel is intersected with the
plane of a panel, so that the image is exact for every lens model. The world frame has its origin in the optical centre
and z up.
"""

import functools
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from swift_ros.camera import lens as lenses
from swift_ros.camera import model as lens

# px; rays are computed at every so many pixels and interpolated, with errors of some hundredths of a pixel. The inverse
# of a pinhole lens with its tangential part takes long, and that of a wide lens changes fast.
STEP = {lenses.PINHOLE: 8, lenses.KANNALA_BRANDT: 2, lenses.DOUBLE_SPHERE: 4}
EDGE_POINTS = 9  # on each edge of a panel, from which its place in the image is computed
EDGE_ON = 1e-5  # volume of ray plane and normal below which a panel is seen edge-on and not drawn
SHINING = 1.2  # brightness from which a picture shines by itself
FEW = 8  # px; a panel partly behind the camera is looked for at every eighth ray
BEHIND = 1e-6  # 1/m, inverse distance that stands for a plane behind the camera
FAR_PX = 2e4  # pixels of a picture beyond this are outside of it
COARSER = 8  # factor between the two resolutions of a tiled picture


@dataclass(frozen=True)
class Panel:
    """A flat picture in the world.

    Attributes:
        centre: (3,) m.
        right, down: (3,) unit vectors of the picture's columns and rows.
        size: (2,) m, width and height; of one tile where it is tiled.
        picture: (h, w, 2) float32, brightness times opacity, and opacity.
        solid: it hides corners behind it where it is opaque; nets and glass do not.
        tiled: the picture is repeated over the whole plane.
    """

    centre: np.ndarray
    right: np.ndarray
    down: np.ndarray
    size: tuple[float, float]
    picture: np.ndarray
    solid: bool = True
    tiled: bool = False

    def at(self, points):
        """Return points (..., 3) of the world, m, of points (..., 2) m to the right of and below the centre."""
        points = np.asarray(points, dtype=float)
        return self.centre + points[..., :1] * self.right + points[..., 1:] * self.down

    def to_picture(self, shape) -> np.ndarray:
        """Return the matrix (3, 3) from rays in the world to homogeneous pixels of a picture of a shape (h, w).

        The third coordinate is the inverse of the distance in lengths of the ray; it is negative behind the camera.
        """
        height, width = shape[:2]
        column, row = self.right * (self.size[0] / width), self.down * (self.size[1] / height)
        corner = self.centre - column * (width - 1) / 2 - row * (height - 1) / 2
        return np.linalg.inv(np.stack([column, row, corner], axis=1))

    @property
    def edge_on(self) -> bool:
        """Whether the camera is so near to the panel's plane that it is not drawn."""
        normal = np.cross(self.right, self.down)
        return bool(abs(normal @ self.centre) < EDGE_ON + 1e-3 * np.linalg.norm(self.centre))

    def outline(self) -> np.ndarray:
        """Return points (n, 3) m around the panel."""
        share = np.linspace(-0.5, 0.5, EDGE_POINTS)[:-1]
        end = np.full_like(share, 0.5)
        x, y = np.concatenate([share, end, -share, -end]), np.concatenate([-end, share, end, -share])
        return self.at(np.stack([x * self.size[0], y * self.size[1]], axis=-1))

    def covers(self, rays) -> np.ndarray:
        """Return whether directions (..., 3) of the world meet the panel; with tiles, its plane."""
        x, y, ahead = np.moveaxis(rays @ self.to_picture((1, 1)).T, -1, 0)
        inside = (np.abs(x) <= 0.5 * ahead) & (np.abs(y) <= 0.5 * ahead)
        return (ahead > 0) & (inside | self.tiled)

    def opacity(self, rays) -> np.ndarray:
        """Return the opacity (...) of the panel in directions (..., 3) of the world."""
        if self.edge_on:
            return np.zeros(rays.shape[:-1])
        height, width = self.picture.shape[:2]
        x, y, ahead = np.moveaxis(rays @ self.to_picture((height, width)).T, -1, 0)
        safe = np.where(ahead > 1e-9, ahead, 1.0)
        column, row = np.rint(x / safe).astype(np.int64), np.rint(y / safe).astype(np.int64)
        hit = (ahead > 1e-9) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return np.where(hit, self.picture[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1), 1], 0.0)


@functools.lru_cache(maxsize=16)
def pixel_rays(camera) -> np.ndarray:
    """Return the unit rays (H, W, 3) float32 of all pixels in the optical frame."""
    step = STEP[camera.model]
    counts = [-(-size // step) + 2 for size in (camera.width, camera.height)]
    # cv2.resize places sample k of the coarse grid at pixel step k + (step - 1) / 2; one more on every side
    positions = [step * np.arange(-1, count - 1) + (step - 1) / 2 for count in counts]
    coarse = lens.unproject(camera, np.stack(np.meshgrid(*positions), axis=-1)).astype(np.float32)
    fine = cv2.resize(coarse, (step * counts[0], step * counts[1]), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(fine[step : step + camera.height, step : step + camera.width])


class View:
    """The image of a camera at an attitude."""

    def __init__(self, camera, r_world_camera):
        self.camera, self.r_world_camera = camera, np.asarray(r_world_camera, dtype=float)
        self.rays = pixel_rays(camera)
        self.focal_px = 0.5 * (camera.fx + camera.fy)
        few = self.rays[::FEW, ::FEW].astype(float)
        self._few_rays = few @ self.r_world_camera.T

    def project(self, points_world):
        """Return pixels (..., 2) and angles (...) rad from the optical axis of points (..., 3) of the world."""
        return lens.project(self.camera, np.asarray(points_world, dtype=float) @ self.r_world_camera)

    def directions(self, pixels):
        """Return unit rays (..., 3) of the world of the pixels of the image that are nearest to pixels (..., 2)."""
        height, width = self.rays.shape[:2]
        x, y = np.moveaxis(np.clip(np.rint(pixels), 0, (width - 1, height - 1)).astype(int), -1, 0)
        return self.rays[y, x].astype(float) @ self.r_world_camera.T

    def draw(self, image, panel: Panel, haze=(0.0, 0.0), light: float = 1.0):
        """Paint a panel over an image (H, W) float32.

        Args:
            image: is changed.
            panel: what to paint.
            haze: share of the light that the water or air in front of the panel adds, and its brightness.
            light: factor of the brightness of what does not shine itself.
        """
        if panel.edge_on:
            return
        if panel.tiled:
            self._draw_tiled(image, panel)
            return
        placed = self._place(panel)
        if placed is None:
            return
        box, picture = placed
        x_y, _ = self._picture_points(panel, picture.shape, box)
        second: Any = None  # not needed with a map of pairs (x, y), which cv2's annotations do not know
        sample = cv2.remap(picture, x_y, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        share, tone = haze
        colour, opacity = cv2.split(sample)
        if light != 1.0:
            colour = np.where(colour > SHINING, colour, np.float32(light) * colour)
        if share > 0.0:
            colour = np.float32(1 - share) * colour + np.float32(share * tone) * opacity
        image[box] += colour - opacity * image[box]

    def _picture_points(self, panel, shape, box):
        """Return the pixels (h, w, 2) of a panel's picture in a box of the image, and the inverse distance (h, w)."""
        matrix = panel.to_picture(shape) @ self.r_world_camera
        x, y, ahead = cv2.split(cv2.transform(self.rays[box], matrix))
        share = 1.0 / np.maximum(ahead, np.float32(BEHIND))  # rays away from the plane miss the picture by far
        points = cv2.merge([x * share, y * share])
        return np.clip(points, -FAR_PX, FAR_PX, out=points), ahead

    def _place(self, panel):
        """Return the box of the image that a panel can cover, and its picture at the resolution of the image."""
        pixels, theta = self.project(panel.outline())
        width, height = self.camera.width, self.camera.height
        if theta.max() > 1.5:  # partly behind the camera: its outline does not enclose its image
            box = self._box(panel.covers(self._few_rays))
            return (box, panel.picture) if box else None
        low = np.floor(pixels.min(axis=0)).astype(int) - 1
        high = np.ceil(pixels.max(axis=0)).astype(int) + 2
        if (high <= 0).any() or low[0] >= width or low[1] >= height:
            return None
        low, high = np.maximum(low, 0), np.minimum(high, (width, height))
        steps = np.linalg.norm(np.diff(pixels, axis=0, append=pixels[:1]), axis=-1).reshape(4, -1).sum(axis=1)
        wanted = max(steps[0], steps[2]), max(steps[1], steps[3])
        return np.s_[low[1] : high[1], low[0] : high[0]], shrunk(panel.picture, wanted)

    def _box(self, hit):
        """Return the box of the image around the hits (h, w) bool of every `FEW`-th ray; None without any."""
        rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
        if not len(rows):
            return None
        (top, bottom), (left, right) = ((FEW * max(k[0] - 1, 0), FEW * (k[-1] + 1)) for k in (rows, columns))
        return np.s_[top:bottom, left:right]

    def _draw_tiled(self, image, panel):
        """Paint a plane of tiles; what is finer than a pixel is replaced by its mean."""
        box = self._box(panel.covers(self._few_rays))
        if box is None:
            return
        picture = panel.picture[..., 0]
        height, width = picture.shape
        points, ahead = self._picture_points(panel, picture.shape, box)
        points *= np.float32([1 / width, 1 / height])
        points -= np.floor(points)
        points *= np.float32([width, height])
        second: Any = None
        sharp = cv2.remap(picture, points, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        small = cv2.resize(picture, (width // COARSER, height // COARSER), interpolation=cv2.INTER_AREA)
        points *= np.float32(1 / COARSER)
        soft = cv2.remap(small, points, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        away = abs(np.cross(panel.right, panel.down) @ panel.centre)
        texel = panel.size[0] / width * self.focal_px * away  # over the squared distance: pixels that a texel covers
        covered = np.float32(2.0 * texel) * ahead * ahead
        mean = np.float32(picture.mean())
        sharp = soft + np.minimum(covered, 1.0) * (sharp - soft)
        tone = mean + np.minimum(COARSER * covered, 1.0) * (sharp - mean)
        np.copyto(image[box], tone, where=ahead > 1e-3)


def shrunk(picture, wanted):
    """Return a picture with at most as many columns and rows as wanted, by the mean over areas."""
    height, width = picture.shape[:2]
    columns, rows = (max(1, min(size, int(np.ceil(most)))) for size, most in zip((width, height), wanted, strict=True))
    if columns > 0.85 * width and rows > 0.85 * height:
        return picture
    return cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)


def upright_panel(centre, yaw: float, size, picture, **options) -> Panel:
    """Return a vertical panel.

    Args:
        centre: (3,) m.
        yaw: rad, direction from the camera's side through the panel, in the world.
        size: (2,) m.
        picture: (h, w, 2).
        options: of `Panel`.
    """
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    return Panel(np.asarray(centre, dtype=float), right, np.array([0.0, 0.0, -1.0]), size, picture, **options)


def opaque(tone) -> np.ndarray:
    """Return the picture (h, w, 2) of brightnesses (h, w)."""
    return cv2.merge([np.asarray(tone, np.float32), np.ones(tone.shape, np.float32)])


def with_opacity(tone, opacity) -> np.ndarray:
    """Return the picture (h, w, 2) of brightnesses and opacities (h, w)."""
    opacity = np.asarray(opacity, np.float32)
    return cv2.merge([np.asarray(tone, np.float32) * opacity, opacity])
