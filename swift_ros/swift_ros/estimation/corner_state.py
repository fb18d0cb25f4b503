"""State of the filter on corners at one time.

State and error state have the same rows, in map axes: position (3) m, rotation vector (3) rad from the odometry's axes
to those of the map, velocity (3) m/s, error of the odometry's velocity (3) m/s, its scale error, bias of the
accelerometer (3) m/s^2 in body axes.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros import geometry
from swift_ros.estimation.calibration_evidence import CalibrationEvidence
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry

POSITION, TURN, VELOCITY, ERROR, BIAS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(13, 16)
TILT, YAW, SCALE = slice(3, 5), 5, 12
SIZE = 16
POSE = slice(0, 6)


@dataclass(frozen=True)
class CornerState:
    """The state at the stamp of `odometry`.

    Attributes:
        odometry: newest odometry.
        mean: (16,).
        covariance: (16, 16).
        disagreement: of accelerometer and odometry: mean of the squared innovations in units of their variance.
        evidence: on the calibration of the camera.
    """

    odometry: Odometry
    mean: np.ndarray
    covariance: np.ndarray
    disagreement: float
    evidence: CalibrationEvidence

    @classmethod
    def begin(cls, settings: EstimatorSettings, first: Odometry) -> "CornerState":
        """Return the state at the first odometry, in the map."""
        tilt, speed = np.radians(settings.vio_tilt_deg), float(np.linalg.norm(first.v_body))
        error = float(np.hypot(settings.vio_velocity_sigma, settings.vio_rate_share * speed))
        sigmas = np.zeros(SIZE)
        sigmas[POSITION] = settings.start_sigma_m
        sigmas[TURN] = tilt, tilt, np.radians(settings.start_yaw_sigma_deg)
        sigmas[VELOCITY] = sigmas[ERROR] = error
        sigmas[SCALE] = settings.vio_scale
        sigmas[BIAS] = settings.imu_accel_bias
        mean = np.zeros(SIZE)
        mean[POSITION], mean[VELOCITY] = first.p_world, geometry.rotate(first.q_world_body, first.v_body)
        return cls(
            odometry=first,
            mean=mean,
            covariance=np.diag(sigmas**2),
            disagreement=1.0,
            evidence=CalibrationEvidence.none(SIZE),
        )

    @property
    def p_map(self) -> np.ndarray:
        """Position (3,), m."""
        return self.mean[POSITION]

    @property
    def v_map(self) -> np.ndarray:
        """Velocity (3,), m/s."""
        return self.mean[VELOCITY]

    @property
    def q_map_body(self) -> np.ndarray:
        """Attitude (4,)."""
        q_turn = geometry.quaternion_from_rotation_vector(self.mean[TURN])
        return geometry.normalize(geometry.quaternion_multiply(q_turn, self.odometry.q_world_body))

    def corrected(self, step, **changes) -> "CornerState":
        """Return the state after a correction by an error state (16,), with the other `changes` that it brings."""
        before, turn = (geometry.quaternion_from_rotation_vector(each[TURN]) for each in (self.mean, step))
        mean = self.mean + step
        mean[TURN] = geometry.rotation_vector_from_quaternion(geometry.quaternion_multiply(turn, before))
        return replace(self, mean=mean, **changes)
