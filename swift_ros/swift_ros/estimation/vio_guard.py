"""What may pass as odometry: any declared frames are turned into odom -> base_link with the twist in the body frame,
once, and a source that cannot be believed is refused, sample by sample, with a sentence.

Refused are values that are not numbers, quaternions that are not of length one, stamps that do not advance, speeds
beyond the limit, and poses that cannot follow from the last ones (a teleport) or stamps far ahead of them. The first
four recover with the next good sample. After a leap the source is believed again as soon as it is back where it should
be; or, when it has agreed with itself for `recover_s`: after a leap of its stamps as it is, after a teleport from where
it was lost, heading kept, for what it moved meanwhile is not known.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros import geometry
from swift_ros.configuration import setting
from swift_ros.types import Odometry

FRAMES = ("body", "odom")


@dataclass(frozen=True)
class VioSettings:
    velocity_frame: str = setting("frame of the source's linear velocity: body (its own) or odom (of its pose)")
    rate_frame: str = setting("frame of the source's angular velocity: body (its own) or odom (of its pose)")
    source_position: tuple[float, float, float] = setting("where the source's body frame sits in base_link, m")
    source_rpy_deg: tuple[float, float, float] = setting("how it is turned there: roll, pitch, yaw, degrees")
    max_speed: float = setting("fastest speed that is believed, m/s", 0.1, 1000.0)
    max_acceleration: float = setting("strongest acceleration that is believed, m/s^2", 1.0, 10000.0)
    max_turn_rate: float = setting("fastest turn that is believed, rad/s", 0.1, 1000.0)
    jump_m: float = setting("jump from one sample to the next that is no teleport yet, m", 0.001, 100.0)
    jump_deg: float = setting("the same in attitude, degrees", 0.1, 180.0)
    longest_gap_s: float = setting("longest silence after which a stamp is believed at once, s", 0.01, 1000.0)
    recover_s: float = setting("after a leap: how long the source must agree with itself, s", 0.0, 100.0)

    def __post_init__(self):
        for name in ("velocity_frame", "rate_frame"):
            if getattr(self, name) not in FRAMES:
                raise ValueError(f"'{name}' must be one of {', '.join(FRAMES)}, not '{getattr(self, name)}'")


@dataclass(frozen=True)
class Checked:
    """The sample to hand on, or None where it was refused; and a sentence where there is something to say."""

    odometry: Odometry | None
    complaint: str = ""


@dataclass
class _Lost:
    """A source that leapt: the first and the newest sample of the stretch that agrees with itself."""

    first: Odometry
    newest: Odometry


class VioGuard:
    def __init__(self, settings: VioSettings):
        self._settings = settings
        self._q_base_source = quaternion_from_rpy(np.radians(settings.source_rpy_deg))
        self._p_base_source = np.asarray(settings.source_position)
        self._last: Odometry | None = None
        self._lost: _Lost | None = None
        self._q_odom_source = np.array([0.0, 0.0, 0.0, 1.0])  # of the source's frames of reference, after a teleport
        self._p_odom_source = np.zeros(3)

    def check(self, raw: Odometry) -> Checked:
        """Return what to make of a sample as the source speaks: a record whose twist is in the declared frames."""
        complaint = self._malformed(raw)
        if complaint:
            return Checked(None, complaint)
        odometry = self._convert(raw)
        if self._last is None:
            return self._accept(odometry)
        if self._lost is None:
            leap = self._leap(self._last, odometry)
            return self._lose(odometry, leap) if leap else self._accept(odometry)
        return self._while_lost(odometry)

    def _lose(self, odometry: Odometry, leap: str) -> Checked:
        self._lost = _Lost(odometry, odometry)
        return Checked(None, f"the odometry {leap}, within {_age(self._last, odometry)}; it was refused")

    def _accept(self, odometry: Odometry, complaint: str = "") -> Checked:
        self._last, self._lost = odometry, None
        return Checked(odometry, complaint)

    def _malformed(self, raw: Odometry) -> str:
        values = (raw.p_world, raw.q_world_body, raw.v_body, raw.omega_body)
        for name, value in zip(("position", "quaternion", "velocity", "rate"), values, strict=True):
            if not np.isfinite(value).all():
                return f"the odometry's {name} is not a number; the sample was refused"
        length = float(np.linalg.norm(raw.q_world_body))
        if abs(length - 1.0) > 0.01:
            return f"the odometry's quaternion has length {length:.3f} instead of 1; the sample was refused"
        if self._last is not None and raw.stamp_ns <= self._last.stamp_ns:
            return (
                f"the odometry's stamps do not advance: {raw.stamp_ns * 1e-9:.3f} s after "
                f"{self._last.stamp_ns * 1e-9:.3f} s; the sample was refused"
            )
        speed = float(np.linalg.norm(raw.v_body))
        if speed > self._settings.max_speed:
            return f"the odometry claims {speed:.1f} m/s, over {self._settings.max_speed:g}; the sample was refused"
        return ""

    def _convert(self, raw: Odometry) -> Odometry:
        """Return odom -> base_link with the twist in base_link."""
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

    def _leap(self, before: Odometry, after: Odometry) -> str:
        """Return what keeps `after` from following on `before`, empty when nothing does."""
        s, dt = self._settings, (after.stamp_ns - before.stamp_ns) * 1e-9
        if not 0.0 < dt <= s.longest_gap_s:
            return "leapt in its stamps"
        led_to = before.p_world + dt * geometry.rotate(before.q_world_body, before.v_body)
        jump = float(np.linalg.norm(after.p_world - led_to))
        if jump > s.jump_m + 0.5 * s.max_acceleration * dt * dt:
            return f"teleported to {jump:.2f} m beside where its own velocity led"
        turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(before.q_world_body), after.q_world_body)
        angle = float(np.linalg.norm(geometry.rotation_vector_from_quaternion(turn)))
        if angle > np.radians(s.jump_deg) + s.max_turn_rate * dt:
            return f"teleported by {np.degrees(angle):.0f} degrees of attitude"
        return ""

    def _while_lost(self, odometry: Odometry) -> Checked:
        leap = self._leap(self._last, odometry)
        if self._leap(self._lost.newest, odometry):
            if leap:
                return self._lose(odometry, leap)
            return self._accept(odometry, "the odometry is back where it should be; it is believed again")
        self._lost.newest = odometry
        agreed_s = (odometry.stamp_ns - self._lost.first.stamp_ns) * 1e-9
        if agreed_s < self._settings.recover_s:
            left_s = self._settings.recover_s - agreed_s
            return Checked(None, f"the odometry leapt; it must agree with itself for {left_s:.2f} s more")
        silence_s = (self._lost.first.stamp_ns - self._last.stamp_ns) * 1e-9
        if silence_s > self._settings.longest_gap_s:
            return self._accept(odometry, f"the odometry is believed again after {silence_s:.1f} s without")
        return self._accept(
            self._rejoin(odometry),
            f"the odometry agrees with itself again after a teleport; it goes on from where it was lost, "
            f"{np.linalg.norm(odometry.p_world - self._last.p_world):.2f} m from where its source says",
        )

    def _rejoin(self, odometry: Odometry) -> Odometry:
        """Move the source's frame of reference so that `odometry` lies, and heads, where the last believed sample did;
        return it there."""
        yaw = geometry.yaw_of(self._last.q_world_body) - geometry.yaw_of(odometry.q_world_body)
        turn = geometry.quaternion_from_yaw(yaw)
        shift = self._last.p_world - geometry.rotate(turn, odometry.p_world)
        self._q_odom_source = geometry.quaternion_multiply(turn, self._q_odom_source)
        self._p_odom_source = geometry.rotate(turn, self._p_odom_source) + shift
        q_world_body = geometry.quaternion_multiply(turn, odometry.q_world_body)
        return replace(odometry, p_world=self._last.p_world, q_world_body=q_world_body)


def quaternion_from_rpy(rpy) -> np.ndarray:
    """Return q (4,) of turns by yaw about z, then pitch about the new y, then roll about the new x (rad)."""
    roll, pitch, yaw = geometry.quaternion_from_rotation_vector(np.diag(rpy))
    return geometry.quaternion_multiply(geometry.quaternion_multiply(yaw, pitch), roll)


def _age(before: Odometry, after: Odometry) -> str:
    return f"{(after.stamp_ns - before.stamp_ns) * 1e-6:.0f} ms"
