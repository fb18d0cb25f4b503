"""Motion of the filter on corners: its state from one odometry to the next, by the accelerometer or by the odometry.

Odometry and map differ in the heading: v = (1 + scale) R_heading v_odometry + error. The error is a Gauss-Markov
process. Its standard deviation is a share of the speed and grows with the body rate, which blurs the images.

The velocity is the integral of the specific force, turned by the corrected attitude; the velocity of each odometry is a
measurement of it. Over tenths of a second the integral is the more accurate one. Over seconds it drifts with the errors
of attitude and accelerometer, which odometry and corners together observe. Without an accelerometer, and where it does
not agree with the odometry, the velocity is that of the odometry.

Samples of the accelerometer count from the stamp of the newest odometry on as not yet received. Otherwise a flight that
is played again would have another result.
"""

import math
from dataclasses import replace

import numpy as np

from swift_ros import geometry
from swift_ros.estimation.corner_state import (
    BIAS,
    ERROR,
    POSITION,
    SCALE,
    SIZE,
    TILT,
    TURN,
    VELOCITY,
    YAW,
    CornerState,
)
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.estimation.specific_force import SpecificForce
from swift_ros.estimation.velocity_path import LONGEST_STEP_S
from swift_ros.types import Odometry
from swift_ros.vehicle import GRAVITY

AGREEMENT_S = 1.0  # time constant of the mean by which accelerometer and odometry are compared
# Largest mean of the squared innovations in units of their variance. 1 is expected; it is 0.3 to 1.6 in races, and 36
# with an accelerometer in units of g.
MAX_DISAGREEMENT = 5.0
# Largest bias in units of its standard deviation; it is 0.9 to 1.7 in races. Other errors look like a bias: axes that
# are off by 2 degrees like one of 8, a scale that is off by 5 % like one of 10.
MAX_BIAS = 3.5
GRAVITY_MAP = np.array([0.0, 0.0, GRAVITY])
IDENTITY, IDENTITY_3 = np.eye(SIZE), np.eye(3)
STILL_SLOPES = IDENTITY[VELOCITY] - IDENTITY[ERROR]  # see `_velocity_slopes`


class CornerMotion:
    """The motion.

    Args:
        settings: of the estimator; `vio_*` describe the odometry, `imu_*` the accelerometer.
        forces: of the accelerometer; the caller adds its samples.
    """

    def __init__(self, settings: EstimatorSettings, forces: SpecificForce):
        self._settings = settings
        self._forces = forces

    def agrees(self, state: CornerState) -> bool:
        """Return whether accelerometer and odometry agree, as far as is known."""
        bias = max(map(abs, state.mean[BIAS].tolist()))
        return state.disagreement < MAX_DISAGREEMENT and bias <= MAX_BIAS * self._settings.imu_accel_bias

    def advanced(self, state: CornerState, odometry: Odometry, until_ns: int) -> CornerState:
        """Return the state at the stamp of a later odometry.

        Args:
            state: before.
            odometry: at whose stamp.
            until_ns: samples of the accelerometer from this stamp on are not used.
        """
        dt = 1e-9 * (odometry.stamp_ns - state.odometry.stamp_ns)
        if dt <= 0:
            return state
        push = self._forces.integral(state.odometry, odometry, until_ns) if dt <= LONGEST_STEP_S else None
        if push is None:
            return self._by_odometry(state, odometry, dt)
        by_force = self._with_measured_velocity(self._by_force(state, odometry, dt, push), dt)
        if self.agrees(by_force):
            return by_force
        by_odometry = self._by_odometry(state, odometry, dt)
        mean = by_odometry.mean.copy()
        mean[BIAS] = by_force.mean[BIAS]
        return replace(by_odometry, mean=mean, disagreement=by_force.disagreement)

    def _by_force(self, state: CornerState, odometry: Odometry, dt: float, push) -> CornerState:
        """Return the state after a step with an integral (3,) m/s of the specific force in the odometry's axes."""
        r_turn = geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(state.mean[TURN]))
        r_map_body = r_turn @ geometry.rotation_matrix(odometry.q_world_body)
        turned = r_turn @ push
        v_map = state.v_map + turned - dt * (r_map_body @ state.mean[BIAS] + GRAVITY_MAP)
        transition, noise = self._odometry_errors(odometry, dt)
        transition[VELOCITY, TURN] = -geometry.skew(turned)
        transition[VELOCITY, BIAS] = -dt * r_map_body
        transition[POSITION, TURN] = 0.5 * dt * transition[VELOCITY, TURN]
        transition[POSITION, VELOCITY] = dt * IDENTITY_3
        transition[POSITION, BIAS] = 0.5 * dt * transition[VELOCITY, BIAS]
        noise[VELOCITY] = (self._settings.imu_accel_sigma * dt) ** 2
        mean = transition.diagonal() * state.mean
        mean[POSITION] += 0.5 * dt * (state.v_map + v_map)
        mean[VELOCITY] = v_map
        return _moved(state, odometry, mean, transition, noise)

    def _by_odometry(self, state: CornerState, odometry: Odometry, dt: float) -> CornerState:
        """Return the state after a step with the odometry alone."""
        s = self._settings
        flown = _in_map(state, odometry.p_world - state.odometry.p_world)
        path, rate = math.hypot(*flown), math.hypot(*odometry.omega_body)
        transition, noise = self._odometry_errors(odometry, dt)
        error_time = s.vio_rate_memory_s * -math.expm1(-dt / s.vio_rate_memory_s)
        transition[POSITION, ERROR] = error_time * IDENTITY_3
        transition[POSITION, SCALE] = flown
        transition[POSITION, YAW] = -flown[1], flown[0], 0.0
        noise[POSITION] = s.vio_walk**2 * path * (1.0 + rate / s.vio_rotation_ref) + s.vio_still_walk**2 * dt
        measured = _measured_velocity(state, odometry)
        mean = transition.diagonal() * state.mean
        mean[POSITION] += (1.0 + mean[SCALE]) * flown + error_time * state.mean[ERROR]
        mean[VELOCITY] = (1.0 + mean[SCALE]) * measured + mean[ERROR]
        moved = _moved(state, odometry, mean, transition, noise)
        copy = IDENTITY.copy()
        copy[VELOCITY] -= _velocity_slopes(measured)
        covariance = copy @ moved.covariance @ copy.T
        covariance[VELOCITY, VELOCITY] += s.vio_velocity_sigma**2 * IDENTITY_3
        return replace(moved, covariance=covariance, evidence=moved.evidence.predicted(copy))

    def _odometry_errors(self, odometry: Odometry, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Return transition (16, 16) and noise (16,) of a step, as far as attitude and velocity of the odometry go."""
        s = self._settings
        keep_error, keep_tilt = math.exp(-dt / s.vio_rate_memory_s), math.exp(-dt / s.vio_tilt_memory_s)
        transition, noise = IDENTITY.copy(), np.zeros(SIZE)
        transition[ERROR, ERROR] *= keep_error
        transition[TILT, TILT] *= keep_tilt
        growth = 1.0 + math.hypot(*odometry.omega_body) / s.vio_rotation_ref
        share = s.vio_rate_share * math.hypot(*odometry.v_body)
        noise[ERROR] = share**2 * growth * (1.0 - keep_error**2)
        noise[TILT] = math.radians(s.vio_tilt_deg) ** 2 * (1.0 - keep_tilt**2)
        noise[YAW] = math.radians(s.vio_yaw_walk_deg) ** 2 * dt
        return transition, noise

    def _with_measured_velocity(self, state: CornerState, dt: float) -> CornerState:
        """Return the state after an update with the velocity of its odometry (Joseph form)."""
        measured = _measured_velocity(state, state.odometry)
        slopes = _velocity_slopes(measured)
        innovation = (1.0 + state.mean[SCALE]) * measured + state.mean[ERROR] - state.v_map
        variance = self._settings.vio_velocity_sigma**2
        across = slopes @ state.covariance
        precision = np.linalg.inv(across @ slopes.T + variance * IDENTITY_3)
        gain, squared = across.T @ precision, float(innovation @ precision @ innovation) / 3.0
        reduction = IDENTITY - gain @ slopes
        share = -math.expm1(-dt / AGREEMENT_S)
        return state.corrected(
            gain @ innovation,
            covariance=reduction @ state.covariance @ reduction.T + variance * gain @ gain.T,
            evidence=state.evidence.predicted(reduction),
            disagreement=state.disagreement + share * (squared - state.disagreement),
        )


def _measured_velocity(state: CornerState, odometry: Odometry) -> np.ndarray:
    """Return the velocity (3,) m/s of an odometry as it is, in map axes."""
    return _in_map(state, geometry.rotate(odometry.q_world_body, odometry.v_body))


def _in_map(state: CornerState, vector) -> np.ndarray:
    """Return a vector (3,) of the odometry's world in map axes."""
    return geometry.rotate(geometry.quaternion_from_yaw(state.mean[YAW]), vector)


def _velocity_slopes(measured) -> np.ndarray:
    """Return the change (3, 16) of the velocity less that of the odometry with the error state."""
    slopes = STILL_SLOPES.copy()
    slopes[:, SCALE] = -measured
    slopes[:2, YAW] = measured[1], -measured[0]
    return slopes


def _moved(state: CornerState, odometry: Odometry, mean, transition, noise) -> CornerState:
    """Return the state at the stamp of a later odometry, with a new mean (16,), by the transition and its noise."""
    covariance = transition @ state.covariance @ transition.T + np.diag(noise)
    evidence = state.evidence.predicted(transition)
    return CornerState(odometry, mean, covariance, state.disagreement, evidence)
