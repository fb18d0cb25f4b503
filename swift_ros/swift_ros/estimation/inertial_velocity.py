"""The velocity of the odometry, smoothed by the accelerometer.

Over tenths of a second the integral of the specific force is more accurate than the velocity of visual-inertial
odometry. Over seconds it drifts with the tilt error of the odometry's attitude and the bias of the accelerometer. A
Kalman filter on these errors weighs both. Without an IMU, and where it does not agree with the odometry, the velocity
is the odometry's own.

The filter uses the samples of the IMU before the newest odometry. That of the same stamp may still be on its way, and a
flight that is played again has to give the same velocities.

Error state, in the axes of the odometry's frame: velocity of the integral (3) m/s, tilt (2) rad, bias of the
accelerometer (3) m/s^2 in body axes, velocity of the odometry (3) m/s, a Gauss-Markov process.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from swift_ros import geometry
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.timeline import interpolate
from swift_ros.types import ImuSample, Odometry
from swift_ros.vehicle import GRAVITY

INTEGRAL, TILT, BIAS, ODOMETRY = slice(0, 3), slice(3, 5), slice(5, 8), slice(8, 11)  # rows of the error state
SIZE = 11  # of the error state
OBSERVED = np.hstack([np.eye(3), np.zeros((3, 5)), np.eye(3)])  # odometry's velocity less the integral
KEPT = 1000  # samples of the IMU: 1 s at 1 kHz
LONGEST_STEP_S = 0.05  # longer gaps, of odometry or IMU, begin the filter anew
AGREEMENT_S = 1.0  # time constant of the mean by which the two are compared
# Largest mean of the squared innovations in units of their variance. 1 is expected; it is 0.5 to 1.4 in races, and 27
# with an accelerometer in units of g.
MAX_DISAGREEMENT = 5.0
# Largest bias in units of its standard deviation. Other errors look like a bias: axes that are off by 2 degrees like
# one of 5, a scale that is off by 5 % like one of 7. From there on the odometry's own velocity is the better one.
MAX_BIAS = 3.5
GRAVITY_WORLD = np.array([0.0, 0.0, GRAVITY])


@dataclass(frozen=True)
class Errors:
    """State of the filter at the stamp of `odometry`.

    Attributes:
        odometry: of the source.
        integral: velocity (3,) m/s, the integral of the specific force.
        mean: error state (11,).
        covariance: (11, 11).
    """

    odometry: Odometry
    integral: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray


class InertialVelocity:
    """The filter.

    Args:
        settings: of the estimator; its `vio_*` describe the odometry, its `imu_*` the accelerometer.

    Attributes:
        is_inertial: whether the last velocity is that of the filter, and not the odometry's own.
    """

    is_inertial = False

    def __init__(self, settings: EstimatorSettings):
        self._settings = settings
        self._tilt = np.radians(settings.vio_tilt_deg)
        self._samples: deque[ImuSample] = deque(maxlen=KEPT)
        self._errors: Errors | None = None
        self._newest: Odometry | None = None
        self._newest_ns = -1
        self._disagreement = 1.0

    def imu(self, sample: ImuSample) -> None:
        """Add a sample in body axes; one without numbers, or that does not follow the last one, is ignored."""
        follows = not self._samples or sample.stamp_ns > self._samples[-1].stamp_ns
        if follows and np.isfinite(sample.specific_force_body).all():
            self._samples.append(sample)

    def add(self, odometry: Odometry) -> Odometry:
        """Return the odometry with the smoothed velocity. Stamps must increase."""
        before, self._newest, self._newest_ns = self._newest, odometry, odometry.stamp_ns
        if before is None:
            return odometry
        self._errors = self._errors_at(before, self._errors)
        ahead = self._predict(self._errors, odometry)
        while len(self._samples) > 1 and self._samples[1].stamp_ns <= before.stamp_ns:
            self._samples.popleft()
        self.is_inertial = ahead is not None and self.agrees
        if ahead is None or not self.is_inertial:
            return odometry
        velocity = ahead.integral + ahead.mean[INTEGRAL]
        return replace(odometry, v_body=geometry.rotate_inverse(odometry.q_world_body, velocity))

    @property
    def agrees(self) -> bool:
        """Whether the accelerometer agrees with the odometry, as far as is known."""
        bias = 0.0 if self._errors is None else float(np.abs(self._errors.mean[BIAS]).max())
        return self._disagreement < MAX_DISAGREEMENT and bias <= MAX_BIAS * self._settings.imu_accel_bias

    def _errors_at(self, odometry: Odometry, last: Errors | None) -> Errors:
        """Return the state at an odometry whose samples of the IMU have come, corrected by its velocity."""
        ahead = None if last is None else self._predict(last, odometry)
        if last is None or ahead is None:
            return self._begin(odometry)
        return self._corrected(ahead, 1e-9 * (odometry.stamp_ns - last.odometry.stamp_ns))

    def _begin(self, odometry: Odometry) -> Errors:
        s, speed = self._settings, float(np.linalg.norm(odometry.v_body))
        velocity = s.vio_velocity_sigma + s.vio_rate_share * speed
        sigmas = np.repeat([velocity, self._tilt, s.imu_accel_bias, velocity], [3, 2, 3, 3])
        integral = geometry.rotate(odometry.q_world_body, odometry.v_body)
        return Errors(odometry, integral, np.zeros(SIZE), np.diag(sigmas**2))

    def _predict(self, errors: Errors, odometry: Odometry) -> Errors | None:
        """Return the state at a later odometry; None where that or the IMU comes after a gap."""
        before, s = errors.odometry, self._settings
        dt = 1e-9 * (odometry.stamp_ns - before.stamp_ns)
        push = self._specific_force(before, odometry) if dt <= LONGEST_STEP_S else None
        if push is None:
            return None
        keep_tilt, keep_odometry = np.exp(-dt / s.vio_tilt_memory_s), np.exp(-dt / s.vio_rate_memory_s)
        transition = np.eye(SIZE)
        transition[INTEGRAL, TILT] = -geometry.skew(push)[:, :2]
        transition[INTEGRAL, BIAS] = -dt * geometry.rotation_matrix(odometry.q_world_body)
        transition[TILT, TILT] *= keep_tilt
        transition[ODOMETRY, ODOMETRY] *= keep_odometry
        growth = 1.0 + float(np.linalg.norm(odometry.omega_body)) / s.vio_rotation_ref
        noise = np.zeros(SIZE)
        noise[INTEGRAL] = (s.imu_accel_sigma * dt) ** 2
        noise[TILT] = self._tilt**2 * (1.0 - keep_tilt**2)
        share = s.vio_rate_share * float(np.linalg.norm(odometry.v_body))
        noise[ODOMETRY] = share**2 * growth * (1.0 - keep_odometry**2)
        return Errors(
            odometry=odometry,
            integral=errors.integral + push - dt * GRAVITY_WORLD,
            mean=transition @ errors.mean,
            covariance=transition @ errors.covariance @ transition.T + np.diag(noise),
        )

    def _specific_force(self, before: Odometry, after: Odometry) -> np.ndarray | None:
        """Return the integral (3,) m/s of the specific force between two samples of the odometry; None after a gap."""
        stamps = np.array([sample.stamp_ns for sample in self._samples if sample.stamp_ns < self._newest_ns])
        if not stamps.size or 1e-9 * (after.stamp_ns - stamps[-1]) > LONGEST_STEP_S:
            return None
        inside = stamps[(stamps > before.stamp_ns) & (stamps < after.stamp_ns)]
        times = np.array([before.stamp_ns, *inside, after.stamp_ns])
        forces = np.array([sample.specific_force_body for sample in self._samples])[: stamps.size]
        poses = [before, *(interpolate(before, after, int(stamp)) for stamp in inside), after]
        at_times = np.stack([np.interp(times, stamps, axis) for axis in forces.T], axis=-1)
        in_world = geometry.rotate(np.array([pose.q_world_body for pose in poses]), at_times)
        return np.trapezoid(in_world, 1e-9 * (times - times[0]), axis=0)

    def _corrected(self, errors: Errors, dt: float) -> Errors:
        """Return the state after an update with the odometry's own velocity (Joseph form)."""
        measured = geometry.rotate(errors.odometry.q_world_body, errors.odometry.v_body) - errors.integral
        variance = self._settings.vio_velocity_sigma**2
        innovation = measured - OBSERVED @ errors.mean
        spread = OBSERVED @ errors.covariance @ OBSERVED.T + variance * np.eye(3)
        gain = np.linalg.solve(spread, OBSERVED @ errors.covariance).T
        squared = float(innovation @ np.linalg.solve(spread, innovation)) / 3.0
        self._disagreement += -np.expm1(-dt / AGREEMENT_S) * (squared - self._disagreement)
        reduction = np.eye(SIZE) - gain @ OBSERVED
        return replace(
            errors,
            mean=errors.mean + gain @ innovation,
            covariance=reduction @ errors.covariance @ reduction.T + variance * gain @ gain.T,
        )
