"""The vehicle's failsafe on the computer's side of the link: how a flight ends in angle mode. No ROS.

`watchdog` detects faults, `link` decides when a flight ends, this module computes the sticks until the motors stop.
"""

import enum
import math
from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.betaflight.msp_messages import Attitude
from swift_ros.vehicle import GRAVITY

DRAG_PER_S = 0.3  # 1/s, deceleration per speed in dead reckoning; rotor drag of racing quadrotors is 0.2 to 0.5
RECKONING_S = 5.0  # s, longest dead reckoning: then levelling and braking are over; the error grows by some 0.5 m/s^2
LEVEL_TIMEOUT_S = 1.0  # s, longest time for levelling out; an intact vehicle needs a third of it
MAX_BRAKE_LEAN = math.radians(40.0)  # rad, largest lean while braking: it slows the vehicle by g tan(lean) = 8.2 m/s^2
BRAKE_TIMEOUT_S = 4.0  # s, longest braking; with this lean and slope, braking from 20 m/s takes about 3 s
BRAKED_M_S = 1.5  # m/s, horizontal speed at which braking ends and the descent begins; larger ends it sooner
MIN_TILT_COSINE = 0.5  # a vehicle that is tilted by more than 60 degrees does not hold its height
LEAN_PER_SPEED = 0.12  # rad per m/s: below 5.8 m/s the lean decreases with the speed
CLIMB_DAMPING = 2.0  # 1/s, thrust per climb rate: its error decays with a time constant of 0.5 s
SINK_M_S = 1.0  # m/s; a vehicle that touches the ground faster than 1.5 m/s counts as crashed
SETTLED_S = 1.0  # s of sinking after which a vehicle in the air sinks at nearly SINK_M_S
TOUCH_M = 0.3  # m, height at which a vehicle may touch the ground
STANDING_M_S, STANDING_S = 0.3, 0.2  # m/s and s: one that sinks slower than this for so long stands on something
MAX_SINK_S = 10.0  # s, longest sinking by the state: from 10 m, the height of a hall
BLIND_THRUST = 0.9  # share of hover thrust: with an error of 5 % the vehicle still sinks, at 3.5 m/s after 4 m at most
BLIND_RAMP = 0.25  # share of the blind descent in which the thrust goes to zero


@dataclass(frozen=True)
class Motion:
    """Known motion of the vehicle; unknown values are None.

    Attributes:
        tilt: rad.
        v_heading: (3,) m/s forward, left, up, in a level frame with the vehicle's heading.
        measured: the velocity is that of a state, not of dead reckoning.
        height: m above the ground of the track.
    """

    tilt: float | None = None
    v_heading: np.ndarray | None = None
    measured: bool = False
    height: float | None = None


def motion_of(q_world_body, v_body) -> Motion:
    """Return the motion of a state: attitude (4,) x y z w and velocity in the body frame (3,) m/s."""
    v_world = geometry.rotate(q_world_body, v_body)
    yaw = float(geometry.yaw_of(q_world_body))
    forward, left = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    v_heading = np.array([v_world @ forward, v_world @ left, v_world[2]])
    return Motion(float(geometry.tilt_of(q_world_body)), v_heading, measured=True)


class DeadReckoning:
    """The velocity after the state was lost, by the flight controller's attitude and the commanded thrust.

    dv/dt = thrust R e_z - g e_z - DRAG_PER_S v
    """

    def __init__(self, v_heading: np.ndarray, heading: float, time_s: float):
        """Start at the last known state.

        Args:
            v_heading: (3,) m/s forward, left, up, in a level frame with the vehicle's heading.
            heading: of the flight controller, rad, clockwise.
            time_s: s, of the state.
        """
        self._v, self._heading = v_heading, heading
        self._begun_s = self._time_s = time_s

    def advance(self, angles: Attitude, thrust: float, time_s: float) -> np.ndarray | None:
        """Return the velocity (3,) m/s in the present heading's frame; None when the last state is too old.

        Args:
            angles: the flight controller's attitude.
            thrust: m/s^2, commanded since the last call.
            time_s: s.
        """
        if time_s - self._begun_s > RECKONING_S:
            return None
        turn = angles.heading - self._heading  # clockwise: what was ahead is now to the left
        forward, left, up = self._v
        v = np.array(
            [
                forward * math.cos(turn) - left * math.sin(turn),
                forward * math.sin(turn) + left * math.cos(turn),
                up,
            ]
        )
        along_thrust = np.array(
            [
                math.sin(angles.pitch) * math.cos(angles.roll),
                -math.sin(angles.roll),
                math.cos(angles.pitch) * math.cos(angles.roll),
            ]
        )
        acceleration = thrust * along_thrust - np.array([0.0, 0.0, GRAVITY]) - DRAG_PER_S * v
        self._v, self._heading = v + (time_s - self._time_s) * acceleration, angles.heading
        self._time_s = time_s
        return self._v


@dataclass(frozen=True)
class SafeSticks:
    """Sticks in angle mode.

    Attributes:
        thrust: m/s^2; None for a closed throttle.
        lean: (roll, pitch) rad in stick directions (right, nose down).
        armed: False stops the motors.
    """

    thrust: float | None = None
    lean: tuple[float, float] = (0.0, 0.0)
    armed: bool = True


STOPPED = SafeSticks(armed=False)


class Stage(enum.Enum):
    """Stages of a descent, in their order; a planned one begins with braking."""

    LEVELLING = "levelling"
    BRAKING = "braking"
    SINKING = "sinking"
    OVER = "over"


@dataclass(frozen=True)
class DescentLimits:
    """Limits of a descent.

    Attributes:
        level_tilt: rad, tilt below which the vehicle counts as level.
        descent_s: s from the begin of sinking to zero thrust, where no state gives the velocity.
    """

    level_tilt: float
    descent_s: float


class Descent:
    """The end of a flight in angle mode: level, brake against the velocity, sink to the ground, disarm.

    With a state the vehicle sinks at SINK_M_S until it stands on something. Without one it sinks with a thrust somewhat
    below hover, which then goes to zero. Where it was lost in a settled descent that takes no longer than from the last
    known height to the ground: a touch of the ground may look like a jump of the odometry.

    While levelling the throttle is closed: thrust of a vehicle that flies on its side or upside down leads to the
    ground. With unknown attitude or velocity the motors stop at once.

    Attributes:
        stage: present stage.
    """

    def __init__(self, limits: DescentLimits, motion: Motion, time_s: float, planned: bool = False):
        """Begin.

        Args:
            limits: of the descent.
            motion: at its begin.
            time_s: `InputWatchdog.time_s`.
            planned: the flight ends as planned: braking begins at once, from the attitude of the race.
        """
        self._limits = limits
        self._since_s = self._sinking_s = time_s
        self._blind_since_s: float | None = None
        self._height: float | None = None  # m, the last one in a settled descent
        if motion.tilt is None or motion.v_heading is None:
            self.stage = Stage.OVER
        else:
            self.stage = Stage.BRAKING if planned else Stage.LEVELLING

    def stop(self) -> None:
        """Stop the motors now."""
        self.stage = Stage.OVER

    def sticks(self, motion: Motion, time_s: float) -> SafeSticks:
        """Return the sticks for the present motion; `time_s` is `InputWatchdog.time_s`."""
        if motion.tilt is None:
            self.stop()
            return STOPPED
        if self.stage is Stage.LEVELLING:
            if motion.tilt < self._limits.level_tilt:
                self._enter(Stage.BRAKING, time_s)
            elif time_s - self._since_s > LEVEL_TIMEOUT_S:
                self.stop()
            else:
                return SafeSticks()
        if self.stage is Stage.BRAKING:
            if not self._braked(motion, time_s):
                return brake(motion)
            self._enter(Stage.SINKING, time_s)
        if self.stage is Stage.OVER:
            return STOPPED
        too_long = time_s - self._since_s >= MAX_SINK_S  # then the height is wrong, too
        self._height = None if too_long else self._height
        measured = motion.measured and self._blind_since_s is None and not too_long
        return self._sink(motion, time_s) if measured else self._sink_blindly(time_s)

    def _sink(self, motion: Motion, time_s: float) -> SafeSticks:
        """Return the sticks that sink at SINK_M_S, or stop a vehicle that stands on something."""
        assert motion.v_heading is not None  # it is measured
        low = motion.height is not None and motion.height < TOUCH_M
        settled = time_s - self._since_s >= SETTLED_S and (low or motion.v_heading[2] < -0.5 * SINK_M_S)
        self._height = motion.height if settled else None
        if time_s - self._since_s < SETTLED_S or motion.v_heading[2] < -STANDING_M_S:
            self._sinking_s = time_s
        if time_s - self._sinking_s > STANDING_S:
            self.stop()
            return STOPPED
        return brake(motion, up_m_s=-SINK_M_S)

    def _sink_blindly(self, time_s: float) -> SafeSticks:
        """Return level sticks with a thrust below hover, then less and less, then stopped motors."""
        if self._blind_since_s is None:
            self._blind_since_s = time_s
        lasts_s = self._limits.descent_s
        if self._height is not None:
            lasts_s = min(lasts_s, max(self._height, 0.0) / SINK_M_S + STANDING_S)
        share = (time_s - self._blind_since_s) / lasts_s
        if share >= 1.0:
            self.stop()
            return STOPPED
        return SafeSticks(thrust=BLIND_THRUST * GRAVITY * min(1.0, (1.0 - share) / BLIND_RAMP))

    def _braked(self, motion: Motion, time_s: float) -> bool:
        """Return whether braking ends: slow enough, velocity unknown, or timeout."""
        slow = motion.v_heading is None or float(np.hypot(*motion.v_heading[:2])) < BRAKED_M_S
        return slow or time_s - self._since_s > BRAKE_TIMEOUT_S

    def _enter(self, stage: Stage, time_s: float) -> None:
        self.stage, self._since_s = stage, time_s


def brake(motion: Motion, up_m_s: float = 0.0) -> SafeSticks:
    """Return sticks that lean against the horizontal velocity, for a known motion.

    Args:
        motion: of the vehicle.
        up_m_s: wanted vertical speed, m/s; by default the height is held.
    """
    assert motion.v_heading is not None and motion.tilt is not None
    forward, left, up = motion.v_heading
    speed = max(float(np.hypot(forward, left)), 1e-6)
    lean = min(LEAN_PER_SPEED * speed, MAX_BRAKE_LEAN)
    thrust = max(GRAVITY + CLIMB_DAMPING * (up_m_s - up), 0.0) / max(math.cos(motion.tilt), MIN_TILT_COSINE)
    return SafeSticks(thrust, (lean * left / speed, -lean * forward / speed))
