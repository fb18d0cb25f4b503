"""Grey fisheye images by ray casting: one ray a pixel, flat objects in closed form, painted from far to near.

Edges are anti-aliased over the width of a pixel. Textures fade where a pixel covers many texels, since there are no mip
maps. Motion blur is the mean over poses at equal intervals of the exposure, whose middle is the image's stamp. A gate
is a plane (its 0.1 m of depth is not drawn) and looks the same from both sides.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.motion import BodyMotion
from swift_sim_bridge.rendering.scene import Looks, Scene
from swift_sim_bridge.sensors.camera import DistortedRays, ImageErrors

# The noise is drawn once, NOISE_SIDE^2 samples longer than an image, and read from a random start for each image.
NOISE_SIDE = 521
PX_PER_POSE = 2  # motion blur has a pose for so many pixels of smear: no visible gaps
BLUR_DISTANCE_M = 4  # at which objects are assumed for the smear by translation


class Poses(NamedTuple):
    """Camera poses during one exposure, which are averaged.

    Attributes:
        origins: (k, 3) m, optical centres in the world.
        rotations: (k, 3, 3), R_world_camera.
    """

    origins: np.ndarray
    rotations: np.ndarray


class Rays(NamedTuple):
    """The rays of the pixels inside the image circle.

    Attributes:
        directions: (n, 3), unit vectors in the optical frame.
        radius: (n,), distance from the axis as a share of the circle's radius.
        drift: (3, n) m, offset of each ray's origin from the optical centre (rolling shutter); None: no offset.
    """

    directions: jnp.ndarray
    radius: jnp.ndarray
    drift: jnp.ndarray | None = None


def pixel_rays(camera):
    """Return (inside, directions, radius) of a camera.

    inside (H, W) bool are the pixels within the image circle; directions and radius are theirs, see `Rays`.
    """
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = lens.unproject(camera, np.stack([u, v], axis=-1).astype(float))
    theta = np.arccos(np.clip(rays[..., 2], -1, 1))
    inside = theta <= camera.half_angle
    radius = theta[inside] / camera.half_angle
    return inside, rays[inside].astype(np.float32), radius.astype(np.float32)


def poses_needed(camera, motion: BodyMotion, most: int) -> int:
    """Return how many poses, at most `most`, render the blur of a motion without gaps."""
    speed = np.linalg.norm(motion.omega_body) + np.linalg.norm(motion.v_world) / BLUR_DISTANCE_M
    smear = camera.exposure_s * speed * camera.fx
    return int(np.clip(np.ceil(smear / PX_PER_POSE), 1, most))


def blur_poses(camera, motion: BodyMotion, count: int):
    """Return optical centres (count, 3) and R_world_camera (count, 3, 3) at equal intervals of the exposure."""
    times = ((np.arange(count) + 0.5) / count - 0.5) * camera.exposure_s
    q = geometry.normalize(np.asarray(motion.q_world_body, dtype=float))
    turn = geometry.quaternion_from_rotation_vector(times[:, None] * np.asarray(motion.omega_body, dtype=float))
    q_world_bodies = geometry.quaternion_multiply(np.broadcast_to(q, (count, 4)), turn)
    p_world_bodies = np.asarray(motion.p_world) + times[:, None] * np.asarray(motion.v_world)
    centres = p_world_bodies + geometry.rotate(q_world_bodies, np.broadcast_to(camera.p_body_camera, (count, 3)))
    mount = np.broadcast_to(camera.q_body_camera, (count, 4))
    attitudes = geometry.rotation_matrix(geometry.quaternion_multiply(q_world_bodies, mount))
    return centres.astype(np.float32), attitudes.astype(np.float32)


def _dot(vector, direction):
    """Return the dot product of two vectors given by their components."""
    return vector[0] * direction[0] + vector[1] * direction[1] + vector[2] * direction[2]


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


def _surroundings(room, origin, ray, pixel_angle):
    """Return the distance (n,) at which each ray meets a side of the room, and the surface there (see `_value`)."""
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
    """Return the share (n,) of a pixel within a rectangle; its edges are ramps one pixel (1 / sharpness, m) wide."""
    across = jnp.clip((half[0] - jnp.abs(place[0])) * sharpness[0] + 0.5, 0, 1)
    return across * jnp.clip((half[1] - jnp.abs(place[1])) * sharpness[1] + 0.5, 0, 1)


@partial(jax.jit, static_argnames=("pixel_angle",))
def _surfaces(scene: Scene, pose, rays: Rays, pixel_angle):
    """Return what each ray sees from one camera pose: (in front, behind, share (n,) of what is in front).

    A surface is (texel, texels per pixel, tone, contrast), see `_value`. pose: origin (3,) and rotation (3, 3).
    """
    origin, rotation = pose
    origin = origin if rays.drift is None else origin[:, None] + rays.drift
    rays = rays.directions
    ray = [rays[:, 0] * rotation[i, 0] + rays[:, 1] * rotation[i, 1] + rays[:, 2] * rotation[i, 2] for i in range(3)]
    distance, behind = _surroundings(scene.room, origin, ray, pixel_angle)
    front, cover, nearest = behind, jnp.zeros_like(distance), distance
    plates = scene.plates
    centre = origin if origin.ndim == 1 else jnp.mean(origin, axis=1)
    order = jnp.argsort(-jnp.sum((plates.centre - centre) ** 2, axis=-1))
    for row in range(plates.centre.shape[0]):
        plate = jax.tree.map(lambda leaf, k=order[row]: leaf[k], plates)
        offset = origin - (plate.centre if origin.ndim == 1 else plate.centre[:, None])
        slope, left, up = (_dot(plate.rotation[:, i], ray) for i in range(3))
        slope = jnp.where(jnp.abs(slope) < 1e-4, 1e-4, slope)
        height = _dot(plate.rotation[:, 0], offset)
        reach = -height / slope
        place = [_dot(plate.rotation[:, 1], offset) + reach * left, _dot(plate.rotation[:, 2], offset) + reach * up]
        size = (jnp.abs(height) + 1e-6) * pixel_angle  # width of a pixel on a plate that is seen head-on, m
        sharpness = [slope**2 * jax.lax.rsqrt(slope**2 + axis**2) / size for axis in (left, up)]
        share = _inside(plate.half_outer, place, sharpness) - _inside(plate.half_inner, place, sharpness)
        share = jnp.where((reach > 0.05) & (reach < distance), share, 0)
        scale = 0.5 / (jnp.maximum(plate.half_outer[0], plate.half_outer[1]) + 1e-3)
        light = 1 + _dot(scene.room.gradient, plate.centre)
        texels = size * scale / slope**2
        surface = (
            plate.texture,
            place[0] * scale,
            place[1] * scale,
            texels,
            plate.tone * light,
            plate.contrast * light,
        )
        covered = cover > 0.5
        visible = (share > 0) & ~(covered & (reach > nearest))
        behind = tuple(jnp.where(visible & covered, f, b) for f, b in zip(front, behind, strict=True))
        front = tuple(jnp.where(visible, m, f) for m, f in zip(surface, front, strict=True))
        cover, nearest = jnp.where(visible, share, cover), jnp.where(visible, reach, nearest)
    front, behind = ((_texel(*surface[:3]), *surface[3:]) for surface in (front, behind))
    return front, behind, cover


@jax.jit
def _add_brightness(total, stack, front, behind, cover):
    """Return `total` (n,) plus the linear brightness of the surfaces that rays see.

    A program of its own: XLA would fuse the texture look-ups into the loop over the plates and could not vectorise it,
    and an image takes 2.5 times as long.
    """
    return total + (cover * _value(stack, *front) + (1 - cover) * _value(stack, *behind))


@jax.jit
def _grey_levels(scene: Scene, light, pose, rays: Rays, noise):
    """Return the grey levels (n,) uint8 of rays with linear brightness (n,), seen from the pose amid the exposure."""
    origin, rotation = pose
    for k in range(scene.room.lamps.shape[0]):
        towards = scene.room.lamps[k] - origin
        towards = (towards / jnp.sqrt(jnp.sum(towards**2) + 1e-6)) @ rotation
        light = light + scene.room.glare[k] * jnp.exp(40 * (rays.directions @ towards - 1))
    light = jnp.clip(light * scene.gain * (1 - scene.vignetting * rays.radius**3), 0, 1)
    levels = 255 * light**scene.gamma
    return jnp.clip(levels + scene.noise * noise + 0.5, 1, 255).astype(jnp.uint8)


def render_circle(scene: Scene, stack, poses: Poses, rays: Rays, noise, pixel_angle: float):
    """Return the grey levels (n,) uint8 of the pixels inside the image circle.

    Args:
        scene: what is rendered.
        stack: textures, flat, uint8.
        poses: of the camera during the exposure.
        rays: of the pixels.
        noise: (n,), standard normal.
        pixel_angle: rad between neighbouring pixels.
    """
    total = jnp.zeros(len(noise), jnp.float32)
    for pose in zip(*poses, strict=True):
        total = _add_brightness(total, stack, *_surfaces(scene, pose, rays, pixel_angle))
    count = len(poses.origins)
    middle = poses.origins[count // 2], poses.rotations[count // 2]
    return _grey_levels(scene, total / count, middle, rays, noise)


class CircleRenderer:
    """Renders scenes through one lens; keeps its rays and the textures on the device."""

    def __init__(self, camera, stack, errors: ImageErrors | None = None):
        """Make a renderer.

        Args:
            camera: the lens and its mount.
            stack: (t, SIDE, SIDE) uint8, textures.
            errors: of the images, relative to the lens model; None: none.
        """
        self.camera = camera
        inside, directions, radius = pixel_rays(camera)
        self._inside = np.flatnonzero(inside)
        self._rays = Rays(jnp.asarray(directions), jnp.asarray(radius))
        self._stack = jnp.asarray(stack.reshape(-1))
        self._distorted_rays = DistortedRays(camera, errors, self._inside) if errors and any(errors) else None
        self._noise = np.random.default_rng(0).standard_normal(len(directions) + NOISE_SIDE**2).astype(np.float32)

    def render(self, scene: Scene, motion: BodyMotion, max_poses: int, rng) -> np.ndarray:
        """Return the image (H, W) uint8 of a vehicle's camera; black means outside the image circle.

        Args:
            scene: what is rendered.
            motion: of the body at the image's stamp, which is the middle of the exposure.
            max_poses: largest number of poses that are averaged for motion blur.
            rng: generator of the noise and of the image's errors.
        """
        count = poses_needed(self.camera, motion, max_poses)
        poses = Poses(*blur_poses(self.camera, motion, count))
        start = int(rng.integers(0, NOISE_SIDE**2))
        noise = self._noise[start : start + len(self._rays.directions)]
        rays = self._rays
        if self._distorted_rays:
            directions, drift = self._distorted_rays.of_image(
                motion.q_world_body, motion.v_world, motion.omega_body, rng
            )
            rays = Rays(directions, rays.radius, drift)
        levels = render_circle(scene, self._stack, poses, rays, noise, pixel_angle=float(1 / self.camera.fx))
        image = np.zeros(self.camera.height * self.camera.width, np.uint8)
        image[self._inside] = np.asarray(levels)
        return image.reshape(self.camera.height, self.camera.width)


class Renderer:
    """The simulator's camera: a track in a room with random surfaces, seen with the errors of its images.

    Two renderers of the same seed give the same images for the same sequence of calls.
    """

    def __init__(self, camera, track, looks: Looks, seed, errors: ImageErrors | None = None):
        """Make a renderer.

        Args:
            camera: the lens and its mount.
            track: whose gates are seen.
            looks: ranges of the surfaces.
            seed: of the surfaces, the noise and the errors.
            errors: of the images, relative to the lens model; None: none.
        """
        self._looks = looks
        self._rng = np.random.default_rng(seed)
        self.scene = scenes.race_scene(track, looks, self._rng)
        self._circle = CircleRenderer(camera, textures.stack(looks.families, looks.textures, self._rng), errors)

    def render(self, p_world, q_world_body, v_world, omega_body) -> np.ndarray:
        """Return the image (H, W) uint8 of the body's pose (m, x y z w) and motion (m/s world, rad/s body)."""
        motion = BodyMotion(p_world, q_world_body, v_world, omega_body)
        return self._circle.render(self.scene, motion, self._looks.blur_poses, self._rng)
