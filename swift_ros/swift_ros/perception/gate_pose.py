"""Pose of each gate relative to the vehicle from its four corners in an image: undistortion and IPPE for squares.

Each image is processed independently and without a map. IPPE (Collins and Bartoli 2014) gives two poses of a square.
Both are refined by a least-squares fit to the corners: at distances up to 2 m the error of IPPE alone is 5 cm, and a
square with a wrong corner cannot be recognised; after the fit the error is 1 cm. Both poses are published. The
covariance of the position comes from 20 sets of perturbed corners (Methods).
"""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera, unproject
from swift_ros.configuration import setting
from swift_ros.corner_rays import axes_residuals, corner_sigma_rad, ray_axes
from swift_ros.track import CORNER_SIGNS
from swift_ros.types import GateCorners, IncompleteGate, RelativeGatePose

# Square: x right, y down, z along the passage as seen. Gate frame: x along the passage as seen, y left, z up.
R_SQUARE_GATE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
MIN_SINE = 1e-3  # of the angle between opposite corners: 0.06 to 179.94 degrees
STEPS = 4  # Gauss-Newton steps of the fit; their number is fixed, since all sets of corners are fitted together
DAMPED = 1.0 + 1e-3 * np.eye(6)  # factor of the normal equations; so little that the steps are almost undamped
REGULAR = 1e-12 * np.eye(6)  # added to the normal equations, which so have a solution at any pose
MIN_VARIANCE = 1e-6  # m^2, 1 mm squared; added to the covariance of the samples, so that it has an inverse


@dataclass(frozen=True)
class GatePoseSettings:
    """Settings of the node gate_pose."""

    corner_sigma_deg: float = setting("standard deviation of a corner's ray on each axis, degrees", 0.01, 10.0)
    corner_sigma_share: float = setting("part proportional to the angle of the gate's diagonal, relative", 0.0, 0.1)
    samples: int = setting("number of perturbed corner sets for the covariance", 4, 200)
    reprojection_gate: float = setting("largest reprojection chi-square (2 degrees of freedom)", 1.0, 1000.0)


@dataclass(frozen=True)
class Views:
    """Poses of a camera in the frame of a gate.

    Attributes:
        position: (..., 3), m.
        rotation: (..., 3, 3).
        error: RMS residual over the corners (...), rad.
    """

    position: np.ndarray
    rotation: np.ndarray
    error: np.ndarray

    @property
    def p_camera_gate(self) -> np.ndarray:
        """Centre of the gate (..., 3) in the optical frame, m."""
        return -(self.position[..., None, :] @ self.rotation)[..., 0, :]


class GatePoses:
    """Computes the poses of the gates in an image.

    Args:
        settings: of the node gate_pose.
        camera: the camera.
        inner_side: assumed for each gate, m; one of another size is further away in proportion.
    """

    def __init__(self, settings: GatePoseSettings, camera: Camera, inner_side: float):
        self._settings = settings
        self._camera = camera
        self._inner_side = inner_side
        self._corners_gate = 0.5 * inner_side * CORNER_SIGNS
        self._r_body_camera = geometry.rotation_matrix(camera.q_body_camera)

    def locate(self, image_stamp_ns: int, gates: list[GateCorners]) -> tuple[list[RelativeGatePose], list[str]]:
        """Return the poses of gates in base_link at the image's stamp, and a sentence on each refused gate.

        The perturbed corner sets come from a generator seeded by the stamp, so that the result is reproducible.
        """
        rays, confidence, starts, warnings = self._start(gates)
        if not len(rays):
            return [], warnings
        s, axes = self._settings, ray_axes(rays)
        views = fit(self._corners_gate, axes[:, None], *starts)
        sigma = corner_sigma_rad(rays, s.corner_sigma_deg, s.corner_sigma_share)
        error = views.error.min(axis=1)
        chi_square = 4 * (error / sigma) ** 2
        covariances = self._covariances(image_stamp_ns, axes, sigma, views)
        poses = self._relative_poses(views, rays, covariances, confidence)
        is_square = chi_square <= s.reprojection_gate
        warnings += [
            f"a detected gate is not a square: its corners are off by {np.degrees(error[i]):.1f} degrees, "
            f"chi-square {chi_square[i]:.0f} of at most {s.reprojection_gate:g}; it was refused"
            for i in np.flatnonzero(~is_square)
        ]
        return [pose for pose, good in zip(poses, is_square, strict=True) if good], warnings

    def rays(self, gates: list[GateCorners]) -> tuple[list[IncompleteGate], list[str]]:
        """Return the rays to the seen corners of incomplete gates, and a sentence on each refused gate."""
        found, warnings = [], []
        for gate in gates:
            seen = gate.seen
            if not 2 <= seen.sum() <= 3:
                warnings.append(f"an incomplete gate has {seen.sum()} corners instead of 2 or 3; it was refused")
                continue
            rays = np.full((4, 3), np.nan)
            rays[seen] = unproject(self._camera, gate.corners_px[seen]) @ self._r_body_camera.T
            found.append(IncompleteGate(rays, float(gate.confidence[seen].min())))
        return found, warnings

    def _start(self, gates: list[GateCorners]):
        """Return rays (k, 4, 3), confidence (k,) and IPPE's solutions of the gates that have any, and warnings."""
        finite = [gate for gate in gates if np.isfinite(gate.corners_px).all() and np.isfinite(gate.confidence).all()]
        warnings = ["a detected gate has a corner that is not a number; it was refused"] * (len(gates) - len(finite))
        if not finite:
            return (), (), (), warnings
        rays = unproject(self._camera, np.array([gate.corners_px for gate in finite], dtype=float))
        confidence = np.array([gate.confidence for gate in finite]).min(axis=1)
        solvable, positions, rotations = solve_square(self._inner_side, rays)
        flat = int(np.sum(~solvable))
        warnings += ["a detected gate is too near or too flat for a pose; it was refused"] * flat
        return rays[solvable], confidence[solvable], (positions[solvable], rotations[solvable]), warnings

    def _covariances(self, image_stamp_ns: int, axes, sigma, views: Views) -> np.ndarray:
        """Return the covariances (k, 3, 3) of the gates' positions along the axes of base_link, m^2.

        The rays, with their axes (k, 4, 3, 3), are perturbed by sigma (k,) rad; each set is fitted from the best pose.
        """
        count = self._settings.samples
        draws = np.random.default_rng(image_stamp_ns).standard_normal((len(axes), count, 4, 1, 2))
        offsets = (draws @ axes[:, None, :, :2])[..., 0, :]
        perturbed = geometry.normalize(axes[:, None, :, 2] + sigma[:, None, None, None] * offsets)
        best = np.arange(len(axes))[:, None], np.argmin(views.error, axis=1)[:, None]
        fitted = fit(self._corners_gate, ray_axes(perturbed), views.position[best], views.rotation[best])
        samples = fitted.p_camera_gate @ self._r_body_camera.T
        spread = samples - samples.mean(axis=1, keepdims=True)
        return np.swapaxes(spread, 1, 2) @ spread / (count - 1) + MIN_VARIANCE * np.eye(3)

    def _relative_poses(self, views: Views, rays, covariances, confidence) -> list[RelativeGatePose]:
        """Return the results for k gates from their `views` (k, 2) and their rays (k, 4, 3) in the optical frame."""
        order = np.argsort(views.error, axis=1)
        p_body = views.p_camera_gate @ self._r_body_camera.T + self._camera.p_body_camera
        q_body_gate = geometry.quaternion_from_matrix(self._r_body_camera @ np.swapaxes(views.rotation, -1, -2))
        diagonals = np.linalg.norm(rays[:, 2:] - rays[:, :2], axis=-1).mean(axis=1, keepdims=True)
        errors, rays_body = views.error / diagonals, rays @ self._r_body_camera.T
        return [
            RelativeGatePose(
                p_body=p_body[i, best],
                q_body_gate=q_body_gate[i, best],
                covariance=covariances[i],
                rays_body=rays_body[i],
                confidence=float(confidence[i]),
                reprojection_error=float(errors[i, best]),
                alternative_p_body=p_body[i, other],
                alternative_q_body_gate=q_body_gate[i, other],
                alternative_reprojection_error=float(errors[i, other]),
            )
            for i, (best, other) in enumerate(order)
        ]


def fit(corners_gate, axes_camera, position, rotation) -> Views:
    """Fit the pose of a camera in the frame of a gate to the rays to its corners.

    Damped Gauss-Newton steps; a step that increases the error is discarded.

    Args:
        corners_gate: corners (4, 3) in the frame of the gate, m.
        axes_camera: `ray_axes` (..., 4, 3, 3) of the rays in the optical frame.
        position: initial positions (..., 3), m.
        rotation: initial rotations (..., 3, 3).
    """
    shape = np.broadcast_shapes(axes_camera.shape[:-3], position.shape[:-1])
    position, rotation = np.broadcast_to(position, (*shape, 3)), np.broadcast_to(rotation, (*shape, 3, 3))
    residuals, slopes, error = _residuals_of(corners_gate, axes_camera, position, rotation)
    better = np.ones(shape, dtype=bool)
    for _ in range(STEPS):
        slopes_t = np.swapaxes(slopes, -1, -2)
        step = np.linalg.solve(slopes_t @ slopes * DAMPED + REGULAR, slopes_t @ residuals)[..., 0]
        tried = position + step[..., :3], _turned(rotation, step[..., 3:])
        residuals, slopes, new_error = _residuals_of(corners_gate, axes_camera, *tried)
        better &= new_error < error  # after a discarded step the next one would be the same: the pose is final
        position = np.where(better[..., None], tried[0], position)
        rotation = np.where(better[..., None, None], tried[1], rotation)
        error = np.where(better, new_error, error)
    return Views(position, rotation, error)


def _turned(rotation, rotation_vector):
    """Return rotations (..., 3, 3) turned by rotation vectors (..., 3) along the axes of their results (Rodrigues)."""
    squared = (np.vecdot(rotation_vector, rotation_vector) + 1e-30)[..., None, None]  # never 0
    angle = np.sqrt(squared)
    axis = geometry.skew(rotation_vector)
    once = axis @ rotation
    return rotation + np.sin(angle) / angle * once + (1.0 - np.cos(angle)) / squared * (axis @ once)


def _residuals_of(corners_gate, axes, position, rotation):
    """Return residuals (..., 8, 1), derivatives (..., 8, 6), RMS over the corners (...) of a pose of the camera."""
    arm = corners_gate - position[..., None, :]
    residuals, slopes, ahead = axes_residuals(axes, rotation, arm, arm)
    residuals = residuals.reshape(*ahead.shape[:-1], 8)
    error = np.where(ahead.all(axis=-1), np.sqrt(np.vecdot(residuals, residuals) / 4.0), np.inf)
    return residuals[..., None], slopes.reshape(*ahead.shape[:-1], 8, 6), error


def solve_square(inner_side: float, rays_camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the two solutions of IPPE for the pose of the camera in the frame of each gate.

    Near the image of its centre, where the diagonals intersect, a square looks like one without perspective: turned,
    shortened along one direction, and so tilted to either side. With the centre on the optical axis its distance, turn
    and tilt are the singular value decomposition of that image. OpenCV's IPPE is not used: where an edge is orthogonal
    to the line of sight, as in every view from the front, rounding errors make its rotations wrong or not a number.

    Args:
        inner_side: of the gates, m.
        rays_camera: unit rays (..., 4, 3) to their corners in the optical frame.

    Returns:
        Mask (...) of the gates with a solution, positions (..., 2, 3) m and rotations (..., 2, 3, 3). There is none
        when opposite corners are nearly 0 or 180 degrees apart, or the corners are not those of a convex quadrilateral
        in their order.
    """
    turn = _turn_to_centre(rays_camera)
    turned = rays_camera @ np.swapaxes(turn, -1, -2)
    across, ahead = turned[..., :2], turned[..., 2]
    lengths = np.linalg.norm(across, axis=-1)
    sines = ahead[..., :2] * lengths[..., 2:] + ahead[..., 2:] * lengths[..., :2]  # of angles between opposite corners
    solvable = (sines.min(axis=-1) >= MIN_SINE) & (np.vecdot(across[..., :2, :], across[..., 2:, :]).max(axis=-1) < 0.0)
    # Half diagonals at the distance 1 of the centre. Without perspective both halves of a diagonal are as long.
    halves = across[..., :2, :] * (2.0 * lengths[..., 2:] / np.maximum(sines, MIN_SINE))[..., None]
    to_left, to_right = halves[..., 0, :], halves[..., 1, :]
    image = np.stack([to_right - to_left, -to_left - to_right], axis=-1) / inner_side  # of 1 m to the right and down
    solvable &= np.linalg.det(image) > 0.0
    outer, scales, inner = np.linalg.svd(np.where(solvable[..., None, None], image, np.eye(2)))
    nearness, cosine = scales[..., :1], scales[..., 1:] / scales[..., :1]
    r_turned_square = _about_axis(outer) @ _tilts(cosine) @ _about_axis(inner)
    r_gate_camera = R_SQUARE_GATE.T @ np.swapaxes(r_turned_square, -1, -2) @ turn[..., None, :, :]
    return solvable, -np.matvec(r_gate_camera, turn[..., None, 2, :]) / nearness[..., None], r_gate_camera


def _turn_to_centre(rays) -> np.ndarray:
    """Return the rotations (..., 3, 3) of rays (..., 4, 3) to a frame with z to a gate's centre, x along its top."""
    planes = geometry.cross(rays[..., :2, :], rays[..., 2:, :])  # of both diagonals, which intersect at the centre
    centre = geometry.cross(planes[..., 0, :], planes[..., 1, :])
    centre = geometry.normalize(centre * np.sign(np.vecdot(centre, rays.sum(axis=-2)))[..., None])
    top = rays[..., 1, :] - rays[..., 0, :]
    right = geometry.normalize(top - np.vecdot(top, centre)[..., None] * centre)
    return np.stack([right, geometry.cross(centre, right), centre], axis=-2)


def _tilts(cosine) -> np.ndarray:
    """Return the rotations (..., 2, 3, 3) about x by plus and minus the angle of a cosine (..., 1)."""
    tilts = np.zeros((*cosine.shape[:-1], 2, 3, 3))
    tilts[..., 0, 0] = 1.0
    tilts[..., 1, 1] = tilts[..., 2, 2] = cosine
    tilts[..., 2, 1] = np.sqrt(1.0 - cosine**2) * [1.0, -1.0]
    tilts[..., 1, 2] = -tilts[..., 2, 1]
    return tilts


def _about_axis(turn) -> np.ndarray:
    """Return the rotations or reflections (..., 1, 3, 3) of space by those (..., 2, 2) of the image plane."""
    full = np.zeros((*turn.shape[:-2], 1, 3, 3))
    full[..., 0, :2, :2] = turn
    full[..., 2, 2] = 1.0
    return full
