"""Grey fisheye images by ray casting: one ray a pixel.

Motion blur is the mean over poses at equal intervals of the exposure, whose middle is the image's stamp. A gate
is a plane (its 0.1 m of depth is not drawn) and looks the same from both sides.
"""

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
from swift_sim_bridge.rendering.surfaces import Rays, add_brightness
from swift_sim_bridge.sensors.camera import DistortedRays, ImageErrors

# The noise is drawn once, NOISE_SIDE^2 samples longer than an image, and read from a random start for each image.
NOISE_SIDE = 521
VECTOR = 16  # rays; XLA computes a number of them that is no multiple of 4 one by one, in four times the time
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


def pixel_rays(camera):
    """Return (inside, directions, radius) of a camera.

    inside (H, W) bool are the pixels within the image circle; directions (3, n) and radius (n,) are theirs, see `Rays`.
    """
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = lens.unproject(camera, np.stack([u, v], axis=-1).astype(float))
    theta = np.arccos(np.clip(rays[..., 2], -1, 1))
    inside = theta <= camera.half_angle
    radius = theta[inside] / camera.half_angle
    return inside, rays[inside].T.astype(np.float32), radius.astype(np.float32)


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


@jax.jit
def _grey_levels(scene: Scene, total, count, pose, rays: Rays, noise):
    """Return the grey levels (n,) uint8 of rays with `count` times their linear brightness, `total` (n,).

    The pose is that amid the exposure.
    """
    origin, rotation = pose
    light = total / count
    for k in range(scene.room.lamps.shape[0]):
        towards = scene.room.lamps[k] - origin
        towards = (towards / jnp.sqrt(jnp.sum(towards**2) + 1e-6)) @ rotation
        light = light + scene.room.glare[k] * jnp.exp(40 * (towards @ rays.directions - 1))
    light = jnp.clip(light * scene.gain * (1 - scene.vignetting * rays.radius**3), 0, 1)
    levels = 255 * jnp.exp(scene.gamma * jnp.log(light))  # XLA computes a power of each number by itself
    return jnp.clip(levels + scene.noise * noise + 0.5, 1, 255).astype(jnp.uint8)


def render_circle(scene: Scene, stack, poses: Poses, rays: Rays, noise, pixel_angle: float):
    """Return the grey levels (n,) uint8 of the pixels inside the image circle.

    Args:
        scene: what is rendered.
        stack: textures, flat, uint8.
        poses: of the camera during the exposure.
        rays: of the pixels; n is a multiple of VECTOR.
        noise: (n,), standard normal.
        pixel_angle: rad between neighbouring pixels.
    """
    total = jnp.zeros(len(rays.radius), jnp.float32)
    for pose in zip(*poses, strict=True):
        total = add_brightness(total, stack, scene, pose, rays, pixel_angle)
    count = len(poses.origins)
    middle = poses.origins[count // 2], poses.rotations[count // 2]
    return np.asarray(_grey_levels(scene, total, count, middle, rays, noise))


def _whole_vectors(values) -> np.ndarray:
    """Return the values (..., n) of rays with the last ray repeated until their number is a multiple of VECTOR."""
    spare = -values.shape[-1] % VECTOR
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, spare)], "edge")


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
        self._rays = Rays(*(jnp.asarray(_whole_vectors(values)) for values in (directions, radius)))
        self._stack = jnp.asarray(stack.reshape(-1))
        self._distorted_rays = DistortedRays(camera, errors, self._inside) if errors and any(errors) else None
        self._noise = np.random.default_rng(0).standard_normal(len(self._rays.radius) + NOISE_SIDE**2)
        self._noise = self._noise.astype(np.float32)

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
        rays, start = self._rays, int(rng.integers(0, NOISE_SIDE**2))
        noise = self._noise[start : start + len(rays.radius)]
        if self._distorted_rays:
            directions, drift = self._distorted_rays.of_image(
                motion.q_world_body, motion.v_world, motion.omega_body, rng
            )
            rays = Rays(_whole_vectors(directions.T), rays.radius, _whole_vectors(drift))
        levels = render_circle(scene, self._stack, poses, rays, noise, pixel_angle=float(1 / self.camera.fx))
        image = np.zeros(self.camera.height * self.camera.width, np.uint8)
        image[self._inside] = levels[: len(self._inside)]
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
        # On the device, for all images.
        self.scene = jax.tree.map(jnp.asarray, scenes.race_scene(track, looks, self._rng))
        self._circle = CircleRenderer(camera, textures.stack(looks.families, looks.textures, self._rng), errors)

    def render(self, p_world, q_world_body, v_world, omega_body) -> np.ndarray:
        """Return the image (H, W) uint8 of the body's pose (m, x y z w) and motion (m/s world, rad/s body)."""
        motion = BodyMotion(p_world, q_world_body, v_world, omega_body)
        return self._circle.render(self.scene, motion, self._looks.blur_poses, self._rng)
