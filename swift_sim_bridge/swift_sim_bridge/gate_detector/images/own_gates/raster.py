"""Triangles on a raster: which of them is the nearest one at each pixel."""

from dataclasses import dataclass

import numpy as np

LEAST_AREA = 1e-9  # px^2; a smaller triangle is seen edge-on
CLOSED = 1e-3  # px by which triangles are wider, so that no gap opens between two with a common edge


@dataclass(frozen=True)
class Raster:
    """What is seen of triangles.

    Attributes:
        nearest: (h, w), index of the nearest triangle, -1 where there is none.
        nearness: (h, w) float32, of that triangle, -inf where there is none.
        planes: (n, 3, 3), of each triangle: its three shares are `planes @ (x, y, 1)`; share k is 1 in corner k.
        corners: (n, 3), nearness of the corners.
    """

    nearest: np.ndarray
    nearness: np.ndarray
    planes: np.ndarray
    corners: np.ndarray

    def weights(self, rows, columns) -> np.ndarray:
        """Return the weights (m, 3) of the corners of what is seen at pixels; nearness is an inverse distance.

        The weights are those in space, where the middle of an oblique triangle is not the middle of its image.
        """
        index = self.nearest[rows, columns]
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
        shares = np.einsum("mij,mj->mi", self.planes[index], pixels) * self.corners[index]
        return shares / shares.sum(axis=-1, keepdims=True)


def rasterise(points, nearness, shape) -> Raster:
    """Return what is seen of triangles.

    Args:
        points: (n, 3, 2) px.
        nearness: (n, 3), linear over the image, such as an inverse distance.
        shape: (h, w).
    """
    height, width = shape
    planes = _planes(points)
    triangles, rows = _rows(points, planes, height)
    first, last = _span(planes[triangles], rows, width)
    counts = np.maximum(last - first + 1, 0)
    slope = np.einsum("nij,ni->nj", planes, nearness)  # nearness = slope @ (x, y, 1)
    start = slope[triangles, 0] * first + slope[triangles, 1] * rows + slope[triangles, 2]
    along = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    pixels = np.repeat(rows * width + first, counts) + along
    values = (np.repeat(start, counts) + np.repeat(slope[triangles, 0], counts) * along).astype(np.float32)

    seen = np.full(height * width, -np.inf, np.float32)
    np.maximum.at(seen, pixels, values)
    front = values == seen[pixels]
    nearest = np.full(height * width, -1, np.int64)
    nearest[pixels[front]] = np.repeat(triangles, counts)[front]
    return Raster(nearest.reshape(shape), seen.reshape(shape), planes, nearness)


def _planes(points) -> np.ndarray:
    """Return the coefficients (n, 3, 3) of the shares of the corners of triangles (n, 3, 2); NaN when edge-on."""
    a, b = np.roll(points, -1, axis=1), np.roll(points, -2, axis=1)
    coefficients = np.stack(
        [a[..., 1] - b[..., 1], b[..., 0] - a[..., 0], a[..., 0] * b[..., 1] - b[..., 0] * a[..., 1]]
    )
    area = coefficients[2].sum(axis=-1)
    area = np.where(np.abs(area) < LEAST_AREA, np.nan, area)
    return np.moveaxis(coefficients / area[:, None], 0, -1)


def _rows(points, planes, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return triangle and row of all pairs that meet, in the order of the triangles."""
    low = np.maximum(np.ceil(points[..., 1].min(axis=1) - CLOSED), 0).astype(np.int64)
    high = np.minimum(np.floor(points[..., 1].max(axis=1) + CLOSED), height - 1).astype(np.int64)
    counts = np.where(np.isfinite(planes[:, 0, 0]), np.maximum(high - low + 1, 0), 0)
    triangles = np.repeat(np.arange(len(points)), counts)
    return triangles, np.arange(counts.sum()) + np.repeat(low - (np.cumsum(counts) - counts), counts)


def _span(planes, rows, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last column (m,) of triangles with planes (m, 3, 3) in rows (m,)."""
    slope = planes[..., 0]
    level = np.abs(slope) < 1e-12  # a horizontal edge, which bounds rows and no columns
    zero = -(planes[..., 1] * rows[:, None] + planes[..., 2]) / np.where(level, 1.0, slope)
    first = np.where(level | (slope < 0), -1.0, zero).max(axis=-1) - CLOSED
    last = np.where(level | (slope > 0), float(width), zero).min(axis=-1) + CLOSED
    first, last = np.clip(np.ceil(first), 0, width), np.clip(np.floor(last), -1, width - 1)
    return first.astype(np.int64), last.astype(np.int64)
