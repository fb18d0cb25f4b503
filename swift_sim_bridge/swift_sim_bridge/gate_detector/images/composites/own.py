"""The user's gates in space.

A gate of triangles is drawn as seen from the camera, on the plane of its opening: a camera sees a body and its central
projection on a plane alike. So a mesh is one more panel, with the lens, light and blur of all.
"""

from typing import NamedTuple

import numpy as np

from swift_sim_bridge.gate_detector.corner_states import BORDER_PX, HIDDEN, IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.images.composites import frames, gates, scenes
from swift_sim_bridge.gate_detector.images.composites.objects import Body
from swift_sim_bridge.gate_detector.images.composites.panels import Panel, with_opacity
from swift_sim_bridge.gate_detector.images.own_gates.opening import MeshGate
from swift_sim_bridge.gate_detector.images.own_gates.picture import PictureGate
from swift_sim_bridge.gate_detector.images.own_gates.raster import Raster, rasterise

FINER = 1.6  # pixels of a gate's picture in one of the image
LEAST_COSINE = 0.2  # between line of sight and normal; a gate of triangles that is seen more obliquely faces the camera
NEAREST = 0.4  # distance of a part from the camera's plane over that of the opening; nearer parts are left out
SHADE = (0.05, 0.6)  # light on a surface that faces away from the lamp, of that on one that faces it
BEFORE = 0.01  # in heights of the opening: a surface so much nearer than a corner is before it
ON_EDGE_PX = 1.0  # a corner that a part of the gate covers by less is still found


class Place(NamedTuple):
    """Where a gate stands.

    Attributes:
        centre: (3,) m.
        side: height of the opening, m.
        side_px: the same in the image, px.
    """

    centre: np.ndarray
    side: float
    side_px: float


def body(own: PictureGate | MeshGate, place: Place, looks, paints, rng) -> Body:
    """Return a gate of the user at a place, turned at random."""
    directions = gates.axes(place.centre, looks, rng)
    if isinstance(own, MeshGate):
        return of_mesh(own if rng.random() < 0.5 else own.turned(), place, directions, paints, rng)
    return gates.body(face(own, place.side, paints), place.centre, directions, looks, rng)


def face(own: PictureGate, side: float, paints) -> frames.Face:
    """Return the face of a picture whose opening has a height in m."""
    _, y0, _, y1 = own.opening
    scale = side / (y1 - y0)
    opacity = own.picture[..., 3].astype(np.float32) / 255
    tone = paints.grey(own.picture)
    layout = frames.Plan(opacity.shape, [own.opening], [], (scale, scale))
    return frames.Face(with_opacity(tone, opacity), frames.size(layout), frames.corners(layout), float(tone.mean()))


def of_mesh(gate: MeshGate, place: Place, directions, paints, rng) -> Body:
    """Return a gate of triangles at a place.

    Its corners are those of the opening in the plane of the rim that faces the camera, as of other thick gates: there
    the depth of the frame hides none of them, however oblique the gate is.

    Args:
        gate: to be seen from its front.
        place: of the centre of that opening.
        directions: to the right and down, see `gates.axes`.
        paints: of the image.
        rng: generator.
    """
    towards = place.centre / np.linalg.norm(place.centre)
    right, down = directions
    cosine = float(np.cross(right, down) @ towards)
    if cosine < LEAST_COSINE:
        right, down = _facing(towards)
        cosine = float(np.cross(right, down) @ towards)
    axes = np.stack([right, down, np.cross(right, down)])
    camera = -(axes @ place.centre) / place.side  # in the axes and the unit of the gate

    middle, size = (gate.low + gate.high) / 2, gate.high - gate.low
    shape = gate.silhouette.astype(np.float32)
    front = _panel((right, down), place, middle, size, with_opacity(shape, shape))
    picture = Projected(gate, camera, FINER * place.side_px * np.array([cosine, 1.0]))
    painted = picture.painted(paints, rng)
    painted = painted if rng.random() < 0.6 else scenes.with_shadow(painted, rng)
    seen = _panel((right, down), place, picture.middle, picture.size, painted)
    corners = gate.corners()
    openings = place.centre + place.side * (corners[:, :1] * right + corners[:, 1:] * down)
    states = picture.states(corners, 1.0 / (place.side_px * np.array([cosine, 1.0])))
    return Body(float(np.linalg.norm(place.centre)), (seen,), front, openings[None], states[None])


def _facing(towards) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions to the right and down (3,) of an upright gate that faces a direction (3,)."""
    right = np.cross(towards, (0.0, 0.0, 1.0))
    return right / np.linalg.norm(right), np.array([0.0, 0.0, -1.0])


def _panel(directions, place: Place, middle, size, picture) -> Panel:
    """Return a panel in the plane of an opening; its middle and size (2,) are in heights of the opening."""
    right, down = directions
    centre = place.centre + place.side * (middle[0] * right + middle[1] * down)
    return Panel(centre, right, down, (float(place.side * size[0]), float(place.side * size[1])), picture)


class Projected:
    """A gate of triangles as seen from a camera, on the plane of its opening.

    Args:
        gate: to be seen.
        camera: (3,), its place in the axes and the unit of the gate, before it.
        scale: (2,), px in a height of the opening to the right and down, where the picture does not become too large.
    """

    def __init__(self, gate: MeshGate, camera, scale):
        self._mesh, self._camera = gate.mesh, camera
        away = gate.mesh.triangles[..., 2] - camera[2]
        self._kept = np.flatnonzero((away > -NEAREST * camera[2]).all(axis=1))
        corners = gate.mesh.triangles[self._kept]
        enlarged = -camera[2] / away[self._kept]  # by the projection; also the inverse distance of what is projected
        points = camera[:2] + (corners[..., :2] - camera[:2]) * enlarged[..., None]
        low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
        limits = frames.MAX_PICTURE_PX / (high - low)
        scale = np.minimum(np.clip(scale, None, frames.MAX_PX), limits)
        columns, rows = (int(np.ceil(side)) + 2 for side in scale * (high - low))
        self.middle, self.size = (low + high) / 2, np.array([columns, rows]) / scale
        self._scale, self._origin = scale, self.middle - 0.5 * np.array([columns - 1, rows - 1]) / scale
        self._seen: Raster = rasterise(scale * (points - self._origin), enlarged, (rows, columns))

    def painted(self, paints, rng) -> np.ndarray:
        """Return the picture (h, w, 2), see `Panel`, with the colours of the gate in random light."""
        mesh, kept, nearest = self._mesh, self._kept, self._seen.nearest
        tones = np.where(mesh.coloured[kept], paints.grey(mesh.colours[kept][:, None])[:, 0], paints.tone())
        tone = tones.astype(np.float32)[nearest]
        texture = mesh.texture[kept][nearest]
        for k, picture in enumerate(mesh.textures):
            rows, columns = np.nonzero((texture == k) & (nearest >= 0))
            if len(rows):
                weights = self._seen.weights(rows, columns)
                texels = np.einsum("mk,mkc->mc", weights, mesh.texels[kept][nearest[rows, columns]])
                tone[rows, columns] = _sampled(paints.grey(picture), texels)
        shade = self._shades(rng)[nearest]
        return with_opacity(tone * shade, nearest >= 0)

    def _shades(self, rng) -> np.ndarray:
        """Return the light (n,) float32 on triangles, of a lamp or the sun above the gate or to the side."""
        corners = self._mesh.triangles[self._kept]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        seen_side = np.sign(np.sum(normal * (self._camera - corners[:, 0]), axis=-1))
        lamp = rng.normal(0, 1, 3)
        lamp[1] = -abs(lamp[1])
        # from 1 towards the lamp to 0 away from it: all sides of a frame differ, as they do in light from all around
        facing = 0.5 + 0.5 * seen_side * (normal @ (lamp / np.linalg.norm(lamp)))
        around = rng.uniform(*SHADE)
        return (around + (1 - around) * facing).astype(np.float32)

    def states(self, corners, px) -> np.ndarray:
        """Return the states (4,) of the corners (4, 2) of the opening behind parts of the gate.

        A corner lies on the gate. So the places beside it that count are in the opening, and what covers them is before
        the opening's plane.

        Args:
            corners: TL, TR, BR, BL to the right of and below the centre of the opening.
            px: (2,), width and height of a pixel of the image on that plane.
        """
        height, width = self._seen.nearest.shape
        reach = px * np.array([ON_EDGE_PX, BORDER_PX])[:, None, None]
        places = self._scale * (corners - reach * np.sign(corners) - self._origin)
        columns, rows = np.moveaxis(np.clip(np.rint(places), 0, (width - 1, height - 1)).astype(int), -1, 0)
        behind = self._seen.nearness[rows, columns] * (1 + BEFORE / self._camera[2]) > 1.0
        return np.where(behind.all(axis=0), HIDDEN, np.where(behind.any(axis=0), IGNORED, VISIBLE))


def _sampled(tone, texels) -> np.ndarray:
    """Return the brightness (m,) of a texture (h, w) at its pixels (m, 2); it is repeated beyond its edges."""
    height, width = tone.shape
    columns, rows = np.mod(np.rint(texels).astype(int), (width, height)).T
    return tone[rows, columns]
