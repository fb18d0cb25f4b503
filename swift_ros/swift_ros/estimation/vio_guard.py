"""Checks visual-inertial odometry and converts it from its declared frames to odom -> base_link.

Each invalid sample is refused with a sentence: values that are not numbers, quaternions whose length is not one, stamps
that do not increase, speeds above the limit, poses that cannot follow from the last one (a jump), and stamps far after
it. After the first four the next valid sample is accepted. After a jump a sample is accepted when it follows from the
last accepted one again, or when the source has been consistent for `recover_s`. After a jump of the stamps it is then
accepted as it is. After a jump of the pose it is accepted at the last accepted position and heading, because the motion
in between is unknown.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros import geometry
from swift_ros.configuration import setting
from swift_ros.types import Odometry

FRAMES = ("body", "odom")
UNIT_LENGTH_TOLERANCE = 0.01  # a quaternion whose length differs more from 1 is refused


@dataclass(frozen=True)
class VioSettings:
    """Settings of the node vio."""

    velocity_frame: str = setting("frame of the source's linear velocity: body (its own) or odom (of its pose)")
    rate_frame: str = setting("frame of the source's angular velocity: body (its own) or odom (of its pose)")
    source_position: tuple[float, float, float] = setting("position of the source's body frame in base_link, m")
    source_rpy_deg: tuple[float, float, float] = setting(
        "orientation of the source's body frame in base_link: roll, pitch, yaw, degrees"
    )
    max_speed: float = setting("largest accepted speed, m/s", 0.1, 1000.0)
    max_acceleration: float = setting("largest accepted acceleration, m/s^2", 1.0, 10000.0)
    max_turn_rate: float = setting("largest accepted body rate, rad/s", 0.1, 1000.0)
    jump_m: float = setting("largest accepted jump of the position between two samples, m", 0.001, 100.0)
    jump_deg: float = setting("largest accepted jump of the attitude, degrees", 0.1, 180.0)
    longest_gap_s: float = setting("longest gap between two stamps that is accepted at once, s", 0.01, 1000.0)
    recover_s: float = setting("after a jump: time for which the source must be consistent, s", 0.0, 100.0)

    def __post_init__(self):
        for name in ("velocity_frame", "rate_frame"):
            if getattr(self, name) not in FRAMES:
                raise ValueError(f"'{name}' must be one of {', '.join(FRAMES)}, not '{getattr(self, name)}'")


@dataclass(frozen=True)
class CheckedOdometry:
    """Result of a check.

    Attributes:
        odometry: converted sample, None when it was refused.
        warning: a sentence for the operator, "" without one.
    """

    odometry: Odometry | None
    warning: str = ""


@dataclass
class _Lost:
    """A source after a jump: first and newest sample of the consistent samples since then."""

    first: Odometry
    newest: Odometry


class VioGuard:
    """Checks the samples of one source in their order.

    Args:
        settings: of the node vio.
    """

    def __init__(self, settings: VioSettings):
        self._settings = settings
        self._q_base_source = quaternion_from_rpy(np.radians(settings.source_rpy_deg))
        self._p_base_source = np.asarray(settings.source_position)
        self._last: Odometry | None = None
        self._lost: _Lost | None = None
        self._q_odom_source = np.array(
            [0.0, 0.0, 0.0, 1.0]
        )  # of the source's reference frame in odom, changed after a jump
        self._p_odom_source = np.zeros(3)

    def check(self, raw: Odometry) -> CheckedOdometry:
        """Return the result for a sample in the source's own frames."""
        warning = self._malformed(raw)
        if warning:
            return CheckedOdometry(None, warning)
        odometry = self._convert(raw)
        last = self._last
        if last is None:
            return self._accept(odometry)
        if self._lost is None:
            jump = self._jump(last, odometry)
            return self._refuse_jump(last, odometry, jump) if jump else self._accept(odometry)
        return self._after_jump(last, self._lost, odometry)

    def _refuse_jump(self, last: Odometry, odometry: Odometry, jump: str) -> CheckedOdometry:
        self._lost = _Lost(odometry, odometry)
        return CheckedOdometry(None, f"the odometry {jump}, within {_age(last, odometry)}; it was refused")

    def _accept(self, odometry: Odometry, warning: str = "") -> CheckedOdometry:
        self._last, self._lost = odometry, None
        return CheckedOdometry(odometry, warning)

    def _malformed(self, raw: Odometry) -> str:
        """Return why a single sample is refused, "" when it is valid."""
        values = (raw.p_world, raw.q_world_body, raw.v_body, raw.omega_body)
        for name, value in zip(("position", "quaternion", "velocity", "rate"), values, strict=True):
            if not np.isfinite(value).all():
                return f"the odometry's {name} is not a number; the sample was refused"
        length = float(np.linalg.norm(raw.q_world_body))
        if abs(length - 1.0) > UNIT_LENGTH_TOLERANCE:
            return f"the odometry's quaternion has length {length:.3f} instead of 1; the sample was refused"
        if self._last is not None and raw.stamp_ns <= self._last.stamp_ns:
            return (
                f"the odometry's stamps do not increase: {raw.stamp_ns * 1e-9:.3f} s after "
                f"{self._last.stamp_ns * 1e-9:.3f} s; the sample was refused"
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

    def _jump(self, before: Odometry, after: Odometry) -> str:
        """Return why `after` cannot follow from `before`, "" when it can."""
        s, dt = self._settings, (after.stamp_ns - before.stamp_ns) * 1e-9
        if not 0.0 < dt <= s.longest_gap_s:
            return "jumped in its stamps"
        predicted = before.p_world + dt * geometry.rotate(before.q_world_body, before.v_body)
        distance = float(np.linalg.norm(after.p_world - predicted))
        if distance > s.jump_m + 0.5 * s.max_acceleration * dt * dt:
            return f"jumped to {distance:.2f} m from the position that its velocity predicts"
        turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(before.q_world_body), after.q_world_body)
        angle = float(np.linalg.norm(geometry.rotation_vector_from_quaternion(turn)))
        if angle > np.radians(s.jump_deg) + s.max_turn_rate * dt:
            return f"jumped by {np.degrees(angle):.0f} degrees of attitude"
        return ""

    def _after_jump(self, last: Odometry, lost: _Lost, odometry: Odometry) -> CheckedOdometry:
        """Return the result for a valid sample after a jump from the last accepted sample."""
        jump = self._jump(last, odometry)
        if self._jump(lost.newest, odometry):
            if jump:
                return self._refuse_jump(last, odometry, jump)
            return self._accept(odometry, "the odometry is back at its predicted pose; it is accepted again")
        lost.newest = odometry
        consistent_s = (odometry.stamp_ns - lost.first.stamp_ns) * 1e-9
        if consistent_s < self._settings.recover_s:
            left_s = self._settings.recover_s - consistent_s
            return CheckedOdometry(None, f"the odometry jumped; it must be consistent for {left_s:.2f} s more")
        silence_s = (lost.first.stamp_ns - last.stamp_ns) * 1e-9
        if silence_s > self._settings.longest_gap_s:
            return self._accept(odometry, f"the odometry is accepted again after a gap of {silence_s:.1f} s")
        return self._accept(
            self._rejoin(last, odometry),
            f"the odometry is consistent again after a jump; it continues at its last accepted position, "
            f"{np.linalg.norm(odometry.p_world - last.p_world):.2f} m from that of its source",
        )

    def _rejoin(self, last: Odometry, odometry: Odometry) -> Odometry:
        """Return `odometry` in a new reference frame of the source.

        In that frame it has the position and heading of the last accepted sample.
        """
        yaw = geometry.yaw_of(last.q_world_body) - geometry.yaw_of(odometry.q_world_body)
        turn = geometry.quaternion_from_yaw(yaw)
        shift = last.p_world - geometry.rotate(turn, odometry.p_world)
        self._q_odom_source = geometry.quaternion_multiply(turn, self._q_odom_source)
        self._p_odom_source = geometry.rotate(turn, self._p_odom_source) + shift
        q_world_body = geometry.quaternion_multiply(turn, odometry.q_world_body)
        return replace(odometry, p_world=last.p_world, q_world_body=q_world_body)


def quaternion_from_rpy(rpy) -> np.ndarray:
    """Return q (4,) of rotations by yaw about z, pitch about the new y, and roll about the new x, rad."""
    roll, pitch, yaw = geometry.quaternion_from_rotation_vector(np.diag(rpy))
    return geometry.quaternion_multiply(geometry.quaternion_multiply(yaw, pitch), roll)


def _age(before: Odometry, after: Odometry) -> str:
    return f"{(after.stamp_ns - before.stamp_ns) * 1e-6:.0f} ms"
