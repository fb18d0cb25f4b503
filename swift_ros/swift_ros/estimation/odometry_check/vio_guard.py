"""Checks visual-inertial odometry and converts it from its declared frames to odom -> base_link.

A sample is believed when it agrees with the samples believed before it and with the IMU. Each other one is refused with
a sentence. After a refused sample the next one that agrees with the believed ones is accepted; for `BRIDGED_S` dead
reckoning takes the place of refused ones, so that a single outlier takes no state away from the pilot. When none came
for `agreement.LONGEST_STEP_S`, the source is lost: it is believed again when its samples have agreed with each other
and with the IMU for `recover_s`, and move as the vehicle does by dead reckoning. Then it continues at its own pose,
where that can be true, and otherwise at the pose of the dead reckoning, because its frame has changed.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros import geometry
from swift_ros.configuration import refuse_outside, setting
from swift_ros.estimation.odometry_check.agreement import Agreement, AgreementLimits
from swift_ros.estimation.odometry_check.inertial_prediction import UP, ImuBuffer, carried
from swift_ros.types import ImuSample, Odometry

FRAMES = ("body", "odom")
UNIT_LENGTH_TOLERANCE = 0.01  # a quaternion whose length differs more from 1 is refused
BRIDGED_S = 0.03  # s since the last believed sample; below the 50 ms without a state after which the link fails safe
ROLLBACK_S = 0.3  # s; dead reckoning begins so long before the first refused sample
MAX_RANGE_M = 1e5  # m, largest distance from the source's origin: no flight is as long, and sums keep their precision
# A source that was lost must move as the vehicle does by dead reckoning, within errors that grow with speed and with
# each second and are bounded: 5 standard deviations of both. Larger ones believe a source that slides; smaller ones
# refuse a good one after a long loss.
MOTION_M_S, MOTION_SHARE, MOTION_GROWTH, MAX_MOTION_M_S = 0.5, 0.02, 0.5, 1.5
MAX_TILT = 0.15  # rad; attitude errors of odometry are below 0.02 rad, those of a second of gyro below 0.05
# Its own position is believed within this distance of the dead reckoning: 5 standard deviations of the latter.
POSITION_M, POSITION_GROWTH, MAX_POSITION_M = 0.2, 0.5, 3.0


@dataclass(frozen=True)
class VioSettings(AgreementLimits):
    """Settings of the node vio."""

    velocity_frame: str = setting("frame of the source's linear velocity: body (its own) or odom (of its pose)")
    rate_frame: str = setting("frame of the source's angular velocity: body (its own) or odom (of its pose)")
    source_position: tuple[float, float, float] = setting(
        "position of the source's body frame in base_link, m", -1.0, 1.0
    )
    source_rpy_deg: tuple[float, float, float] = setting(
        "orientation of the source's body frame in base_link: roll, pitch, yaw, degrees", -360.0, 360.0
    )
    max_speed: float = setting("largest accepted speed, m/s", 0.1, 1000.0)
    recover_s: float = setting("time for which a lost source must agree with itself and the IMU, s", 0.05, 10.0)
    longest_gap_s: float = setting("longest gap between two stamps that is a silence, s", 0.1, 1000.0)

    def __post_init__(self):
        refuse_outside(FRAMES, velocity_frame=self.velocity_frame, rate_frame=self.rate_frame)


@dataclass(frozen=True)
class CheckedOdometry:
    """Result of a check.

    Attributes:
        odometry: converted sample, None when it was refused.
        warning: a sentence for the operator, "" without one.
        bridge: state by dead reckoning in place of a refused sample, None without one.
    """

    odometry: Odometry | None
    warning: str = ""
    bridge: Odometry | None = None


class VioGuard:
    """Checks the samples of one source in their order.

    Args:
        settings: of the node vio.
    """

    def __init__(self, settings: VioSettings):
        self._settings = settings
        self._q_base_source = quaternion_from_rpy(np.radians(settings.source_rpy_deg))
        self._p_base_source = np.asarray(settings.source_position)
        self._imu = ImuBuffer()
        self._believed: Agreement | None = None
        self._candidate: Agreement | None = None  # samples of a source that is not believed
        self._reckoned: Odometry | None = None  # by dead reckoning, while the source is not believed
        self._q_odom_source = np.array([0.0, 0.0, 0.0, 1.0])  # of the source's frame in odom, changed when it is found
        self._p_odom_source = np.zeros(3)

    def imu(self, sample: ImuSample) -> None:
        """Add a sample of the IMU, in the frame of base_link."""
        self._imu.add(sample)
        if self._reckoned is not None:
            self._reckoned = self._reckon(self._reckoned, sample.stamp_ns)

    def check(self, raw: Odometry) -> CheckedOdometry:
        """Return the result for a sample in the source's own frames."""
        checked = self._checked(raw)
        return checked if checked.odometry is not None else replace(checked, bridge=self._bridge(raw.stamp_ns))

    def _bridge(self, stamp_ns: int) -> Odometry | None:
        """Return the last believed sample, carried by the IMU to the stamp of a refused one shortly after it."""
        if self._believed is None:
            return None
        newest = self._believed.newest
        is_near = 0 < stamp_ns - newest.stamp_ns <= BRIDGED_S * 1e9
        has_imu = is_near and self._imu.mean(newest.stamp_ns, stamp_ns) is not None
        return carried(newest, stamp_ns, self._imu) if has_imu else None

    def _checked(self, raw: Odometry) -> CheckedOdometry:
        warning = self._malformed(raw)
        if warning:
            return CheckedOdometry(None, warning)
        odometry = self._convert(raw)
        if self._believed is None:
            return self._believe(Agreement(self._settings, odometry))
        imu = self._imu.mean(self._believed.newest.stamp_ns, odometry.stamp_ns)
        difference = self._believed.add(odometry, imu)
        if not difference:
            was_refused = self._candidate is not None
            warning = "the odometry agrees with its earlier samples; it is accepted again" if was_refused else ""
            return self._believe(self._believed, warning)
        return self._refuse(self._believed, odometry, difference)

    def _believe(self, agreement: Agreement, warning: str = "") -> CheckedOdometry:
        self._believed, self._candidate, self._reckoned = agreement, None, None
        return CheckedOdometry(agreement.newest, warning)

    def _reckon(self, reckoned: Odometry, stamp_ns: int) -> Odometry:
        """Return the pose by dead reckoning at a stamp; unchanged across a jump of the stamps."""
        if stamp_ns - reckoned.stamp_ns > self._settings.longest_gap_s * 1e9:
            return replace(reckoned, stamp_ns=stamp_ns)
        return carried(reckoned, stamp_ns, self._imu)

    def _refuse(self, agreement: Agreement, odometry: Odometry, difference: str) -> CheckedOdometry:
        """Return the result for a sample that does not agree with the believed ones."""
        believed, settings, candidate = agreement.newest, self._settings, self._candidate
        age_s = 1e-9 * (odometry.stamp_ns - believed.stamp_ns)
        # from an earlier sample: the last ones may have been wrong too, by less than the limits
        reckoned = self._reckoned or agreement.sample_before(ROLLBACK_S)
        reckoned = self._reckoned = self._reckon(reckoned, odometry.stamp_ns)
        if candidate is None:
            self._candidate = Agreement(settings, odometry)
            return CheckedOdometry(None, f"the odometry {difference}, within {1e3 * age_s:.0f} ms; it was refused")
        imu = self._imu.mean(candidate.newest.stamp_ns, odometry.stamp_ns)
        change = candidate.add(odometry, imu)
        if change:
            self._candidate = Agreement(settings, odometry)
            return CheckedOdometry(None, f"the odometry {change}; it was refused")
        left_s = settings.recover_s - candidate.lasted_s(odometry.stamp_ns)
        if left_s > 0:
            return CheckedOdometry(None, f"the odometry jumped; it must be consistent for {left_s:.2f} s more")
        silence_s = 1e-9 * (candidate.begin_ns - believed.stamp_ns)
        if not 0 <= silence_s <= settings.longest_gap_s:
            return self._believe(candidate, f"the odometry is accepted again after a gap of {silence_s:.1f} s")
        unlike = "" if imu is None else _unlike(odometry, reckoned, age_s)
        return CheckedOdometry(None, unlike) if unlike else self._rejoin(candidate, reckoned, age_s)

    def _rejoin(self, candidate: Agreement, reckoned: Odometry, lost_s: float) -> CheckedOdometry:
        """Believe a source that has agreed with itself and the IMU for long enough.

        Args:
            candidate: its samples.
            reckoned: pose by dead reckoning.
            lost_s: time since the last believed sample, s.
        """
        odometry = candidate.newest
        off_m = float(np.linalg.norm(odometry.p_world - reckoned.p_world))
        if off_m <= min(POSITION_M + POSITION_GROWTH * lost_s, MAX_POSITION_M):
            return self._believe(candidate, f"the odometry is accepted again after {lost_s:.1f} s")
        self._move_frame(odometry, reckoned)
        moved = replace(odometry, p_world=reckoned.p_world, q_world_body=self._turned(odometry, reckoned))
        return self._believe(
            Agreement(self._settings, moved),
            f"the odometry is consistent again after a jump; it continues where the vehicle is by dead reckoning, "
            f"{off_m:.2f} m from its own position",
        )

    def _malformed(self, raw: Odometry) -> str:
        """Return why a single sample is refused, "" when it is valid."""
        values = (raw.p_world, raw.q_world_body, raw.v_body, raw.omega_body)
        for name, value in zip(("position", "quaternion", "velocity", "rate"), values, strict=True):
            if not np.isfinite(value).all():
                return f"the odometry's {name} is not a number; the sample was refused"
        far = float(np.abs(raw.p_world).max())
        if far > MAX_RANGE_M:
            return f"the odometry's position is {far:.3g} m from its origin; the sample was refused"
        length = float(np.linalg.norm(raw.q_world_body))
        if abs(length - 1.0) > UNIT_LENGTH_TOLERANCE:
            return f"the odometry's quaternion has length {length:.3f} instead of 1; the sample was refused"
        last_ns = -1 if self._believed is None else self._believed.newest.stamp_ns
        if raw.stamp_ns <= last_ns:
            return (
                f"the odometry's stamps do not increase: {raw.stamp_ns * 1e-9:.3f} s after "
                f"{last_ns * 1e-9:.3f} s; the sample was refused"
            )
        speed = float(np.linalg.norm(raw.v_body))
        if speed > self._settings.max_speed:
            return f"the odometry reports {speed:.1f} m/s, above {self._settings.max_speed:g}; the sample was refused"
        return ""

    def _convert(self, raw: Odometry) -> Odometry:
        """Return a sample as odom -> base_link with the twist in base_link."""
        q_odom_source = geometry.normalize(geometry.quaternion_multiply(self._q_odom_source, raw.q_world_body))
        q_source_base = geometry.quaternion_conjugate(self._q_base_source)
        q_odom_base = geometry.quaternion_multiply(q_odom_source, q_source_base)
        s, raw_v, raw_omega = self._settings, raw.v_body, raw.omega_body
        v_source = raw_v if s.velocity_frame == "body" else geometry.rotate_inverse(raw.q_world_body, raw_v)
        omega_source = raw_omega if s.rate_frame == "body" else geometry.rotate_inverse(raw.q_world_body, raw_omega)
        omega_base = geometry.rotate(self._q_base_source, omega_source)
        p_source = geometry.rotate(self._q_odom_source, raw.p_world) + self._p_odom_source
        return Odometry(
            stamp_ns=raw.stamp_ns,
            p_world=p_source - geometry.rotate(q_odom_base, self._p_base_source),
            q_world_body=q_odom_base,
            v_body=geometry.rotate(self._q_base_source, v_source) - np.cross(omega_base, self._p_base_source),
            omega_body=omega_base,
        )

    def _move_frame(self, odometry: Odometry, reckoned: Odometry) -> None:
        """Move the source's frame in odom, so that its pose has the position and heading of the dead reckoning."""
        turn = _yaw_between(odometry, reckoned)
        shift = reckoned.p_world - geometry.rotate(turn, odometry.p_world)
        self._q_odom_source = geometry.quaternion_multiply(turn, self._q_odom_source)
        self._p_odom_source = geometry.rotate(turn, self._p_odom_source) + shift

    def _turned(self, odometry: Odometry, reckoned: Odometry) -> np.ndarray:
        return geometry.quaternion_multiply(_yaw_between(odometry, reckoned), odometry.q_world_body)


def quaternion_from_rpy(rpy) -> np.ndarray:
    """Return q (4,) of rotations by yaw about z, pitch about the new y, and roll about the new x, rad."""
    roll, pitch, yaw = geometry.quaternion_from_rotation_vector(np.diag(rpy))
    return geometry.quaternion_multiply(geometry.quaternion_multiply(yaw, pitch), roll)


def _unlike(odometry: Odometry, reckoned: Odometry, lost_s: float) -> str:
    """Return how the motion differs from that of the dead reckoning since `lost_s`, "" when it agrees."""
    faster, speed = (float(np.linalg.norm(v)) for v in (odometry.v_body - reckoned.v_body, reckoned.v_body))
    if faster > min(MOTION_M_S + MOTION_SHARE * speed + MOTION_GROWTH * lost_s, MAX_MOTION_M_S):
        return f"the odometry moves by {faster:.1f} m/s unlike the IMU; it was refused"
    up, up_reckoned = (geometry.rotate_inverse(each.q_world_body, UP) for each in (odometry, reckoned))
    return "the odometry leans unlike the IMU; it was refused" if np.linalg.norm(up - up_reckoned) > MAX_TILT else ""


def _yaw_between(odometry: Odometry, reckoned: Odometry) -> np.ndarray:
    """Return the rotation about z from the heading of the odometry to that of the dead reckoning."""
    return geometry.quaternion_from_yaw(geometry.yaw_of(reckoned.q_world_body) - geometry.yaw_of(odometry.q_world_body))
