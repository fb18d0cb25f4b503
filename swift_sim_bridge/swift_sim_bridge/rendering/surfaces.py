"""What the rays of an image see: walls, and flat rectangles before them, in closed form, from far to near.

Edges are anti-aliased over the width of a pixel. Textures fade where a pixel covers many texels, since there are no mip
maps. Most rays meet no plate. So one program computes the walls for all rays, and which rays pass near a plate; a
second one computes the plates for these, batch by batch.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.scene import Plates, Scene

BATCH = 8192  # rays near plates that are computed at once: arrays of this length stay in the cache
NEAR_PX = 1  # pixels around a plate's edges that still belong to it: edges are ramps, half a pixel to each side
PARALLEL = 1e-3  # sine of the angle below which a ray counts as parallel to a plate


class Rays(NamedTuple):
    """The rays of the pixels inside the image circle.

    Attributes:
        directions: (3, n), unit vectors in the optical frame.
        radius: (n,), distance from the axis as a share of the circle's radius.
        drift: (3, n) m, offset of each ray's origin from the optical centre (rolling shutter); None: no offset.
    """

    directions: jnp.ndarray
    radius: jnp.ndarray
    drift: jnp.ndarray | None = None


class _View(NamedTuple):
    """Rays in the world.

    Attributes:
        origin: (3,) m, or (3, n) for rays with origins of their own.
        ray: [x, y, z] (n,), unit vectors.
    """

    origin: jnp.ndarray
    ray: list


class _Crossing(NamedTuple):
    """Where rays cross the plane of a plate.

    Attributes:
        across: [left, up] (n,), components of the rays along the plate's sides.
        slope: (n,), component along its normal, never zero.
        reach: (n,) m, distance along the ray.
        place: [left, up] (n,) m, from the plate's centre.
        pixel: m, width of a pixel on the plate if it were seen head-on; (n,) for rays with origins of their own.
    """

    across: list
    slope: jnp.ndarray
    reach: jnp.ndarray
    place: list
    pixel: jnp.ndarray


def add_brightness(total, stack, scene: Scene, pose, rays: Rays, pixel_angle: float):
    """Return `total` (n,) plus the linear brightness of what rays see from one camera pose.

    Args:
        total: (n,).
        stack: textures, flat, uint8.
        scene: what is seen.
        pose: origin (3,) m in the world, and R_world_camera (3, 3).
        rays: of the pixels.
        pixel_angle: rad between neighbouring pixels.
    """
    brighter, near = _add_walls(total, stack, scene, pose, rays, pixel_angle)
    for batch in _batches(np.flatnonzero(near)):
        brighter = _add_plates((total, brighter), batch, stack, scene, (pose, rays), pixel_angle)
    return brighter


def _batches(chosen) -> np.ndarray:
    """Return indices of rays in rows of BATCH; the last ray is repeated to fill the last row.

    There is at least one row, so that the first image compiles the program for plates even where it shows none.
    """
    count = max(1, -(-len(chosen) // BATCH))
    padding = np.full(count * BATCH - len(chosen), chosen[-1] if len(chosen) else 0)
    return np.concatenate([chosen, padding]).astype(np.int32).reshape(count, BATCH)


@partial(jax.jit, static_argnames=("pixel_angle",))
def _add_walls(total, stack, scene: Scene, pose, rays: Rays, pixel_angle):
    """Return `total` (n,) plus the brightness of the walls, and which rays (n,) may meet a plate."""
    plates, view = _in_world(scene.plates, pose, rays)
    _, wall = _surroundings(scene.room, view, pixel_angle)
    return total + _value(stack, _texel(*wall[:3]), *wall[3:]), _near_plates(plates, view, pixel_angle)


@partial(jax.jit, static_argnames=("pixel_angle",))
def _add_plates(sums, batch, stack, scene: Scene, camera: tuple, pixel_angle):
    """Return the brightness (n,) after a pose, corrected at the indices `batch` of rays that may meet a plate.

    `sums` is the brightness before the pose and that with the walls alone, `camera` the pose and its rays.
    """
    (total, brighter), (pose, rays) = sums, camera
    plates, view = _in_world(scene.plates, pose, jax.tree.map(lambda values: values[..., batch], rays))
    distance, wall = _surroundings(scene.room, view, pixel_angle)
    front, behind, cover = _layers(_covers(plates, view, distance, pixel_angle), distance)
    front, behind = (_surface(plates, scene.room, view, layer, wall, pixel_angle) for layer in (front, behind))
    light = cover * _value(stack, *front) + (1 - cover) * _value(stack, *behind)
    return brighter.at[batch].set(total[batch] + light)


def _near_plates(plates: Plates, view: _View, pixel_angle):
    """Return which rays (n,) go towards a plate's plane and pass its surface, not its opening, within NEAR_PX pixels.

    Lengths on the plate are multiplied by the square of the slope: divisions would take half of the time.
    """
    near = jnp.zeros(view.ray[0].shape, bool)
    for plate in _rows(plates):
        (height, *offset), (slope, *across) = _in_plate(plate, view)
        squared, margin = slope**2, NEAR_PX * _pixel(height, pixel_angle)
        place = [jnp.abs((start * slope - height * axis) * slope) for start, axis in zip(offset, across, strict=True)]
        left, up = (place[i] - plate.half_outer[i] * squared < margin for i in range(2))
        hole_left, hole_up = (plate.half_inner[i] * squared - place[i] > margin for i in range(2))
        ahead = height * slope < PARALLEL * jnp.abs(height)
        near = near | (ahead & left & up & ~(hole_left & hole_up))
    return near


def _in_world(plates: Plates, pose, rays: Rays):
    """Return the plates from far to near, and the rays in the world."""
    centre, rotation = pose
    origin = centre if rays.drift is None else centre[:, None] + rays.drift
    order = jnp.argsort(-jnp.sum((plates.centre - centre) ** 2, axis=-1))
    x, y, z = rays.directions
    ray = [x * rotation[i, 0] + y * rotation[i, 1] + z * rotation[i, 2] for i in range(3)]
    return jax.tree.map(lambda leaf: leaf[order], plates), _View(origin, ray)


def _dot(vector, direction):
    """Return the dot product of two vectors given by their components."""
    return vector[0] * direction[0] + vector[1] * direction[1] + vector[2] * direction[2]


def _surroundings(room, view: _View, pixel_angle):
    """Return the distance (n,) at which each ray meets a side of the room, and the surface there (see `_value`)."""
    origin, ray = view
    far = [
        jnp.where(ray[i] > 0, room.high[i] - origin[i], room.low[i] - origin[i])
        / jnp.where(jnp.abs(ray[i]) < 1e-6, 1e-6, ray[i])
        for i in range(3)
    ]
    far = [jnp.where(f < 0, jnp.float32(1e6), f) for f in far]
    on_x = (far[0] <= far[1]) & (far[0] <= far[2])
    on_y = ~on_x & (far[1] <= far[2])
    distance = jnp.where(on_x, far[0], jnp.where(on_y, far[1], far[2]))
    point = [origin[i] + distance * ray[i] for i in range(3)]

    def of_side(values):
        x, y, z = (jnp.where(ray[i] > 0, values[2 * i + 1], values[2 * i]) for i in range(3))
        return jnp.where(on_x, x, jnp.where(on_y, y, z))

    across = jnp.where(on_x, point[1], point[0])
    up = jnp.where(on_x | on_y, point[2], point[1])
    facing = jnp.where(on_x, jnp.abs(ray[0]), jnp.where(on_y, jnp.abs(ray[1]), jnp.abs(ray[2])))
    light = jnp.clip(1 + _dot(room.gradient, point), 0.3, 2.0)
    per_metre = 1 / of_side(room.tile)
    texels = distance * pixel_angle * per_metre / jnp.maximum(facing, 0.05)
    surface = (of_side(room.texture), across * per_metre, up * per_metre, texels)
    return distance, (*surface, of_side(room.tone) * light, of_side(room.contrast) * light)


def _rows(plates: Plates):
    """Return the plates one by one."""
    return [jax.tree.map(lambda leaf, k=row: leaf[k], plates) for row in range(plates.centre.shape[0])]


def _in_plate(plate, view: _View):
    """Return the origin (m, from the plate's centre) and the direction (n,) of rays along its normal, left and up."""
    origin, ray = view
    offset = origin - (plate.centre if origin.ndim == 1 else plate.centre[:, None])
    return tuple([_dot(plate.rotation[:, i], vector) for i in range(3)] for vector in (offset, ray))


def _pixel(height, pixel_angle):
    """Return the width of a pixel, m, on a plate that is seen head-on from `height` m."""
    return (jnp.abs(height) + 1e-6) * pixel_angle


def _crossing(plate, view: _View, pixel_angle) -> _Crossing:
    (height, *offset), (slope, *across) = _in_plate(plate, view)
    slope = jnp.where(jnp.abs(slope) < 1e-4, 1e-4, slope)
    reach = -height / slope
    place = [start + reach * axis for start, axis in zip(offset, across, strict=True)]
    return _Crossing(across, slope, reach, place, _pixel(height, pixel_angle))


def _inside(half, place, sharpness):
    """Return the share (n,) of a pixel within a rectangle; its edges are ramps one pixel (1 / sharpness, m) wide."""
    across = jnp.clip((half[0] - jnp.abs(place[0])) * sharpness[0] + 0.5, 0, 1)
    return across * jnp.clip((half[1] - jnp.abs(place[1])) * sharpness[1] + 0.5, 0, 1)


def _covers(plates: Plates, view: _View, distance, pixel_angle):
    """Return for each plate the share (n,) of each pixel that it covers alone, and its distance (n,) m along the ray.

    Args:
        plates: in any order.
        view: of the rays.
        distance: (n,) m, of the walls.
        pixel_angle: rad between neighbouring pixels.
    """
    covers = []
    for plate in _rows(plates):
        across, slope, reach, place, pixel = _crossing(plate, view, pixel_angle)
        sharpness = [slope**2 * jax.lax.rsqrt(slope**2 + axis**2) / pixel for axis in across]
        share = _inside(plate.half_outer, place, sharpness) - _inside(plate.half_inner, place, sharpness)
        covers.append((jnp.where((reach > 0.05) & (reach < distance), share, 0), reach))
    return covers


def _layers(covers, distance):
    """Return the plates (n,) in front and behind it as rows, -1 for the walls, and the share (n,) of that in front."""
    front = behind = jnp.full(distance.shape, -1, jnp.int8)
    cover, nearest = jnp.zeros_like(distance), distance
    for row, (share, reach) in enumerate(covers):
        covered = cover > 0.5
        visible = (share > 0) & ~(covered & (reach > nearest))
        behind = jnp.where(visible & covered, front, behind)
        front = jnp.where(visible, jnp.int8(row), front)
        cover, nearest = jnp.where(visible, share, cover), jnp.where(visible, reach, nearest)
    return front, behind, cover


def _surface(plates: Plates, room, view: _View, layer, wall, pixel_angle):
    """Return the surface that each ray sees: (texel, texels per pixel, tone, contrast), see `_value`.

    Args:
        plates: by row.
        room: whose light falls on them.
        view: of the rays.
        layer: (n,), row of the plate that is seen, -1: the walls.
        wall: (texture, tiles across, tiles up, texels per pixel, tone, contrast) of the walls.
        pixel_angle: rad between neighbouring pixels.
    """
    surface = wall
    for row, plate in enumerate(_rows(plates)):
        crossing = _crossing(plate, view, pixel_angle)
        scale = 0.5 / (jnp.maximum(plate.half_outer[0], plate.half_outer[1]) + 1e-3)
        light = 1 + _dot(room.gradient, plate.centre)
        texels = crossing.pixel * scale / crossing.slope**2
        across, up = (place * scale for place in crossing.place)
        here = (plate.texture, across, up, texels, plate.tone * light, plate.contrast * light)
        surface = tuple(jnp.where(layer == row, new, old) for new, old in zip(here, surface, strict=True))
    return (_texel(*surface[:3]), *surface[3:])


def _texel(texture, across, up):
    """Return the index (n,) of texels in the flat texture stack; `across` and `up` are measured in tiles."""
    side = textures.SIDE
    column = jnp.floor((across - jnp.floor(across)) * side).astype(jnp.int32)
    row = jnp.floor((up - jnp.floor(up)) * side).astype(jnp.int32)
    return (texture * side + side - 1 - jnp.minimum(row, side - 1)) * side + jnp.minimum(column, side - 1)


def _value(stack, texel, texels, tone, contrast):
    """Return the brightness (n,): tone plus texture; contrast fades with the tiles `texels` that a pixel covers."""
    blur = texels * (textures.SIDE / 4)
    return tone + contrast / (1 + blur * blur) * (stack[texel].astype(jnp.float32) / 255 - 0.5)
