"""Whether the samples of an odometry agree with each other and with the IMU, over short and long times.

Three pairs must agree between any sample and earlier ones: the way and the integral of the velocity, the change of the
velocity and the integral of the specific force, the turn and the integral of the gyro. Noise and jumps differ at once,
ramps, frozen and replayed odometry within the longest of the times.
"""

import bisect
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swift_ros import geometry
from swift_ros.configuration import setting
from swift_ros.estimation.odometry_check.inertial_prediction import UP
from swift_ros.types import ImuSample, Odometry
from swift_ros.vehicle import GRAVITY

AGES_S = (0.0, 0.1, 0.3, 1.0)  # s, ages of the samples that a new one is compared with
SILENT_TURN_SHARE = 0.5  # `turn_share` where the IMU is silent: the source's own rates may be late
LONGEST_STEP_S = 0.1  # s, between two samples; after a longer one nothing is compared


@dataclass(frozen=True)
class AgreementLimits:
    """Largest differences, above the errors of good odometry in races; larger ones believe worse odometry."""

    way_m: float = setting("largest difference of way and integral of the velocity, m", 0.001, 100.0)
    way_per_root_m: float = setting("more of it, per square root of a metre of way: a random walk, m", 0.0, 10.0)
    velocity_m_s: float = setting("largest difference of velocity and integral of the specific force, m/s", 0.01, 100.0)
    velocity_share: float = setting("more of it, as a share of the speed", 0.0, 1.0)
    velocity_growth: float = setting("more of it for each second: gravity of a tilt error, m/s^2", 0.0, 100.0)
    turn_deg: float = setting("largest difference of turn and integral of the gyro, degrees", 0.1, 180.0)
    turn_share: float = setting("more of it, as a share of the angle turned", 0.0, 1.0)
    max_acceleration: float = setting("largest acceleration, where the IMU is silent, m/s^2", 1.0, 10000.0)


class _Integrals(NamedTuple):
    """Integrals since the first sample.

    Attributes:
        flown: of the velocity (3,), m.
        way: length of the way, m.
        pushed: of the specific force and gravity (3,), m/s.
        turned: of the gyro (4,).
        angle: angle turned, rad.
        gaps: number of steps without an IMU: velocities before and after one are not compared with it.
    """

    flown: np.ndarray
    way: float
    pushed: np.ndarray
    turned: np.ndarray
    angle: float
    gaps: int


@dataclass(frozen=True, slots=True)
class _Row:
    """A sample, and integrals since the first one.

    `start`, `start_velocity` and `heading` are the sample less an integral: constant as long as the samples agree.

    Attributes:
        odometry: the sample.
        time_s: its stamp, s.
        v_world: its velocity (3,), m/s.
        speed: m/s.
        integrals: up to it.
        start: position less `flown`, m.
        start_velocity: velocity less `pushed`, m/s.
        heading: attitude less `turned`, (4,).
        late_s: time before the sample that the IMU had not reached yet, s.
    """

    odometry: Odometry
    time_s: float
    v_world: np.ndarray
    speed: float
    integrals: _Integrals
    start: list[float]
    start_velocity: list[float]
    heading: list[float]
    late_s: float


class Agreement:
    """Samples of one source that agree.

    Attributes:
        begin_ns: stamp of the first sample, ns.
    """

    def __init__(self, limits: AgreementLimits, first: Odometry):
        self._limits = limits
        self.begin_ns = first.stamp_ns
        self._rows = deque([_first(first)])

    @property
    def newest(self) -> Odometry:
        """The newest sample."""
        return self._rows[-1].odometry

    def sample_before(self, age_s: float) -> Odometry:
        """Return the newest sample that is older than the newest one by `age_s`, or the oldest one."""
        return self._row_before(self._rows[-1].time_s - age_s).odometry

    def lasted_s(self, stamp_ns: int) -> float:
        """Return the time since the first sample, s."""
        return 1e-9 * (stamp_ns - self.begin_ns)

    def add(self, odometry: Odometry, imu: ImuSample | None) -> str:
        """Add a sample if it agrees; return why it does not, "" when it was added.

        Args:
            odometry: the sample.
            imu: mean since the newest sample, None without an IMU.
        """
        row = _next(self._rows[-1], odometry, imu)
        if row.time_s - self._rows[-1].time_s > LONGEST_STEP_S:
            return "comes after a gap"
        for age_s in AGES_S:
            difference = self._difference(self._row_before(row.time_s - age_s), row)
            if difference:
                return difference
        self._rows.append(row)
        while row.time_s - self._rows[1].time_s > AGES_S[-1]:
            self._rows.popleft()
        return ""

    def _row_before(self, time_s: float) -> _Row:
        """Return the newest row up to a time, or the oldest one."""
        count = bisect.bisect_right(self._rows, time_s, key=_time)
        return self._rows[max(count - 1, 0)]

    def _difference(self, earlier: _Row, row: _Row) -> str:
        """Return how a row differs from what follows from an earlier one, "" when it agrees."""
        limits, dt, has_imu = self._limits, row.time_s - earlier.time_s, row.integrals.gaps == earlier.integrals.gaps
        half = min(abs(sum(a * b for a, b in zip(earlier.heading, row.heading, strict=True))), 1.0)
        share = limits.turn_share if has_imu else SILENT_TURN_SHARE
        off_deg = 2.0 * math.degrees(math.acos(half))
        if off_deg > limits.turn_deg + share * math.degrees(row.integrals.angle - earlier.integrals.angle):
            return f"jumped by {off_deg:.0f} degrees of attitude"
        off_m = math.dist(earlier.start, row.start)
        if off_m > limits.way_m + limits.way_per_root_m * math.sqrt(row.integrals.way - earlier.integrals.way):
            return f"jumped to {off_m:.2f} m from the position that its velocity predicts"
        before, after = (r.start_velocity if has_imu else r.v_world for r in (earlier, row))
        off_m_s, growth = math.dist(before, after), limits.velocity_growth if has_imu else limits.max_acceleration
        speed = max(earlier.speed, row.speed)
        late = limits.max_acceleration * max(earlier.late_s, row.late_s)
        if off_m_s > limits.velocity_m_s + limits.velocity_share * speed + growth * dt + late:
            return f"changed its velocity by {off_m_s:.1f} m/s that no acceleration explains"
        return ""


def _time(row: _Row) -> float:
    return row.time_s


def _first(odometry: Odometry) -> _Row:
    """Return the first row."""
    v_world, still = geometry.rotate(odometry.q_world_body, odometry.v_body), np.array([0.0, 0.0, 0.0, 1.0])
    return _row(odometry, v_world, _Integrals(np.zeros(3), 0.0, np.zeros(3), still, 0.0, 0), 0.0)


def _next(last: _Row, odometry: Odometry, imu: ImuSample | None) -> _Row:
    """Return the row that follows.

    Where the IMU has not reached the sample yet, the source's own rates take the place of what is missing: a vehicle
    turns by several degrees in the time of one late sample.
    """
    dt = 1e-9 * odometry.stamp_ns - last.time_s
    v_world = geometry.rotate(odometry.q_world_body, odometry.v_body)
    before = last.integrals
    pushed, omega, late_s = before.pushed, 0.5 * (last.odometry.omega_body + odometry.omega_body), 0.0
    if imu is not None:
        middle = geometry.normalize(_sum(last.odometry.q_world_body, odometry.q_world_body))
        pushed = pushed + dt * (geometry.rotate(middle, imu.specific_force_body) - GRAVITY * UP)
        late_s = min(max(1e-9 * (odometry.stamp_ns - imu.stamp_ns), 0.0), dt)
        omega = imu.omega_body + (late_s / dt if late_s else 0.0) * (omega - imu.omega_body)
    turned = geometry.quaternion_multiply(before.turned, geometry.quaternion_from_rotation_vector(dt * omega))
    integrals = _Integrals(
        before.flown + 0.5 * dt * (v_world + last.v_world),
        before.way + dt * 0.5 * (last.speed + math.hypot(*v_world)),
        pushed,
        geometry.normalize(turned),
        before.angle + dt * math.hypot(*omega),
        before.gaps + (imu is None),
    )
    return _row(odometry, v_world, integrals, late_s)


def _row(odometry: Odometry, v_world, integrals: _Integrals, late_s: float) -> _Row:
    heading = geometry.quaternion_multiply(odometry.q_world_body, geometry.quaternion_conjugate(integrals.turned))
    return _Row(
        odometry,
        1e-9 * odometry.stamp_ns,
        v_world,
        math.hypot(*v_world),
        integrals,
        start=(odometry.p_world - integrals.flown).tolist(),
        start_velocity=(v_world - integrals.pushed).tolist(),
        heading=heading.tolist(),
        late_s=late_s,
    )


def _sum(q_a, q_b):
    """Return the sum of two quaternions of equal sign."""
    return q_a + q_b if float(q_a @ q_b) >= 0 else q_a - q_b
