"""Errors of the camera's calibration, estimated from the corners beside the filter (Friedland 1969).

A wrong calibration biases every observation, and through the filter its state. To first order both are linear in the
error c of the calibration: the state is wrong by V c, and an innovation by S c, where S = H V + B for the slopes H of
the observation with respect to the state and B with respect to c. V follows the filter, through its transitions F and
gains K: F V, then V - K S. The innovations of a filter that assumes c = 0 are thus observations of c with independent
noise, and their normal equations are summed up.

Which errors there are is found by forward selection: the one that explains most of the chi-square, then what explains
most of the rest. Errors that only a motion distinguishes, such as the focal length and the size of the gates, are thus
not spread over all of them while the vehicle stands on its podium.
"""

from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera, project
from swift_ros.corner_rays import plane_normal_to


@dataclass(frozen=True)
class Parameter:
    """An error that a calibration may have.

    Attributes:
        sigma: standard deviation before any observation.
        least: smallest value that is reported.
        sentence: with the place of the number, then of one of `words`.
        words: for a positive and for a negative value.
        unit: of the number, in the unit of the parameter.
    """

    sigma: float
    least: float
    sentence: str
    words: tuple[str, str]
    unit: float


DEGREE, PERCENT, MILLISECOND = float(np.radians(1.0)), 0.01, 0.001
PARAMETERS = {
    "focal": Parameter(0.1, 0.02, "a focal length {:.1f} % {} (fx, fy)", ("longer", "shorter"), PERCENT),
    "aspect": Parameter(0.05, 0.02, "a ratio of fx to fy {:.1f} % {}", ("larger", "smaller"), PERCENT),
    "radial": Parameter(
        0.1, 0.01, "a lens that images rays at 57 degrees {:.1f} degrees further {} (distortion)", ("out", "in"), DEGREE
    ),
    "pitch": Parameter(0.1, 0.02, "an optical axis {:.1f} degrees {} (pitch_deg, or cy)", ("higher", "lower"), DEGREE),
    "yaw": Parameter(
        0.1, 0.02, "an optical axis {:.1f} degrees further {} (yaw_deg, or cx)", ("left", "right"), DEGREE
    ),
    "roll": Parameter(0.1, 0.02, "a camera rolled by {:.1f} degrees {} (roll_deg)", ("more", "less"), DEGREE),
    "delay": Parameter(0.03, 0.008, "images exposed {:.0f} ms {} their stamps", ("after", "before"), MILLISECOND),
    "readout": Parameter(
        0.03, 0.008, "a rolling shutter that reads the rows in {:.0f} ms, {} row first", ("top", "bottom"), MILLISECOND
    ),
    "opening": Parameter(0.05, 0.02, "openings of the gates {:.1f} % {} (inner_side)", ("larger", "smaller"), PERCENT),
}
SIZE = len(PARAMETERS)
COLUMNS = {name: i for i, name in enumerate(PARAMETERS)}
PRIOR_INFORMATION = np.array([parameter.sigma**-2 for parameter in PARAMETERS.values()])
MIN_DEVIATIONS = 5.0  # standard deviations from zero at which an error is reported: nine errors are looked at often
MIN_RESIDUALS = 80  # ten images of a gate; fewer may be of something else
MIN_SHARE = 0.1  # of the chi-square that the first error explains, for a further one; second-order effects are below


def lens_slopes(camera: Camera, rays_body) -> np.ndarray:
    """Return the change (..., 8, 9) of the observed rays with the errors of lens and mount; other columns are zero.

    Args:
        camera: as assumed.
        rays_body: observed unit rays (..., 4, 3).
    """
    r_body_camera = geometry.rotation_matrix(camera.q_body_camera)
    rays_camera = rays_body @ r_body_camera
    x, y, z = rays_camera[..., 0], rays_camera[..., 1], rays_camera[..., 2]
    sine = np.maximum(np.hypot(x, y), 1e-9)
    theta = np.minimum(np.arctan2(sine, z), camera.half_angle)
    outwards = np.stack([z * x / sine, z * y / sine, -sine], axis=-1) @ r_body_camera.T
    around = np.stack([-y, x, np.zeros_like(x)], axis=-1) @ r_body_camera.T
    stretch = camera.lens.radius(theta, camera.distortion) / camera.lens.slope(theta, camera.distortion)
    cosine2, sine2 = (x * x - y * y) / sine**2, 2 * x * y / sine**2
    yaw = np.radians(camera.yaw_deg)
    shifts = {
        "focal": stretch[..., None] * outwards,
        "aspect": 0.5 * ((stretch * cosine2)[..., None] * outwards - sine2[..., None] * around),
        "radial": (theta**3)[..., None] * outwards,
        "pitch": rays_body @ geometry.skew(np.array([np.sin(yaw), -np.cos(yaw), 0.0])),  # rays x axis
        "yaw": rays_body @ geometry.skew(np.array([0.0, 0.0, 1.0])),
        "roll": rays_body @ geometry.skew(r_body_camera[:, 2]),
    }
    shift_body = np.zeros((*rays_body.shape, SIZE))
    for name, shift in shifts.items():
        shift_body[..., COLUMNS[name]] = shift
    slopes = plane_normal_to(rays_body) @ shift_body
    return slopes.reshape(*slopes.shape[:-3], 8, SIZE)


def calibration_slopes(camera: Camera, rays_body, corners_map, pose_slopes, twist_map) -> np.ndarray:
    """Return the change (..., 8, 9) of the residuals of gates with the errors PARAMETERS.

    Args:
        camera: as assumed.
        rays_body: observed unit rays (..., 4, 3).
        corners_map: corners of the associated gates (..., 4, 3), m.
        pose_slopes: of the expected rays with respect to the pose (..., 4, 2, 6), see `ray_residuals`.
        twist_map: velocity m/s and angular velocity rad/s of the body (6,) along map axes.
    """
    slopes = lens_slopes(camera, rays_body)
    delay = pose_slopes @ twist_map  # (..., 4, 2)
    row = project(camera, rays_body @ geometry.rotation_matrix(camera.q_body_camera))[0][..., 1]
    readout = delay * ((row + 0.5) / camera.height - 0.5)[..., None]
    arms = corners_map - corners_map.mean(axis=-2, keepdims=True)
    opening = -(pose_slopes[..., :3] @ arms[..., None])[..., 0]
    for name, column in (("delay", delay), ("readout", readout), ("opening", opening)):
        slopes[..., COLUMNS[name]] = column.reshape(*column.shape[:-2], 8)
    return slopes


@dataclass(frozen=True)
class Observation:
    """The corners of an image, as a filter sees them.

    Attributes:
        innovation: (m,), observed minus expected rays.
        covariance: of the innovation (m, m).
        state_slopes: H (m, state).
        calibration_slopes: B (m, 9).
    """

    innovation: np.ndarray
    covariance: np.ndarray
    state_slopes: np.ndarray
    calibration_slopes: np.ndarray


@dataclass(frozen=True)
class CalibrationEvidence:
    """What the innovations of a filter say about the calibration.

    Attributes:
        sensitivity: V (state, 9), change of the state's error with the errors of the calibration.
        information: (9, 9), of the normal equations.
        score: (9,), right side of the normal equations.
        chi_square: of all innovations.
        residuals: their number.
    """

    sensitivity: np.ndarray
    information: np.ndarray
    score: np.ndarray
    chi_square: float = 0.0
    residuals: int = 0

    @classmethod
    def none(cls, state_size: int) -> "CalibrationEvidence":
        """Return the evidence before the first image, for a filter with a state of `state_size`."""
        return cls(np.zeros((state_size, SIZE)), np.zeros((SIZE, SIZE)), np.zeros(SIZE))

    def predicted(self, transition) -> "CalibrationEvidence":
        """Return the evidence after a prediction of the filter with the matrix `transition`."""
        sensitivity = transition @ self.sensitivity
        return CalibrationEvidence(sensitivity, self.information, self.score, self.chi_square, self.residuals)

    def observed(self, observation: Observation, gain=None) -> "CalibrationEvidence":
        """Return the evidence after an image.

        Args:
            observation: of the filter.
            gain: of the filter (state, m); None when it refused the image.
        """
        slopes = observation.state_slopes @ self.sensitivity + observation.calibration_slopes
        both = np.column_stack([slopes, observation.innovation])
        weighted = np.linalg.solve(observation.covariance, both)
        return CalibrationEvidence(
            sensitivity=self.sensitivity if gain is None else self.sensitivity - gain @ slopes,
            information=self.information + slopes.T @ weighted[:, :-1],
            score=self.score + slopes.T @ weighted[:, -1],
            chi_square=self.chi_square + float(observation.innovation @ weighted[:, -1]),
            residuals=self.residuals + len(observation.innovation),
        )

    def errors(self) -> dict[str, tuple[float, float]]:
        """Return the errors of the calibration that explain the corners, with their standard deviations."""
        if self.residuals < MIN_RESIDUALS:
            return {}
        chosen: list[int] = []
        explained = first = 0.0  # chi-square by all chosen errors, by the first of them
        excess = 1.0  # of the chi-square that is left, relative to its expectation
        while len(chosen) < SIZE:
            gains = self._gains(chosen)
            best = int(np.argmax(gains))
            rest = max(1.0, (self.chi_square - explained - gains[best]) / max(self.residuals, 1))
            if gains[best] < max(MIN_DEVIATIONS**2 * rest, MIN_SHARE * first):
                break
            chosen.append(best)
            explained, first, excess = explained + gains[best], first or gains[best], rest
        covariance = self._covariance(chosen)
        values, deviations = covariance @ self.score[chosen], np.sqrt(excess * np.diag(covariance))
        names = [list(PARAMETERS)[i] for i in chosen]
        found = {name: (float(values[k]), float(deviations[k])) for k, name in enumerate(names)}
        return {name: error for name, error in found.items() if abs(error[0]) >= PARAMETERS[name].least}

    def _covariance(self, chosen: list[int]) -> np.ndarray:
        """Return the covariance (n, n) of n chosen errors, when the others are zero."""
        return np.linalg.inv(self.information[np.ix_(chosen, chosen)] + np.diag(PRIOR_INFORMATION[chosen]))

    def _gains(self, chosen: list[int]) -> np.ndarray:
        """Return the chi-square (9,) that each further error explains beside the chosen ones."""
        across = self.information[:, chosen] @ self._covariance(chosen)
        score = self.score - across @ self.score[chosen]
        information = np.diag(self.information) - np.sum(across * self.information[:, chosen], axis=1)
        gains = score**2 / (information + PRIOR_INFORMATION)
        gains[chosen] = 0.0
        return gains

    def sentences(self) -> dict[str, str]:
        """Return a sentence on each of these errors."""
        return {name: _sentence(PARAMETERS[name], *error) for name, error in self.errors().items()}


def _sentence(parameter: Parameter, value: float, deviation: float) -> str:
    number, spread = abs(value) / parameter.unit, deviation / parameter.unit
    said = parameter.sentence.format(number, parameter.words[value < 0])
    return f"against camera.yaml and track.yaml, the corners of the gates fit {said}; standard deviation {spread:.1f}"
