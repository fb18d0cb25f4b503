"""The camera that flies, where it is not the one that `camera.yaml` describes, and what its images do to corners.

`project_corners` says where corners are seen, for recordings made without images; `RayBender` gives the renderer the
rays of the same image.
"""

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import cv2
import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_ros.camera.model import Camera
from swift_sim_bridge.sensors.clock import Delay, Moving, coasted

SHIMMER_PX = 8.0  # corners farther apart than about twice this are displaced independently


@dataclass(frozen=True)
class CameraExtrinsic:
    """`camera_extrinsic`: the camera is turned by the rotation vector (3,) rad, optical frame (0.01 to 0.05), and
    shifted by `position` (3,) m, body frame (0.002 to 0.02)."""

    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CameraFocal:
    """`camera_focal`: share by which the focal length is longer, 0.005 to 0.02; centre_px (2,): shift of the centre."""

    scale: float
    centre_px: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class RollingShutter:
    """`rolling_shutter`: s from the first row's exposure to the last's, 0.005 to 0.02; the stamp is the middle's."""

    readout: float


@dataclass(frozen=True)
class CameraExposure:
    """`camera_exposure`: the shutter stays open `longer` s, and its middle is `delay` s after the image's stamp."""

    longer: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True)
class CornerNoise:
    """`corner_noise`: standard deviation of a corner's place in the image, px an axis, 0.5 to 3."""

    px: float


TERMS = {
    "camera_extrinsic": CameraExtrinsic,
    "camera_focal": CameraFocal,
    "rolling_shutter": RollingShutter,
    "camera_exposure": CameraExposure,
    "corner_noise": CornerNoise,
    "processing_latency": Delay,
}


@dataclass(frozen=True)
class FlownCamera(Camera):
    """A camera whose mount is turned by the rotation vector `turn` (3,) rad in its own frame."""

    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def q_body_camera(self) -> np.ndarray:
        """Attitude (4,) of the optical frame in base_link."""
        turn = geometry.quaternion_from_rotation_vector(np.array(self.turn))
        return geometry.quaternion_multiply(super().q_body_camera, turn)


class ImageErrors(NamedTuple):
    """What an image does that a lens does not: readout s, delay s (see the terms), corner_px px."""

    readout: float = 0.0
    delay: float = 0.0
    corner_px: float = 0.0


def flown_camera(camera: Camera, terms: dict) -> Camera:
    """Return the camera that flies where the stack believes in `camera`."""
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
    """Return what the terms do to images."""
    shutter, exposure, noise = (terms.get(name) for name in ("rolling_shutter", "camera_exposure", "corner_noise"))
    return ImageErrors(
        readout=shutter.readout if shutter else 0.0,
        delay=exposure.delay if exposure else 0.0,
        corner_px=noise.px if noise else 0.0,
    )


def row_times(camera: Camera, errors: ImageErrors, row):
    """Return when rows (...) of an image are exposed, s after its stamp."""
    share = np.clip(row, 0, camera.height - 1) / (camera.height - 1)
    return errors.delay + errors.readout * (share - 0.5)


def project_corners(camera: Camera, errors: ImageErrors, moving: Moving, points_world, rng=None):
    """Return pixels (..., k, 2) where points (k, 3) of the world, or each body's own (..., k, 3), are seen from bodies
    (...), and whether they lie in the image circle (..., k). rng: draws the corner noise; None: none."""
    bodies = Moving(*(np.asarray(field)[..., None, :] for field in moving))
    seen_at = np.full((*bodies.p_world.shape[:-2], points_world.shape[-2]), errors.delay)
    for _ in range(5 if errors.readout else 1):  # the row says when, when says which row: settles geometrically
        then = coasted(bodies, seen_at[..., None])
        p_camera = lens.world_to_camera(camera, then.p_world, then.q_world_body, points_world)
        pixels, angle = lens.project(camera, p_camera)
        seen_at = row_times(camera, errors, pixels[..., 1])
    if rng is not None:
        pixels = pixels + errors.corner_px * rng.standard_normal(pixels.shape)
    return pixels, angle <= camera.half_angle


def turned(rays, omega_camera, times):
    """Return rays (n, 3) of a camera turning at omega_camera (3,) rad/s, seen `times` (n,) s later, in its frame at
    time zero."""
    rate = np.linalg.norm(omega_camera) + 1e-12
    axis = np.broadcast_to((omega_camera / rate).astype(rays.dtype), rays.shape)
    angle = (rate * times)[:, None].astype(rays.dtype)
    across = geometry.cross(axis, rays)  # by components: threads of a matrix product would wait for each other
    return rays + np.sin(angle) * across + (1 - np.cos(angle)) * geometry.cross(axis, across)


def shimmer(shape, px: float, rng) -> np.ndarray:
    """Return smooth displacements (2, height, width) px, `px` in standard deviation at every pixel and axis."""
    edge = round(3 * SHIMMER_PX)
    kernel = cv2.getGaussianKernel(2 * edge + 1, SHIMMER_PX)
    noise = rng.standard_normal((2, shape[0] + 2 * edge, shape[1] + 2 * edge), dtype=np.float32)
    smooth = [cv2.sepFilter2D(plane, -1, kernel, kernel)[edge:-edge, edge:-edge] for plane in noise]
    return np.stack(smooth) * np.float32(px / np.sum(kernel**2))


class RayBender:
    """Bends the rays of a camera's images as rolling shutter, exposure delay and corner noise do.

    inside: flat indices (n,) of the pixels that are drawn.
    """

    def __init__(self, camera: Camera, errors: ImageErrors, inside):
        self._camera, self._errors, self._inside = camera, errors, inside
        self._v, self._u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
        self._rays = lens.unproject(camera, np.stack([self._u, self._v], axis=-1).astype(float)).astype(np.float32)
        self._times = row_times(camera, errors, inside // camera.width)

    def bend(self, q_world_body, v_world, omega_body, rng):
        """Return rays (n, 3) in the optical frame at the image's stamp, and how far (3, n) m, world frame, the optical
        centre stands then from where it is at the stamp. rng: draws the corner noise."""
        rays = self._rays
        if self._errors.corner_px:
            du, dv = shimmer(self._v.shape, self._errors.corner_px, rng)
            # What is seen at a pixel is what belongs beside it.
            rays = cv2.remap(rays, self._u - du, self._v - dv, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        camera, omega_body = self._camera, np.asarray(omega_body)
        omega_camera = geometry.rotate_inverse(camera.q_body_camera, omega_body)
        rays = turned(rays.reshape(-1, 3)[self._inside], omega_camera, self._times)
        swing = geometry.rotate(np.asarray(q_world_body), geometry.cross(omega_body, camera.p_body_camera))
        drift = (np.asarray(v_world) + swing)[:, None] * self._times
        return rays, drift.astype(np.float32)
