"""Errors of the camera: the camera that flies differs from `camera.yaml`, and its images distort corners.

`project_corners` returns the pixels of corners for recordings made without images; `DistortedRays` returns the rays of
the same image for the renderer.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_ros.camera.model import Camera
from swift_sim_bridge.effects import (
    GATE_CHANNELS,
    Effect,
    NotIdentified,
    TermSpecification,
    scalar_parameter,
    vector_parameters,
)
from swift_sim_bridge.sensors.clock import Delay, Moving, coasted

# Scale of the corner noise: corners more than twice as far apart are displaced independently.
DISPLACEMENT_SCALE_PX = 8.0


@dataclass(frozen=True)
class CameraExtrinsic:
    """Error of the camera's mount.

    Attributes:
        rotation: rotation vector (3,) rad, optical frame, 0.01 to 0.05.
        position: (3,) m, body frame, 0.002 to 0.02.
    """

    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CameraFocal:
    """Error of the intrinsic parameters.

    Attributes:
        scale: share by which the focal length is longer, 0.005 to 0.02.
        centre_px: (2,) px, shift of the image centre.
    """

    scale: float
    centre_px: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class RollingShutter:
    """Rolling shutter; the time stamp is that of the middle row.

    Attributes:
        readout: s from the exposure of the first row to that of the last, 0.005 to 0.02.
    """

    readout: float


@dataclass(frozen=True)
class CameraExposure:
    """Error of the exposure.

    Attributes:
        longer: s, additional exposure time.
        delay: s from the image's stamp to the middle of its exposure.
    """

    longer: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True)
class CornerNoise:
    """Random displacement of corners in the image.

    Attributes:
        px: standard deviation for each axis, 0.5 to 3.
    """

    px: float


TERMS = {
    "camera_extrinsic": TermSpecification(
        CameraExtrinsic,
        idle={"rotation": [0.0, 0.0, 0.0], "position": [0.0, 0.0, 0.0]},
        example={"rotation": [0.02, -0.03, 0.01], "position": [0.01, -0.005, 0.008]},
        effects=(
            Effect(
                id="camera_extrinsic",
                layer="camera",
                parameters=(
                    *vector_parameters("rotation", "rad", "camera_extrinsic", step=1e-3, bounds=(-0.3, 0.3)),
                    *vector_parameters("position", "m", "camera_extrinsic", step=2e-3, bounds=(-0.2, 0.2)),
                ),
                equation="R_BC (1 + [rotation]x), p_BC + position",
                sentence="the camera is turned (rad, optical frame) and shifted (m, body frame) by {values}",
                manoeuvre="gates at the left, right, top and bottom of the image, near and far",
                channels=GATE_CHANNELS,
            ),
        ),
    ),
    "camera_focal": TermSpecification(
        CameraFocal,
        idle={"scale": 0.0, "centre_px": [0.0, 0.0]},
        example={"scale": 0.01, "centre_px": [3.0, -2.0]},
        effects=(
            Effect(
                id="camera_focal",
                layer="camera",
                parameters=(
                    scalar_parameter("scale", "", "camera_focal", step=1e-3, low=-0.2, high=0.2),
                    *vector_parameters(
                        "centre_px",
                        "px",
                        "camera_focal",
                        step=0.1,
                        bounds=(-30.0, 30.0),
                        count=2,
                    ),
                ),
                equation="f (1 + scale), c + centre_px",
                sentence="focal length (share) and centre (px) are off by {values}",
                manoeuvre="gates at the edge of the image, near and far",
                channels=GATE_CHANNELS,
            ),
        ),
    ),
    "rolling_shutter": TermSpecification(
        RollingShutter,
        idle={"readout": 0.0},
        example={"readout": 0.015},
        effects=(
            Effect(
                id="rolling_shutter",
                layer="camera",
                parameters=(scalar_parameter("readout", "s", "rolling_shutter", step=5e-4, low=-0.05, high=0.05),),
                equation="row v is exposed readout (v / (height - 1) - 1/2) after the stamp",
                sentence="the rows of an image are exposed within {readout:.4g} s",
                manoeuvre="fast rolls and yaws before a gate, then the same gate at rest",
                channels=GATE_CHANNELS,
            ),
        ),
    ),
    "corner_noise": TermSpecification(
        CornerNoise,
        idle={"px": 0.0},
        example={"px": 1.5},
        units={"px": "px"},
        not_identified=NotIdentified(
            reason="it displaces every corner at random, and only systematic displacements can be identified",
            equation="corner = projection + e, e normal, px an axis",
            manoeuvre="hover before a gate for a minute",
        ),
    ),
    "camera_exposure": TermSpecification(
        CameraExposure,
        idle={},
        example={"longer": 0.004, "delay": 0.01},
        units={"longer": "s", "delay": "s"},
        not_identified=NotIdentified(
            reason="identified as processing_latency, of the other sign",
            equation="image(t) = scene(t + delay)",
            manoeuvre="fast passes and turns before a gate",
        ),
    ),
    "processing_latency": TermSpecification(
        Delay,
        idle={"delay": 0.0},
        example={"delay": 0.03},
        effects=(
            Effect(
                id="processing_latency",
                layer="camera",
                parameters=(scalar_parameter("delay", "s", "processing_latency", step=5e-4, low=-0.3, high=0.3),),
                equation="image(t) = scene(t - delay)",
                sentence="images show the scene {delay:~.4g} s {delay:before|after} their stamps",
                manoeuvre="fast passes and turns before a gate",
                channels=GATE_CHANNELS,
                retimes=True,
            ),
        ),
    ),
}


@dataclass(frozen=True)
class FlownCamera(Camera):
    """A camera whose mount is rotated by the rotation vector `turn` (3,) rad in the optical frame."""

    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def q_body_camera(self) -> np.ndarray:
        """Attitude (4,) of the optical frame in base_link."""
        turn = geometry.quaternion_from_rotation_vector(np.array(self.turn))
        return geometry.quaternion_multiply(super().q_body_camera, turn)


class ImageErrors(NamedTuple):
    """Errors of an image beside those of its lens.

    Attributes:
        readout: s, see `RollingShutter`.
        delay: s, see `CameraExposure`.
        corner_px: px, see `CornerNoise`.
    """

    readout: float = 0.0
    delay: float = 0.0
    corner_px: float = 0.0


def flown_camera(camera: Camera, terms: dict) -> Camera:
    """Return the camera that flies; `camera` is the one that the stack uses."""
    extrinsic, focal = terms.get("camera_extrinsic"), terms.get("camera_focal")
    exposure = terms.get("camera_exposure")
    if exposure:
        camera = replace(camera, exposure_s=camera.exposure_s + exposure.longer)
    if focal:
        stretch, (du, dv) = 1 + focal.scale, focal.centre_px
        camera = replace(camera, fx=camera.fx * stretch, fy=camera.fy * stretch, cx=camera.cx + du, cy=camera.cy + dv)
    if extrinsic:
        camera = FlownCamera(**{f.name: getattr(camera, f.name) for f in fields(camera)}, turn=extrinsic.rotation)
        camera = replace(camera, position=tuple(camera.p_body_camera + extrinsic.position))
    return camera


def image_errors(terms: dict) -> ImageErrors:
    """Return the errors of images by the sensor terms."""
    shutter, exposure, noise = (terms.get(name) for name in ("rolling_shutter", "camera_exposure", "corner_noise"))
    return ImageErrors(
        readout=shutter.readout if shutter else 0.0,
        delay=exposure.delay if exposure else 0.0,
        corner_px=noise.px if noise else 0.0,
    )


def row_times(camera: Camera, errors: ImageErrors, row):
    """Return the times (...) s from the image's stamp to the exposure of rows (...)."""
    share = np.clip(row, 0, camera.height - 1) / (camera.height - 1)
    return errors.delay + errors.readout * (share - 0.5)


def project_corners(camera: Camera, errors: ImageErrors, moving: Moving, points_world, rng=None) -> tuple[Any, Any]:
    """Return pixels (..., k, 2) of points, and whether they lie in image and image circle (..., k).

    Args:
        camera: the camera that flies.
        errors: of its images.
        moving: bodies (...) that carry the camera.
        points_world: (k, 3) m, or (..., k, 3) for each body.
        rng: draws the corner noise; None for no noise.
    """
    bodies = Moving(*(np.asarray(field)[..., None, :] for field in moving))
    seen_at = np.full((*bodies.p_world.shape[:-2], points_world.shape[-2]), errors.delay)
    for _ in range(5 if errors.readout else 1):  # the row and its time determine each other; the iteration converges
        then = coasted(bodies, seen_at[..., None])
        p_camera = lens.world_to_camera(camera, then.p_world, then.q_world_body, points_world)
        pixels, angle = lens.project(camera, p_camera)
        seen_at = row_times(camera, errors, pixels[..., 1])
    if rng is not None:
        pixels = pixels + errors.corner_px * rng.standard_normal(pixels.shape)
    return pixels, (angle <= camera.half_angle) & (lens.inside_px(camera, pixels) >= 0)


def rotated_rays(rays, omega_camera, times):
    """Return the rays (n, 3) of a rotating camera, each after its time, in the optical frame at time zero.

    Args:
        rays: (n, 3), optical frame.
        omega_camera: (3,) rad/s, optical frame.
        times: (n,) s.
    """
    rate = np.linalg.norm(omega_camera) + 1e-12
    axis = np.broadcast_to((omega_camera / rate).astype(rays.dtype), rays.shape)
    angle = (rate * times)[:, None].astype(rays.dtype)
    across = geometry.cross(axis, rays)  # by components: a matrix product would start threads
    return rays + np.sin(angle) * across + (1 - np.cos(angle)) * geometry.cross(axis, across)


def corner_displacement(shape, px: float, rng) -> np.ndarray:
    """Return smooth random displacements (2, height, width) px of standard deviation `px` at every pixel and axis."""
    edge = round(3 * DISPLACEMENT_SCALE_PX)
    kernel = cv2.getGaussianKernel(2 * edge + 1, DISPLACEMENT_SCALE_PX)
    noise = rng.standard_normal((2, shape[0] + 2 * edge, shape[1] + 2 * edge), dtype=np.float32)
    smooth = [cv2.sepFilter2D(plane, -1, kernel, kernel)[edge:-edge, edge:-edge] for plane in noise]
    return np.stack(smooth) * np.float32(px / np.sum(kernel**2))


class DistortedRays:
    """Rays of images with rolling shutter, exposure delay and corner noise.

    Args:
        camera: the camera that flies.
        errors: of its images.
        inside: flat indices (n,) of the pixels that are drawn.
    """

    def __init__(self, camera: Camera, errors: ImageErrors, inside):
        self._camera, self._errors, self._inside = camera, errors, inside
        self._v, self._u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
        self._rays = lens.unproject(camera, np.stack([self._u, self._v], axis=-1).astype(float)).astype(np.float32)
        self._times = row_times(camera, errors, inside // camera.width)

    def of_image(self, q_world_body, v_world, omega_body, rng):
        """Return the rays of an image and the displacement of the optical centre for each.

        Args:
            q_world_body: (4,) at the image's stamp.
            v_world: (3,) m/s.
            omega_body: (3,) rad/s.
            rng: draws the corner noise.

        Returns:
            Rays (n, 3) in the optical frame at the stamp, and displacements (3, n) m of the optical centre from the
            stamp to each ray's exposure, world frame.
        """
        rays = self._rays
        if self._errors.corner_px:
            du, dv = corner_displacement(self._v.shape, self._errors.corner_px, rng)
            # a pixel shows the ray of a point beside it
            rays = cv2.remap(rays, self._u - du, self._v - dv, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        camera, omega_body = self._camera, np.asarray(omega_body)
        omega_camera = geometry.rotate_inverse(camera.q_body_camera, omega_body)
        rays = rotated_rays(rays.reshape(-1, 3)[self._inside], omega_camera, self._times)
        swing = geometry.rotate(np.asarray(q_world_body), geometry.cross(omega_body, camera.p_body_camera))
        drift = (np.asarray(v_world) + swing)[:, None] * self._times
        return rays, drift.astype(np.float32)
