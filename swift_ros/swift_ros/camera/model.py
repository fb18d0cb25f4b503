"""Model of the fisheye camera: equidistant (Kannala-Brandt) projection, mount, and `config/camera.yaml`.

Camera optical frame: z forward, x right, y down. A pixel centre has integer coordinates. Array-agnostic.
"""

from dataclasses import dataclass

import numpy as np
from array_api_compat import array_namespace

from swift_ros import geometry


@dataclass(frozen=True)
class Camera:
    """Camera of `config/camera.yaml`.

    Attributes:
        width: of an image, px.
        height: of an image, px.
        fx, fy: focal lengths, px.
        cx, cy: principal point, px.
        distortion: Kannala-Brandt coefficients k1 to k4.
        image_circle_deg: full field of view of the lens, degrees.
        position: optical centre (3,) in base_link, m.
        pitch_deg: angle of the optical axis above the body's x axis, degrees.
        rate_hz: images per second, Hz.
        exposure_s: exposure time, s.
        processing_latency: time from an image's stamp until its gates correct the state, s; exact in lockstep.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float]
    image_circle_deg: float
    position: tuple[float, float, float]
    pitch_deg: float
    rate_hz: float
    exposure_s: float
    processing_latency: float

    def __post_init__(self):
        for name in ("width", "height", "fx", "fy", "image_circle_deg", "rate_hz"):
            if not getattr(self, name) > 0:
                raise ValueError(f"'{name}' must be positive")

    @property
    def half_angle(self) -> float:
        """Largest angle from the optical axis that the lens images, rad."""
        return np.radians(self.image_circle_deg / 2)

    @property
    def q_body_camera(self) -> np.ndarray:
        """Attitude of the optical frame in base_link (4,)."""
        pitch = np.radians(self.pitch_deg)
        forward = np.array([np.cos(pitch), 0.0, np.sin(pitch)])
        right = np.array([0.0, -1.0, 0.0])
        return geometry.quaternion_from_matrix(np.stack([right, np.cross(forward, right), forward], axis=1))

    @property
    def p_body_camera(self) -> np.ndarray:
        """Optical centre in base_link (3,), m."""
        return np.asarray(self.position)


def _distort(theta, k):
    squared = theta * theta
    return theta * (1 + squared * (k[0] + squared * (k[1] + squared * (k[2] + squared * k[3]))))


def _distort_slope(theta, k):
    squared = theta * theta
    return 1 + squared * (3 * k[0] + squared * (5 * k[1] + squared * (7 * k[2] + squared * 9 * k[3])))


def project(camera: Camera, p_camera):
    """Project points into the image.

    Points at angles beyond `camera.half_angle` are not imaged; their pixels are extrapolated linearly, so that they are
    finite and outside of the image circle.

    Args:
        camera: the camera.
        p_camera: points (..., 3) in the optical frame.

    Returns:
        Pixels (..., 2), and angles (...) from the optical axis, rad.
    """
    xp = array_namespace(p_camera)
    x, y, z = p_camera[..., 0], p_camera[..., 1], p_camera[..., 2]
    radius = xp.sqrt(x * x + y * y + 1e-24)
    theta = xp.atan2(radius, z)
    edge = camera.half_angle
    inside = xp.where(theta < edge, theta, xp.full_like(theta, edge))
    beyond = theta - inside
    bent = _distort(inside, camera.distortion) + _distort_slope(edge, camera.distortion) * beyond
    u = camera.cx + camera.fx * bent * x / radius
    v = camera.cy + camera.fy * bent * y / radius
    return xp.stack([u, v], axis=-1), theta


def unproject(camera: Camera, pixels):
    """Return the unit rays (..., 3) in the optical frame of pixels (..., 2): the inverse of `project`."""
    xp = array_namespace(pixels)
    mx = (pixels[..., 0] - camera.cx) / camera.fx
    my = (pixels[..., 1] - camera.cy) / camera.fy
    bent = xp.sqrt(mx * mx + my * my + 1e-24)
    edge = camera.half_angle
    edge_bent = float(_distort(edge, camera.distortion))
    slope = float(_distort_slope(edge, camera.distortion))
    inside = xp.where(bent < edge_bent, bent, xp.full_like(bent, edge_bent))
    theta = inside
    for _ in range(6):  # Newton: converged to machine precision inside the circle after four
        theta = theta - (_distort(theta, camera.distortion) - inside) / _distort_slope(theta, camera.distortion)
    theta = theta + (bent - inside) / slope
    sine = xp.sin(theta)
    return xp.stack([sine * mx / bent, sine * my / bent, xp.cos(theta)], axis=-1)


def world_to_camera(camera: Camera, p_world_body, q_world_body, points_world):
    """Return world points (..., 3) in the optical frame of the camera of a body at a pose."""
    points_body = geometry.rotate_inverse(q_world_body, points_world - p_world_body)
    xp = array_namespace(points_body)
    position, q_body_camera = xp.asarray(camera.p_body_camera), xp.asarray(camera.q_body_camera)
    return geometry.rotate_inverse(q_body_camera, points_body - position)
