"""The vehicle's failsafe on the computer's side of the link: how a flight ends in angle mode. No ROS.

`watchdog` detects faults, `link` decides when a flight ends, this module computes the sticks until the motors stop.
"""

import enum
import math
from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY

LEVEL_TIMEOUT_S = 1.0  # s, longest time for levelling out; an intact vehicle needs a third of it
MAX_BRAKE_LEAN = math.radians(40.0)  # rad, largest lean while braking: it slows the vehicle by g tan(lean) = 8.2 m/s^2
BRAKE_TIMEOUT_S = 4.0  # s, longest braking; with this lean and slope, braking from 20 m/s takes about 3 s
BRAKED_M_S = 1.5  # m/s, horizontal speed at which braking ends and the descent begins; larger ends it sooner
LEAN_PER_SPEED = 0.12  # rad per m/s: below 5.8 m/s the lean decreases with the speed
CLIMB_DAMPING = 2.0  # 1/s, thrust per climb rate while braking: the climb rate decays with a time constant of 0.5 s


@dataclass(frozen=True)
class Motion:
    """Known motion of the vehicle; unknown values are None.

    Attributes:
        tilt: rad.
        speed: m/s.
        v_heading: (3,) m/s forward, left, up, in a level frame with the vehicle's heading.
    """

    tilt: float | None = None
    speed: float | None = None
    v_heading: np.ndarray | None = None


def motion_of(q_world_body, v_body) -> Motion:
    """Return the motion of a state: attitude (4,) x y z w and velocity in the body frame (3,) m/s."""
    v_world = geometry.rotate(q_world_body, v_body)
    yaw = float(geometry.yaw_of(q_world_body))
    forward, left = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    v_heading = np.array([v_world @ forward, v_world @ left, v_world[2]])
    return Motion(float(geometry.tilt_of(q_world_body)), float(np.linalg.norm(v_body)), v_heading)


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
    """Stages of a descent, in their order; braking is optional."""

    BRAKING = "braking"
    LEVELLING = "levelling"
    SINKING = "sinking"
    OVER = "over"


@dataclass(frozen=True)
class DescentLimits:
    """Limits of a descent.

    Attributes:
        level_tilt: rad, tilt below which the vehicle counts as level.
        level_max_speed: m/s above which the motors stop at once.
        descent_s: s from hover thrust to zero thrust.
    """

    level_tilt: float
    level_max_speed: float
    descent_s: float


class Descent:
    """The end of a flight in angle mode: closed throttle until level, then thrust from hover to zero, then disarmed.

    Above `level_max_speed`, or with unknown attitude, the motors stop at once. With `brake`, for a flight that ends as
    planned, the vehicle first leans against its velocity until it is slow.

    Attributes:
        stage: present stage.
    """

    def __init__(self, limits: DescentLimits, motion: Motion, time_s: float, brake: bool = False):
        self._limits = limits
        self._since_s = time_s
        too_fast = motion.speed is None or not motion.speed <= limits.level_max_speed
        if motion.tilt is None or too_fast and (not brake or motion.speed is None):
            self.stage = Stage.OVER
        else:
            self.stage = Stage.BRAKING if brake else Stage.LEVELLING

    def stop(self) -> None:
        """Stop the motors now."""
        self.stage = Stage.OVER

    def sticks(self, motion: Motion, time_s: float) -> SafeSticks:
        """Return the sticks for the present motion; `time_s` is `InputWatchdog.time_s`."""
        if motion.tilt is None:
            self.stop()
            return STOPPED
        if self.stage is Stage.BRAKING:
            if self._braked(motion, time_s):
                self._enter(Stage.SINKING, time_s)
            else:
                return brake(motion)
        if self.stage is Stage.LEVELLING:
            if motion.tilt < self._limits.level_tilt:
                self._enter(Stage.SINKING, time_s)
            elif time_s - self._since_s > LEVEL_TIMEOUT_S:
                self.stop()
            else:
                return SafeSticks()
        share = (time_s - self._since_s) / self._limits.descent_s
        if self.stage is Stage.OVER or share >= 1.0:
            self.stop()
            return STOPPED
        return SafeSticks(thrust=GRAVITY * (1.0 - share))

    def _braked(self, motion: Motion, time_s: float) -> bool:
        """Return whether braking ends: slow enough, velocity unknown, or timeout."""
        slow = motion.v_heading is None or float(np.hypot(*motion.v_heading[:2])) < BRAKED_M_S
        return slow or time_s - self._since_s > BRAKE_TIMEOUT_S

    def _enter(self, stage: Stage, time_s: float) -> None:
        self.stage, self._since_s = stage, time_s


def brake(motion: Motion) -> SafeSticks:
    """Return sticks that lean against the horizontal velocity and hold the height, for a known motion."""
    assert motion.v_heading is not None and motion.tilt is not None
    forward, left, up = motion.v_heading
    speed = max(float(np.hypot(forward, left)), 1e-6)
    lean = min(LEAN_PER_SPEED * speed, MAX_BRAKE_LEAN)
    thrust = max(GRAVITY - CLIMB_DAMPING * up, 0.0) / max(math.cos(motion.tilt), 0.5)
    return SafeSticks(thrust, (lean * left / speed, -lean * forward / speed))
