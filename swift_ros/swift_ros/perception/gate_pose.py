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
from swift_ros.corner_rays import corner_sigma_rad, plane_normal_to, ray_residuals
from swift_ros.track import CORNER_SIGNS
from swift_ros.types import GateCorners, IncompleteGate, RelativeGatePose

# Square: x right, y down, z along the passage as seen. Gate frame: x along the passage as seen, y left, z up.
R_SQUARE_GATE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
MIN_SINE = 1e-3  # of the angle between opposite corners: 0.06 to 179.94 degrees
STEPS = 4  # Gauss-Newton steps of the fit; their number is fixed, since all sets of corners are fitted together
DAMPING = 1e-3  # share by which the diagonal of the normal equations is increased: small, the steps are almost undamped
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
        gates, starts, warnings = self._start(gates)
        if not gates:
            return [], warnings
        corners_px = np.array([gate.corners_px for gate in gates], dtype=float)
        rays = unproject(self._camera, corners_px)
        positions, rotations = (np.array(part) for part in zip(*starts, strict=True))
        views = fit(self._corners_gate, rays[:, None], positions, rotations)
        s = self._settings
        sigma = corner_sigma_rad(rays, s.corner_sigma_deg, s.corner_sigma_share)
        error = views.error.min(axis=1)
        chi_square = 4 * (error / sigma) ** 2
        covariances = self._covariances(image_stamp_ns, rays, sigma, views)
        poses = []
        for i, gate in enumerate(gates):
            if chi_square[i] <= s.reprojection_gate:
                view = Views(views.position[i], views.rotation[i], views.error[i])
                poses.append(self._relative_pose(view, rays[i], covariances[i], float(np.min(gate.confidence))))
            else:
                warnings.append(
                    f"a detected gate is not a square: its corners are off by {np.degrees(error[i]):.1f} degrees, "
                    f"chi-square {chi_square[i]:.0f} of at most {s.reprojection_gate:g}; it was refused"
                )
        return poses, warnings

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
        """Return the gates that IPPE can solve, its solutions, and a sentence on each other gate."""
        solvable, starts, warnings = [], [], []
        for gate in gates:
            if not (np.isfinite(gate.corners_px).all() and np.isfinite(gate.confidence).all()):
                warnings.append("a detected gate has a corner that is not a number; it was refused")
                continue
            start = solve_square(self._inner_side, unproject(self._camera, np.asarray(gate.corners_px, dtype=float)))
            if start is None:
                warnings.append("a detected gate is too near or too flat for a pose; it was refused")
                continue
            solvable.append(gate)
            starts.append(start)
        return solvable, starts, warnings

    def _covariances(self, image_stamp_ns: int, rays, sigma, views: Views) -> np.ndarray:
        """Return the covariances (k, 3, 3) of the gates' positions along the axes of base_link, m^2.

        The rays (k, 4, 3) are perturbed by sigma (k,) rad, and each set is fitted again from the best pose.
        """
        count, gates = self._settings.samples, np.arange(len(rays))
        draws = np.random.default_rng(image_stamp_ns).standard_normal((len(rays), count, 4, 2))
        offsets = (draws[..., None, :] @ plane_normal_to(rays)[:, None])[..., 0, :]
        perturbed = geometry.normalize(rays[:, None] + sigma[:, None, None, None] * offsets)
        best = np.argmin(views.error, axis=1)
        samples = (
            fit(
                self._corners_gate,
                perturbed,
                views.position[gates, best][:, None],
                views.rotation[gates, best][:, None],
            ).p_camera_gate
            @ self._r_body_camera.T
        )
        spread = samples - samples.mean(axis=1, keepdims=True)
        return np.swapaxes(spread, 1, 2) @ spread / (count - 1) + MIN_VARIANCE * np.eye(3)

    def _relative_pose(self, views: Views, rays, covariance, confidence) -> RelativeGatePose:
        """Return the result for one gate from its two `views` and its rays (4, 3) in the optical frame."""
        best, other = np.argsort(views.error)
        p_body = views.p_camera_gate @ self._r_body_camera.T + self._camera.p_body_camera
        q_body_gate = geometry.quaternion_from_matrix(self._r_body_camera @ np.swapaxes(views.rotation, -1, -2))
        diagonal = 0.5 * (np.linalg.norm(rays[2] - rays[0]) + np.linalg.norm(rays[3] - rays[1]))
        return RelativeGatePose(
            p_body=p_body[best],
            q_body_gate=q_body_gate[best],
            covariance=covariance,
            rays_body=rays @ self._r_body_camera.T,
            confidence=confidence,
            reprojection_error=float(views.error[best] / diagonal),
            alternative_p_body=p_body[other],
            alternative_q_body_gate=q_body_gate[other],
            alternative_reprojection_error=float(views.error[other] / diagonal),
        )


def fit(corners_gate, rays_camera, position, rotation) -> Views:
    """Fit the pose of a camera in the frame of a gate to the rays to its corners.

    Damped Gauss-Newton steps; a step that increases the error is discarded.

    Args:
        corners_gate: corners (4, 3) in the frame of the gate, m.
        rays_camera: unit rays (..., 4, 3) in the optical frame.
        position: initial positions (..., 3), m.
        rotation: initial rotations (..., 3, 3).
    """
    shape = np.broadcast_shapes(rays_camera.shape[:-2], position.shape[:-1])
    rays = np.broadcast_to(rays_camera, (*shape, 4, 3))
    position, rotation = np.broadcast_to(position, (*shape, 3)), np.broadcast_to(rotation, (*shape, 3, 3))
    residuals, slopes, error = _residuals_of(corners_gate, rays, position, rotation)
    for _ in range(STEPS):
        normal = np.swapaxes(slopes, -1, -2) @ slopes
        normal = normal * (1.0 + DAMPING * np.eye(6)) + 1e-12 * np.eye(6)
        step = np.linalg.solve(normal, np.swapaxes(slopes, -1, -2) @ residuals[..., None])[..., 0]
        turn = geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(step[..., 3:]))
        tried = position + step[..., :3], turn @ rotation
        new = _residuals_of(corners_gate, rays, *tried)
        better = new[2] < error
        position = np.where(better[..., None], tried[0], position)
        rotation = np.where(better[..., None, None], tried[1], rotation)
        residuals = np.where(better[..., None], new[0], residuals)
        slopes = np.where(better[..., None, None], new[1], slopes)
        error = np.where(better, new[2], error)
    return Views(position, rotation, error)


def _residuals_of(corners_gate, rays, position, rotation):
    """Return residuals (..., 8), derivatives (..., 8, 6) and RMS over the corners (...) of a pose of the camera."""
    residuals, slopes, ahead = ray_residuals(rays, corners_gate, position, rotation, np.zeros(3))
    shape = residuals.shape[:-2]
    error = np.sqrt(np.sum(residuals**2, axis=(-2, -1)) / 4.0)
    return residuals.reshape(*shape, 8), slopes.reshape(*shape, 8, 6), np.where(ahead, error, np.inf)


def solve_square(inner_side: float, rays_camera) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the two solutions of IPPE for the pose of the camera in the frame of a gate.

    Near the image of its centre, where the diagonals intersect, a square looks like one without perspective: turned,
    shortened along one direction, and so tilted to either side. With the centre on the optical axis its distance, turn
    and tilt are the singular value decomposition of that image. OpenCV's IPPE is not used: where an edge is orthogonal
    to the line of sight, as in every view from the front, rounding errors make its rotations wrong or not a number.

    Args:
        inner_side: of the gate, m.
        rays_camera: unit rays (4, 3) to its corners in the optical frame.

    Returns:
        Positions (2, 3) m and rotations (2, 3, 3); None when opposite corners are nearly 0 or 180 degrees apart, or the
        corners are not those of a convex quadrilateral in their order.
    """
    turn = _turn_to_centre(rays_camera)
    turned = rays_camera @ turn.T
    across, ahead = turned[:, :2], turned[:, 2]
    lengths = np.linalg.norm(across, axis=-1)
    sines = ahead[:2] * lengths[2:] + ahead[2:] * lengths[:2]  # of the angles between opposite corners
    if sines.min() < MIN_SINE or np.sum(across[:2] * across[2:], axis=-1).max() >= 0.0:
        return None
    # Half diagonals at the distance 1 of the centre. Without perspective both halves of a diagonal are as long.
    to_left, to_right = across[:2] * (2.0 * lengths[2:] / sines)[:, None]
    image = np.stack([to_right - to_left, -to_left - to_right], axis=1) / inner_side  # of 1 m to the right and down
    if np.linalg.det(image) <= 0.0:
        return None
    outer, (nearness, shortened), inner = np.linalg.svd(image)
    cosine = shortened / nearness
    sine = np.sqrt(1.0 - cosine**2)
    tilts = np.array([[[1.0, 0.0, 0.0], [0.0, cosine, -s], [0.0, s, cosine]] for s in (sine, -sine)])
    r_turned_square = _about_axis(outer) @ tilts @ _about_axis(inner)
    r_gate_camera = R_SQUARE_GATE.T @ np.swapaxes(r_turned_square, -1, -2) @ turn
    return -(r_gate_camera @ turn[2]) / nearness, r_gate_camera


def _turn_to_centre(rays) -> np.ndarray:
    """Return the rotation (3, 3) of rays (4, 3) to a frame with z to the gate's centre and x along its upper edge."""
    centre = np.cross(np.cross(rays[0], rays[2]), np.cross(rays[1], rays[3]))  # on the planes of both diagonals
    centre = geometry.normalize(centre * np.sign(centre @ rays.sum(axis=0)))
    right = geometry.normalize(np.cross(np.cross(centre, rays[1] - rays[0]), centre))
    return np.stack([right, np.cross(centre, right), centre])


def _about_axis(turn) -> np.ndarray:
    """Return the rotation or reflection (3, 3) of space by one (2, 2) of the image plane."""
    full = np.eye(3)
    full[:2, :2] = turn
    return full
