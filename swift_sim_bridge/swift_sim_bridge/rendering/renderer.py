"""Grey fisheye images by ray casting: one ray a pixel, flat objects in closed form, painted from far to near.

Edges are covered softly by the pixel's footprint; textures fade where a pixel covers many texels (there are no mip
maps); motion blur is the mean over poses spread evenly over the exposure, which is centred on the image's stamp. A
gate is a plane (its 0.1 m of depth is not drawn) and looks the same from both sides.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.scene import Looks, Scene
from swift_sim_bridge.sensors.camera import ImageErrors, RayBender

NOISE_SIDE = 521  # samples of noise drawn once, longer than an image, entered at a random place for each


def pixel_rays(camera):
    """Return (inside, rays, radius) of a camera: inside (H, W) bool, the pixels within the image circle; their unit
    rays (n, 3) in the optical frame; their distance (n,) from the axis as a share of the circle's radius."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = lens.unproject(camera, np.stack([u, v], axis=-1).astype(float))
    theta = np.arccos(np.clip(rays[..., 2], -1, 1))
    inside = theta <= camera.half_angle
    radius = theta[inside] / camera.half_angle
    return inside, rays[inside].astype(np.float32), radius.astype(np.float32)


def poses_needed(camera, v_world, omega_body, most: int) -> int:
    """Return how many poses show the blur of a motion without gaps: one every 2 px of smear, things taken 4 m away."""
    smear = camera.exposure_s * (np.linalg.norm(omega_body) + np.linalg.norm(v_world) / 4) * camera.fx
    return int(np.clip(np.ceil(smear / 2), 1, most))


def blur_poses(camera, p_world, q_world_body, v_world, omega_body, count: int):
    """Return optical centres (count, 3) and R_world_camera (count, 3, 3), spread over the exposure about its middle."""
    times = ((np.arange(count) + 0.5) / count - 0.5) * camera.exposure_s
    q = geometry.normalize(np.asarray(q_world_body, dtype=float))
    turn = geometry.quaternion_from_rotation_vector(times[:, None] * np.asarray(omega_body, dtype=float))
    q_world_bodies = geometry.quaternion_multiply(np.broadcast_to(q, (count, 4)), turn)
    p_world_bodies = np.asarray(p_world) + times[:, None] * np.asarray(v_world)
    centres = p_world_bodies + geometry.rotate(q_world_bodies, np.broadcast_to(camera.p_body_camera, (count, 3)))
    mount = np.broadcast_to(camera.q_body_camera, (count, 4))
    attitudes = geometry.rotation_matrix(geometry.quaternion_multiply(q_world_bodies, mount))
    return centres.astype(np.float32), attitudes.astype(np.float32)


def _dot(vector, direction):
    return vector[0] * direction[0] + vector[1] * direction[1] + vector[2] * direction[2]


def _texel(texture, across, up):
    """Return the row (n,) in the flat texture stack of places measured in tiles."""
    side = textures.SIDE
    column = jnp.floor((across - jnp.floor(across)) * side).astype(jnp.int32)
    row = jnp.floor((up - jnp.floor(up)) * side).astype(jnp.int32)
    return (texture * side + side - 1 - jnp.minimum(row, side - 1)) * side + jnp.minimum(column, side - 1)


def _value(stack, texel, texels, tone, contrast):
    """Return brightness (n,): tone and texture, whose contrast fades where a pixel covers `texels` tiles."""
    blur = texels * (textures.SIDE / 4)
    return tone + contrast / (1 + blur * blur) * (stack[texel].astype(jnp.float32) / 255 - 0.5)


def _surroundings(room, origin, ray, pixel_angle):
    """Return the distance (n,) of the room's side that each ray meets, and the side's look there (see `_value`)."""
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


def _inside(half, place, sharpness):
    """Return the share (n,) of a pixel within a rectangle: soft over one footprint (1 / sharpness, m) at its edges."""
    across = jnp.clip((half[0] - jnp.abs(place[0])) * sharpness[0] + 0.5, 0, 1)
    return across * jnp.clip((half[1] - jnp.abs(place[1])) * sharpness[1] + 0.5, 0, 1)


def _radiance(scene: Scene, stack, origin, rotation, rays, pixel_angle):
    """Return linear brightness (n,) seen along `rays` (n, 3) from one camera pose; origin (3,), or (3, n) a ray."""
    ray = [rays[:, 0] * rotation[i, 0] + rays[:, 1] * rotation[i, 1] + rays[:, 2] * rotation[i, 2] for i in range(3)]
    distance, behind = _surroundings(scene.room, origin, ray, pixel_angle)
    front, cover, nearest = behind, jnp.zeros_like(distance), distance
    plates = scene.plates
    stand = origin if origin.ndim == 1 else jnp.mean(origin, axis=1)
    order = jnp.argsort(-jnp.sum((plates.centre - stand) ** 2, axis=-1))
    for row in range(plates.centre.shape[0]):
        plate = jax.tree.map(lambda leaf, k=order[row]: leaf[k], plates)
        offset = origin - (plate.centre if origin.ndim == 1 else plate.centre[:, None])
        slope, left, up = (_dot(plate.rotation[:, i], ray) for i in range(3))
        slope = jnp.where(jnp.abs(slope) < 1e-4, 1e-4, slope)
        height = _dot(plate.rotation[:, 0], offset)
        reach = -height / slope
        place = [_dot(plate.rotation[:, 1], offset) + reach * left, _dot(plate.rotation[:, 2], offset) + reach * up]
        size = (jnp.abs(height) + 1e-6) * pixel_angle  # of a pixel's footprint, head-on
        sharpness = [slope**2 * jax.lax.rsqrt(slope**2 + axis**2) / size for axis in (left, up)]
        share = _inside(plate.half_outer, place, sharpness) - _inside(plate.half_inner, place, sharpness)
        share = jnp.where((reach > 0.05) & (reach < distance), share, 0)
        scale = 0.5 / (jnp.maximum(plate.half_outer[0], plate.half_outer[1]) + 1e-3)
        light = 1 + _dot(scene.room.gradient, plate.centre)
        texels = size * scale / slope**2
        mine = (plate.texture, place[0] * scale, place[1] * scale, texels, plate.tone * light, plate.contrast * light)
        covered = cover > 0.5
        seen = (share > 0) & ~(covered & (reach > nearest))
        behind = tuple(jnp.where(seen & covered, f, b) for f, b in zip(front, behind, strict=True))
        front = tuple(jnp.where(seen, m, f) for m, f in zip(mine, front, strict=True))
        cover, nearest = jnp.where(seen, share, cover), jnp.where(seen, reach, nearest)
    front, behind = ((_texel(*look[:3]), *look[3:]) for look in (front, behind))
    # The barrier keeps the look-ups out of the loop above, which the compiler can then vectorise.
    front, behind, cover = jax.lax.optimization_barrier((front, behind, cover))
    return cover * _value(stack, *front) + (1 - cover) * _value(stack, *behind)


@partial(jax.jit, static_argnames=("pixel_angle",))
def render_circle(scene: Scene, stack, origins, rotations, count, rays, radius, noise, pixel_angle: float, drift=None):
    """Return grey levels (n,) uint8 of the rays inside the image circle.

    stack: textures, flat, uint8; origins (k, 3), rotations (k, 3, 3): poses, of which the first `count` are averaged;
    noise (n,): standard normal; pixel_angle: rad between neighbouring pixels; drift (3, n) m: how far each ray's origin
    stands from the pose's, None: they all stand there.
    """

    def add(k, total):
        origin = origins[k] if drift is None else origins[k][:, None] + drift
        return total + _radiance(scene, stack, origin, rotations[k], rays, pixel_angle)

    total = jax.lax.fori_loop(0, count, add, jnp.zeros(rays.shape[0], jnp.float32))
    light = total / count
    middle = count // 2
    for k in range(scene.room.lamps.shape[0]):
        towards = scene.room.lamps[k] - origins[middle]
        towards = (towards / jnp.sqrt(jnp.sum(towards**2) + 1e-6)) @ rotations[middle]
        light = light + scene.room.glare[k] * jnp.exp(40 * (rays @ towards - 1))
    light = jnp.clip(light * scene.gain * (1 - scene.vignetting * radius**3), 0, 1)
    levels = 255 * light**scene.gamma
    return jnp.clip(levels + scene.noise * noise + 0.5, 1, 255).astype(jnp.uint8)


class CircleRenderer:
    """Renders scenes through one lens; keeps its rays and a stack of textures on the device.

    stack: textures (t, SIDE, SIDE) uint8; errors: what images do that the lens does not.
    """

    def __init__(self, camera, stack, errors: ImageErrors | None = None):
        self.camera = camera
        inside, rays, radius = pixel_rays(camera)
        self._inside = np.flatnonzero(inside)
        self._rays, self._radius = jnp.asarray(rays), jnp.asarray(radius)
        self._stack = jnp.asarray(stack.reshape(-1))
        self._bender = RayBender(camera, errors, self._inside) if errors and any(errors) else None
        self._noise = np.random.default_rng(0).standard_normal(len(rays) + NOISE_SIDE**2).astype(np.float32)

    def render(self, scene: Scene, p_world, q_world_body, v_world, omega_body, poses: int, rng) -> np.ndarray:
        """Return the image (H, W) uint8 of a vehicle's camera; black means outside the image circle.

        p_world (3,) m, q_world_body (4,), v_world (3,) m/s, omega_body (3,) rad/s at the image's stamp, which is the
        middle of the exposure; poses: at most so many are averaged for the blur; rng: draws where the image's noise
        begins.
        """
        count = poses_needed(self.camera, v_world, omega_body, poses)
        origins, rotations = (
            np.resize(rows, (poses, *rows.shape[1:]))  # of one shape for the compiler, whatever the count
            for rows in blur_poses(self.camera, p_world, q_world_body, v_world, omega_body, count)
        )
        start = int(rng.integers(0, NOISE_SIDE**2))
        noise = self._noise[start : start + len(self._rays)]
        angle = float(1 / self.camera.fx)
        rays, drift = self._rays, None
        if self._bender:
            rays, drift = self._bender.bend(q_world_body, v_world, omega_body, rng)
        levels = render_circle(scene, self._stack, origins, rotations, count, rays, self._radius, noise, angle, drift)
        image = np.zeros(self.camera.height * self.camera.width, np.uint8)
        image[self._inside] = np.asarray(levels)
        return image.reshape(self.camera.height, self.camera.width)


class Renderer:
    """The simulator's camera: a track in a room whose looks follow from the seed, seen with the errors of its images.

    Two renderers of the same seed give the same images for the same sequence of calls.
    """

    def __init__(self, camera, track, looks: Looks, seed, errors: ImageErrors | None = None):
        self._looks = looks
        self._rng = np.random.default_rng(seed)
        self.scene = scenes.race_scene(track, looks, self._rng)
        self._circle = CircleRenderer(camera, textures.stack(looks.families, looks.textures, self._rng), errors)

    def render(self, p_world, q_world_body, v_world, omega_body) -> np.ndarray:
        """Return the image (H, W) uint8 of the body's pose (m, x y z w) and motion (m/s world, rad/s body)."""
        poses = self._looks.blur_poses
        return self._circle.render(self.scene, p_world, q_world_body, v_world, omega_body, poses, self._rng)
