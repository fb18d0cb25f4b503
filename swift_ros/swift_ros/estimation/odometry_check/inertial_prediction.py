"""Dead reckoning by the IMU while the odometry is refused, and the integrals of the IMU between two samples of it."""

from collections import deque

import numpy as np

from swift_ros import geometry
from swift_ros.types import ImuSample, Odometry
from swift_ros.vehicle import GRAVITY

KEPT = 1000  # IMU samples; 1 s at 1 kHz, more than the longest time between two samples of a working source
STALE_S = 0.05  # s; an older IMU sample says nothing about the present motion
STILL_RATE, STILL_FORCE = 0.1, 0.5  # rad/s, m/s^2: largest rate, and force less gravity, of a vehicle at rest
SMOOTHING_S = 0.2  # s, time constant of both; longer detects rest later, shorter takes noise for motion
STOPPING_S = 0.3  # s, time constant with which the velocity of a still vehicle goes to zero
UP = np.array([0.0, 0.0, 1.0])


class ImuBuffer:
    """The newest samples of the IMU, and whether the vehicle is still."""

    def __init__(self):
        self._samples: deque[ImuSample] = deque(maxlen=KEPT)
        self._omega, self._force = np.zeros(3), GRAVITY * UP

    def add(self, sample: ImuSample) -> None:
        """Add a sample; one that holds no numbers or does not follow the last one is ignored."""
        values = (*sample.omega_body, *sample.specific_force_body)
        if not np.isfinite(values).all() or (self._samples and sample.stamp_ns <= self._samples[-1].stamp_ns):
            return
        step_s = 1e-9 * (sample.stamp_ns - self._samples[-1].stamp_ns) if self._samples else SMOOTHING_S
        share = min(step_s / SMOOTHING_S, 1.0)
        self._omega = self._omega + share * (sample.omega_body - self._omega)
        self._force = self._force + share * (sample.specific_force_body - self._force)
        self._samples.append(sample)

    @property
    def is_still(self) -> bool:
        """Whether rate and specific force have been those of a vehicle at rest."""
        turning, pushed = np.linalg.norm(self._omega), abs(float(np.linalg.norm(self._force)) - GRAVITY)
        return bool(turning < STILL_RATE and pushed < STILL_FORCE)

    def stamps_between(self, begin_ns: int, end_ns: int) -> list[int]:
        """Return the stamps in (begin, end)."""
        return [sample.stamp_ns for sample in self._samples if begin_ns < sample.stamp_ns < end_ns]

    def mean(self, begin_ns: int, end_ns: int) -> ImuSample | None:
        """Return the mean sample of [begin, end], with the stamp of the newest of them.

        Where there is none, it is the last one before; None when that is stale.
        """
        inside, oldest_ns = [], min(begin_ns, end_ns - STALE_S * 1e9)
        for sample in reversed(self._samples):
            if sample.stamp_ns < (begin_ns if inside else oldest_ns):
                break
            if sample.stamp_ns <= end_ns:
                inside.append(sample)
        if not inside:
            return None
        omega = np.mean([sample.omega_body for sample in inside], axis=0)
        force = np.mean([sample.specific_force_body for sample in inside], axis=0)
        return ImuSample(inside[0].stamp_ns, omega, force)


def carried(state: Odometry, stamp_ns: int, imu: ImuBuffer) -> Odometry:
    """Return a state propagated to a later stamp from sample to sample of the IMU."""
    for sample_ns in imu.stamps_between(state.stamp_ns, stamp_ns):
        state = advanced(state, sample_ns, imu)
    return advanced(state, stamp_ns, imu)


def advanced(state: Odometry, stamp_ns: int, imu: ImuBuffer) -> Odometry:
    """Return a state propagated to a later stamp by the IMU; without it at constant velocity, which decays.

    dq/dt = q w / 2, dp/dt = v, dv/dt = R f - g e_z
    """
    dt = 1e-9 * (stamp_ns - state.stamp_ns)
    if dt <= 0:
        return state
    sample, v_world = imu.mean(state.stamp_ns, stamp_ns), geometry.rotate(state.q_world_body, state.v_body)
    q, acceleration = state.q_world_body, np.zeros(3)
    if sample is not None:
        half = geometry.quaternion_from_rotation_vector(0.5 * dt * sample.omega_body)
        middle = geometry.quaternion_multiply(q, half)
        acceleration = geometry.rotate(middle, sample.specific_force_body) - GRAVITY * UP
        q = geometry.normalize(geometry.quaternion_multiply(middle, half))
    p_world = state.p_world + dt * v_world + 0.5 * dt * dt * acceleration
    v_world = v_world + dt * acceleration
    if sample is None or imu.is_still:
        v_world = v_world * np.exp(-dt / STOPPING_S)
    omega = state.omega_body if sample is None else sample.omega_body
    return Odometry(stamp_ns, p_world, q, geometry.rotate_inverse(q, v_world), omega)
