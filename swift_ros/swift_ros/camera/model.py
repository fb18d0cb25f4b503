"""Model of the camera: projection through its lens, mount, and `config/camera.yaml`.

Camera optical frame: z forward, x right, y down. A pixel centre has integer coordinates. Array-agnostic.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from array_api_compat import array_namespace

from swift_ros import geometry
from swift_ros.camera import lens as lenses
from swift_ros.plausibility import of_camera
from swift_ros.plausibility.finding import Finding
from swift_ros.text import described


@dataclass(frozen=True)
class Intrinsics:
    """What a calibration finds.

    Attributes:
        width: of an image, px.
        height: of an image, px.
        fx, fy: focal lengths, px.
        cx, cy: principal point, px.
        distortion: coefficients of the lens. kannala_brandt: k1 to k4. pinhole: none, or those of OpenCV: k1 k2 p1 p2,
            with k3, or with k3 to k6. double_sphere: xi, alpha.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...]


@dataclass(frozen=True)
class Camera(Intrinsics):
    """Camera of `config/camera.yaml`.

    Attributes:
        position: optical centre (3,) in base_link, m.
        pitch_deg: angle of the optical axis above the body's x axis, degrees.
        rate_hz: images per second, Hz.
        exposure_s: exposure time, s.
        processing_latency: time from an image's stamp until its gates correct the state, s; exact in lockstep.
        model: of the lens, one of `lens.LENSES`.
        image_circle_deg: full field of view of the lens, degrees; without it, up to the corners of the image.
        yaw_deg: angle of the optical axis to the left of the body's x axis, degrees.
        roll_deg: angle about the optical axis, degrees; positive lowers the right side of the camera.
    """

    position: tuple[float, float, float]
    pitch_deg: float
    rate_hz: float
    exposure_s: float
    processing_latency: float
    model: str = lenses.KANNALA_BRANDT
    image_circle_deg: float | None = None
    yaw_deg: float = 0.0
    roll_deg: float = 0.0

    def __post_init__(self):
        for name in ("width", "height", "fx", "fy", "image_circle_deg", "rate_hz"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"'{name}' must be positive")
        if self.model not in lenses.LENSES:
            raise ValueError(f"'model' must be one of {', '.join(lenses.LENSES)}, not {described(self.model)}")
        if wrong := lenses.wrong_count(self.model, len(self.distortion)):
            raise ValueError(wrong)

    def findings(self) -> list[Finding]:
        """Return what is impossible or odd about this camera."""
        return of_camera.findings(self)

    @property
    def lens(self) -> lenses.Lens:
        """The lens model."""
        return lenses.LENSES[self.model]

    @cached_property
    def half_angle(self) -> float:
        """Largest angle from the optical axis that the lens images, rad."""
        if self.image_circle_deg is not None:
            return np.radians(self.image_circle_deg / 2)
        corners = [(u, v) for u in (-0.5, self.width - 0.5) for v in (-0.5, self.height - 0.5)]
        farthest = max(np.hypot((u - self.cx) / self.fx, (v - self.cy) / self.fy) for u, v in corners)
        margin = 1.0 + lenses.TANGENTIAL_SHARE * any(self.distortion[2:4]) if self.lens.tangential else 1.0
        return lenses.edge_angle(self.lens, self.distortion, float(margin * farthest))

    @cached_property
    def q_body_camera(self) -> np.ndarray:
        """Attitude of the optical frame in base_link (4,): yaw, then pitch, then roll about the optical axis."""
        pitch = np.radians(self.pitch_deg)
        forward = np.array([np.cos(pitch), 0.0, np.sin(pitch)])
        right = np.array([0.0, -1.0, 0.0])
        q_pitched = geometry.quaternion_from_matrix(np.stack([right, np.cross(forward, right), forward], axis=1))
        if self.yaw_deg == self.roll_deg == 0.0:
            return q_pitched
        q_yaw = geometry.quaternion_from_yaw(np.radians(self.yaw_deg))
        q_roll = geometry.quaternion_from_rotation_vector(np.array([0.0, 0.0, np.radians(self.roll_deg)]))
        return geometry.quaternion_multiply(geometry.quaternion_multiply(q_yaw, q_pitched), q_roll)

    @property
    def p_body_camera(self) -> np.ndarray:
        """Optical centre in base_link (3,), m."""
        return np.asarray(self.position)


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
    edge, lens = camera.half_angle, camera.lens
    inside = xp.where(theta < edge, theta, xp.full_like(theta, edge))
    beyond = theta - inside
    bent = lens.radius(inside, camera.distortion) + lens.slope(edge, camera.distortion) * beyond
    if lens.tangential:
        plane = xp.tan(inside)
        shift_x, shift_y = lens.tangential(plane * x / radius, plane * y / radius, camera.distortion)
        u = camera.cx + camera.fx * (bent * x / radius + shift_x)
        v = camera.cy + camera.fy * (bent * y / radius + shift_y)
    else:
        u = camera.cx + camera.fx * bent * x / radius
        v = camera.cy + camera.fy * bent * y / radius
    return xp.stack([u, v], axis=-1), theta


def inside_px(camera: Camera, pixels):
    """Return the distance (...) px of pixels (..., 2) from the border of the image, negative outside of it."""
    xp = array_namespace(pixels)
    u, v = pixels[..., 0] + 0.5, pixels[..., 1] + 0.5
    return xp.minimum(xp.minimum(u, camera.width - u), xp.minimum(v, camera.height - v))


def unproject(camera: Camera, pixels):
    """Return the unit rays (..., 3) in the optical frame of pixels (..., 2): the inverse of `project`."""
    xp = array_namespace(pixels)
    mx = (pixels[..., 0] - camera.cx) / camera.fx
    my = (pixels[..., 1] - camera.cy) / camera.fy
    lens, shift_x, shift_y = camera.lens, 0.0, 0.0
    if not lens.tangential or not any(camera.distortion[2:4]):
        return _ray(camera, mx, my)
    for _ in range(lenses.ITERATIONS):
        ray = _ray(camera, mx - shift_x, my - shift_y)
        ahead = xp.clip(ray[..., 2], np.cos(camera.half_angle), 1.0)
        before_x, before_y = shift_x, shift_y
        shift_x, shift_y = lens.tangential(ray[..., 0] / ahead, ray[..., 1] / ahead, camera.distortion)
        if lenses.has_converged(shift_x - before_x) and lenses.has_converged(shift_y - before_y):
            break
    return _ray(camera, mx - shift_x, my - shift_y)


def _ray(camera: Camera, mx, my):
    """Return the unit rays (..., 3) of points (...) of the image plane at a distance of 1, without tangential part."""
    xp, lens = array_namespace(mx), camera.lens
    bent = xp.sqrt(mx * mx + my * my + 1e-24)
    edge = camera.half_angle
    edge_bent = float(lens.radius(edge, camera.distortion))
    slope = float(lens.slope(edge, camera.distortion))
    inside = xp.where(bent < edge_bent, bent, xp.full_like(bent, edge_bent))
    theta = lenses.angle_of(lens, camera.distortion, inside, edge)
    theta = theta + (bent - inside) / slope
    sine = xp.sin(theta)
    return xp.stack([sine * mx / bent, sine * my / bent, xp.cos(theta)], axis=-1)


def world_to_camera(camera: Camera, p_world_body, q_world_body, points_world):
    """Return world points (..., 3) in the optical frame of the camera of a body at a pose."""
    points_body = geometry.rotate_inverse(q_world_body, points_world - p_world_body)
    xp = array_namespace(points_body)
    position, q_body_camera = xp.asarray(camera.p_body_camera), xp.asarray(camera.q_body_camera)
    return geometry.rotate_inverse(q_body_camera, points_body - position)
