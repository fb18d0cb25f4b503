"""State of the filter on corners at one time.

Error state, in map axes: position (3) m, attitude error of the odometry (3) rad, velocity (3) m/s, error of the
odometry's velocity (3) m/s, its scale error, bias of the accelerometer (3) m/s^2 in body axes.
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
        p_map: position (3,), m.
        v_map: velocity (3,), m/s.
        turn: rotation vector (3,) rad from the odometry's axes to those of the map, in map axes.
        error: of the odometry's velocity (3,), m/s.
        scale: scale error.
        bias: of the accelerometer (3,), m/s^2.
        covariance: (16, 16).
        disagreement: of accelerometer and odometry: mean of the squared innovations in units of their variance.
        evidence: on the calibration of the camera.
    """

    odometry: Odometry
    p_map: np.ndarray
    v_map: np.ndarray
    turn: np.ndarray
    error: np.ndarray
    scale: float
    bias: np.ndarray
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
        return cls(
            odometry=first,
            p_map=np.asarray(first.p_world),
            v_map=geometry.rotate(first.q_world_body, first.v_body),
            turn=np.zeros(3),
            error=np.zeros(3),
            scale=0.0,
            bias=np.zeros(3),
            covariance=np.diag(sigmas**2),
            disagreement=1.0,
            evidence=CalibrationEvidence.none(SIZE),
        )

    @property
    def q_map_body(self) -> np.ndarray:
        """Attitude (4,)."""
        q_turn = geometry.quaternion_from_rotation_vector(self.turn)
        return geometry.normalize(geometry.quaternion_multiply(q_turn, self.odometry.q_world_body))

    def corrected(self, step, **changes) -> "CornerState":
        """Return the state after a correction by an error state (16,), with the other `changes` that it brings."""
        before, turn = (geometry.quaternion_from_rotation_vector(each) for each in (self.turn, step[TURN]))
        return replace(
            self,
            p_map=self.p_map + step[POSITION],
            v_map=self.v_map + step[VELOCITY],
            turn=geometry.rotation_vector_from_quaternion(geometry.quaternion_multiply(turn, before)),
            error=self.error + step[ERROR],
            scale=self.scale + float(step[SCALE]),
            bias=self.bias + step[BIAS],
            **changes,
        )
