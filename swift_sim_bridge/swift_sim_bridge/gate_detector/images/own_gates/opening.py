"""The opening of a gate of triangles: passage, corners and rim."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.images.own_gates import mesh as meshes
from swift_sim_bridge.gate_detector.images.own_gates.raster import rasterise

SIDE_PX, BORDER_PX = 512, 4  # longer side of the frontal view, and the space around it
SEALED_PX = 3  # slits narrower than this between the parts of a frame are closed
LEAST_SIDE = 0.2  # of an opening in heights of the mesh; smaller holes are those of a truss
MOST_ASPECT = 1.6  # longer over shorter side of an opening
LEAST_FILLED = 0.7  # share of the opening within its corners; 0.64 in a circle, 0.6 in an octagon
LEAST_OTHER = 0.7  # side of a second hole over that of the opening, from which both could be the opening
SNAP_PX = 1.5  # an edge of the opening this near to a corner of a triangle lies there
AXES = {  # rows: right, down, away, as seen along the passage, of a mesh with z up
    "x": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


@dataclass(frozen=True, eq=False)
class MeshGate:
    """A gate of triangles. Unit of length is the height of its opening.

    Attributes:
        mesh: in the axes right, down, away of a viewer before the gate, from the centre of the opening, and from the
            plane of the rim that faces the viewer.
        width: of the opening.
        depth: of the rim: distance between the plane that faces the viewer and the one that faces away.
        low, high: (2,), corners of the frontal view.
        silhouette: (h, w) bool, where the frontal view is covered.
    """

    mesh: meshes.Mesh
    width: float
    depth: float
    low: np.ndarray
    high: np.ndarray
    silhouette: np.ndarray

    def corners(self) -> np.ndarray:
        """Return the corners (4, 2) of the opening, TL, TR, BR, BL, to the right of and below its centre."""
        return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (0.5 * self.width, 0.5)

    def turned(self) -> "MeshGate":
        """Return the gate seen from its other side."""
        triangles = self.mesh.triangles * (-1.0, 1.0, -1.0) + (0.0, 0.0, self.depth)
        low, high = (np.array([-a[0], b[1]]) for a, b in ((self.high, self.low), (self.low, self.high)))
        mesh = replace(self.mesh, triangles=triangles)
        return replace(self, mesh=mesh, low=low, high=high, silhouette=self.silhouette[:, ::-1])


@dataclass(frozen=True)
class _Front:
    """The frontal view of a mesh: `pixels = scale * (point - origin)`.

    Attributes:
        covered: (h, w) uint8, 1 where the gate is, with slits closed.
        distance: (2, h, w), of the nearest and of the farthest surface from the viewer; not finite where there is none.
        origin: (2,), right and down.
        scale: px in a unit of length.
    """

    covered: np.ndarray
    distance: np.ndarray
    origin: np.ndarray
    scale: float


def read(path: Path) -> MeshGate:
    """Return the gate of a mesh file; z points up, in glTF y. Raises UsageError when it is none."""
    mesh = meshes.read(path)
    size = np.ptp(mesh.triangles.reshape(-1, 3), axis=0)
    for axis in sorted(AXES, key=lambda axis: size["xyz".index(axis)]):
        turned = replace(mesh, triangles=mesh.triangles @ AXES[axis].T)
        front = _front(turned.triangles)
        box = _largest_hole(front.covered)
        if box and box[3] - box[1] >= LEAST_SIDE * front.scale * size[2]:
            return _gate(path, turned, front, box)
    raise UsageError(
        f"{path} has no opening, seen along its horizontal axes; a gate stands upright with z up (in .glb and .gltf "
        "y), and its frame is closed around the opening"
    )


def _front(triangles) -> _Front:
    """Return the frontal view of triangles (n, 3, 3) right, down, away."""
    points = triangles[..., :2].reshape(-1, 2)
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    scale = SIDE_PX / max(size.max(), 1e-300)
    origin = low - BORDER_PX / scale
    shape = tuple(int(np.ceil(scale * side)) + 2 * BORDER_PX for side in size[::-1])
    pixels, away = scale * (triangles[..., :2] - origin), triangles[..., 2]
    distance = np.stack([-rasterise(pixels, -away, shape).nearness, rasterise(pixels, away, shape).nearness])
    covered = np.isfinite(distance[0]).astype(np.uint8)
    covered = cv2.morphologyEx(covered, cv2.MORPH_CLOSE, np.ones((SEALED_PX, SEALED_PX), np.uint8))
    return _Front(covered, distance, origin, scale)


def _largest_hole(covered) -> tuple[int, int, int, int] | None:
    """Return the largest upright rectangle (x0, y0, x1, y1) px in a hole of a silhouette (h, w), end exclusive."""
    open_, found = 1 - covered, None
    cv2.floodFill(open_, None, (0, 0), 0)  # what is around the gate; a border is open on all sides
    reach = cv2.distanceTransform(open_, cv2.DIST_C, 3)
    if reach.max() >= 2:
        y, x = np.unravel_index(np.argmax(reach), reach.shape)
        half = int(reach[y, x]) - 1
        found = _grown(open_, (int(x) - half, int(y) - half, int(x) + half + 1, int(y) + half + 1))
    return found


def _without(covered, box) -> np.ndarray:
    """Return a silhouette (h, w) with the hole around a box px filled."""
    x0, y0, x1, y1 = box
    filled = covered.copy()
    cv2.floodFill(filled, None, ((x0 + x1) // 2, (y0 + y1) // 2), 1)
    return filled


def _side(box) -> int:
    """Return the shorter side of a box px, 0 without a box."""
    return min(box[2] - box[0], box[3] - box[1]) if box else 0


def _grown(open_, box) -> tuple[int, int, int, int]:
    """Return a box in an area (h, w), moved outwards at each side as far as the whole side is in the area."""
    x0, y0, x1, y1 = box
    x0 -= _run(open_[y0:y1, :x0].all(axis=0)[::-1])
    x1 += _run(open_[y0:y1, x1:].all(axis=0))
    y0 -= _run(open_[:y0, x0:x1].all(axis=1)[::-1])
    y1 += _run(open_[y1:, x0:x1].all(axis=1))
    return x0, y0, x1, y1


def _run(flags) -> int:
    """Return how many flags are set before the first that is not; the last one never is."""
    return int(np.argmin(flags))


def _gate(path: Path, mesh: meshes.Mesh, front: _Front, box) -> MeshGate:
    """Return the gate of a mesh right, down, away with its opening in a box px of the frontal view."""
    x0, y0, x1, y1 = box
    wide, tall = x1 - x0, y1 - y0
    _, areas = cv2.connectedComponents((1 - front.covered).astype(np.uint8), connectivity=4)
    filled = wide * tall / np.count_nonzero(areas == areas[(y0 + y1) // 2, (x0 + x1) // 2])
    if max(wide, tall) > MOST_ASPECT * min(wide, tall) or filled < LEAST_FILLED:
        raise UsageError(
            f"{path} has an opening that is far from square: {wide / tall:.2f} times as wide as high, "
            f"{100 * filled:.0f} % of it within its corners; give a gate with a ratio of sides below {MOST_ASPECT:g} "
            f"and at least {100 * LEAST_FILLED:.0f} %, which a round one has not"
        )
    if _side(_largest_hole(_without(front.covered, box))) > LEAST_OTHER * _side(box):
        raise UsageError(
            f"{path} has two openings of similar size, of which one may be that of its stand; give a mesh with one, "
            "as by removing the stand or dividing the mesh"
        )
    edges = np.array([[x0, y0], [x1, y1]]) - 0.5
    edges = _snapped(front.origin + edges / front.scale, mesh.triangles, SNAP_PX / front.scale)
    near, far = (_rim(distance, box) for distance in front.distance)
    unit, middle = edges[1, 1] - edges[0, 1], np.array([*edges.mean(axis=0), near])
    triangles = (mesh.triangles - middle) / unit
    size = np.array(front.covered.shape[::-1]) / front.scale
    low = (front.origin - 0.5 / front.scale - middle[:2]) / unit
    return MeshGate(
        mesh=replace(mesh, triangles=triangles),
        width=float((edges[1, 0] - edges[0, 0]) / unit),
        depth=float((far - near) / unit),
        low=low,
        high=low + size / unit,
        silhouette=front.covered.astype(bool),
    )


def _snapped(edges, triangles, reach: float) -> np.ndarray:
    """Return edges (2, 2) right and down, moved to the nearest corner of a triangle where one is within reach."""
    corners = triangles[..., :2].reshape(-1, 2)
    nearest = np.take_along_axis(corners, np.abs(corners[:, None] - edges).argmin(axis=0), axis=0)
    return np.where(np.abs(nearest - edges) < reach, nearest, edges)


def _rim(distance, box) -> float:
    """Return the distance of the rim: the median of distances (h, w) next to the opening in a box px."""
    x0, y0, x1, y1 = box
    around = distance[y0 - 2 : y1 + 2, x0 - 2 : x1 + 2].copy()
    around[2:-2, 2:-2] = np.inf
    return float(np.median(around[np.isfinite(around)]))
