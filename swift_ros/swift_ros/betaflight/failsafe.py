"""The vehicle's own failsafe on this side of the link: who fell silent, and how the flight then ends. Pure.

Two clocks are told by the caller: ROS time (simulated in lockstep) and the steady clock, on which a ROS clock that
stops or jumps is a fault and not a pause.
"""

import enum
import math
from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY

JUMP_S = 0.05  # by how much the ROS clock may leave the steady one between two looks, in real time
OVERSLEPT_S = 0.03  # a watchdog that was not run for so long lets the queues be read before it complains
LEVEL_PATIENCE_S = 1.0  # levelling out takes a healthy vehicle a third of this
BRAKE_LEAN = math.radians(40.0)
BRAKE_PATIENCE_S = 4.0
BRAKED_M_S = 1.5
LEAN_PER_SPEED = 0.12  # rad of lean per m/s: below 6 m/s the brakes are let go gradually
CLIMB_DAMPING = 2.0  # 1/s


@dataclass(frozen=True)
class Now:
    """ros_ns: ns of the ROS clock; steady_s: s of the steady clock."""

    ros_ns: int
    steady_s: float


class InputWatchdog:
    """Watches named sources and the ROS clock.

    limits_s: how long each source may be silent, s; lockstep_silence_s: None in real time, where every limit holds on
    both clocks; in lockstep, where simulated time waits for a slow machine, the silence allowed on the steady clock, s.
    """

    def __init__(self, limits_s: dict[str, float], lockstep_silence_s: float | None = None):
        self._limits_s = limits_s
        self._lockstep_silence_s = lockstep_silence_s
        self._heard: dict[str, Now] = {}
        self._latest: Now | None = None
        self._moved_s, self._highest_ns = 0.0, 0
        self._jump = ""
        self.time_s = 0.0

    def look(self, now: Now) -> bool:
        """Take note of the time; call it before everything else. Return whether the watchdog itself had overslept.

        `time_s` then is a time that runs on whatever the ROS clock does: simulated time in lockstep while it moves,
        steady time otherwise.
        """
        latest, self._latest = self._latest, now
        if latest is None:
            self._moved_s, self._highest_ns = now.steady_s, now.ros_ns
            return False
        ros_s, steady_s = 1e-9 * (now.ros_ns - latest.ros_ns), now.steady_s - latest.steady_s
        # In lockstep a message may be handled before the tick of /clock that it belongs to: only new ground counts.
        gained_s = 1e-9 * max(now.ros_ns - self._highest_ns, 0)
        self._highest_ns = max(self._highest_ns, now.ros_ns)
        if ros_s:
            self._moved_s = now.steady_s
        if self._lockstep_silence_s is None:
            self.time_s += steady_s
            jump_s = ros_s - steady_s
        else:
            stalled = now.steady_s - self._moved_s > self._lockstep_silence_s
            self.time_s += steady_s if stalled else gained_s
            jump_s = min(ros_s, 0.0)
        if abs(jump_s) > JUMP_S:
            self._jump = f"the clock jumped by {jump_s:+.2f} s"
        return self._lockstep_silence_s is None and steady_s > OVERSLEPT_S

    def hear(self, source: str, now: Now) -> None:
        """Note a sound message of a source."""
        self._heard[source] = now

    def fault(self, now: Now, sources) -> str:
        """Return a few words on a jump of the clock or the first of `sources` that is silent; "" when all is well."""
        if self._jump:
            return self._jump
        for source in sources:
            heard, limit_s = self._heard.get(source), self._limits_s[source]
            if heard is None:
                return f"{source} was never heard"
            silent_s = 1e-9 * (now.ros_ns - heard.ros_ns)
            if silent_s > limit_s:
                return f"{source} is silent for {silent_s:.2f} s"
            steady_limit_s = limit_s if self._lockstep_silence_s is None else self._lockstep_silence_s
            if now.steady_s - heard.steady_s > steady_limit_s:
                return f"{source} is silent for {now.steady_s - heard.steady_s:.2f} s and the clock stands"
        return ""

    def forget_jump(self) -> None:
        """Take the clock as it is now: on the ground."""
        self._jump = ""


@dataclass(frozen=True)
class Motion:
    """What is known of the vehicle. tilt: rad, None when unknown; the rest None when the state is.

    speed: m/s; v_heading: (3,) m/s forward, left, up, in a level frame that shares the vehicle's heading.
    """

    tilt: float | None = None
    speed: float | None = None
    v_heading: np.ndarray | None = None


def motion_of(q_world_body, v_body) -> Motion:
    """Return the Motion of a known state: attitude (4,) and velocity in the body frame (3,) m/s."""
    v_world = geometry.rotate(q_world_body, v_body)
    yaw = float(geometry.yaw_of(q_world_body))
    ahead, left = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    v_heading = np.array([v_world @ ahead, v_world @ left, v_world[2]])
    return Motion(float(geometry.tilt_of(q_world_body)), float(np.linalg.norm(v_body)), v_heading)


@dataclass(frozen=True)
class SafeSticks:
    """What to do in angle mode. thrust: m/s^2, None for a closed throttle; lean: (roll, pitch) rad in stick directions
    (right, nose down); armed: False stops the motors."""

    thrust: float | None = None
    lean: tuple[float, float] = (0.0, 0.0)
    armed: bool = True


STOPPED = SafeSticks(armed=False)


class Stage(enum.Enum):
    BRAKING = "braking"
    LEVELLING = "levelling"
    SINKING = "sinking"
    OVER = "over"


@dataclass(frozen=True)
class DescentLimits:
    """level_tilt: rad; level_max_speed: m/s; descent_s: s from hover thrust to none."""

    level_tilt: float
    level_max_speed: float
    descent_s: float


class Descent:
    """The end of a flight in angle mode: throttle closed until level, then from hover to nothing, then motors stopped.

    Above `level_max_speed`, or when the attitude is unknown, the motors stop at once. With `brake`, for a flight that
    ends as planned, the speed is first taken off by leaning against it.
    """

    def __init__(self, limits: DescentLimits, motion: Motion, time_s: float, brake: bool = False):
        self._limits = limits
        self._since_s = time_s
        too_fast = motion.speed is None or not motion.speed <= limits.level_max_speed
        if motion.tilt is None or too_fast and (not brake or motion.speed is None):
            self.stage = Stage.OVER
        else:
            self.stage = Stage.BRAKING if brake else Stage.LEVELLING

    def cut(self) -> None:
        """Stop the motors now."""
        self.stage = Stage.OVER

    def sticks(self, motion: Motion, time_s: float) -> SafeSticks:
        """Return what to do now. time_s: s, of any clock that runs on (`Watchdog.time_s`)."""
        if motion.tilt is None:
            self.cut()
        if self.stage is Stage.BRAKING:
            if self._braked(motion, time_s):
                self._enter(Stage.SINKING, time_s)
            else:
                return brake(motion)
        if self.stage is Stage.LEVELLING:
            if motion.tilt < self._limits.level_tilt:
                self._enter(Stage.SINKING, time_s)
            elif time_s - self._since_s > LEVEL_PATIENCE_S:
                self.cut()
            else:
                return SafeSticks()
        share = (time_s - self._since_s) / self._limits.descent_s
        if self.stage is Stage.OVER or share >= 1.0:
            self.cut()
            return STOPPED
        return SafeSticks(thrust=GRAVITY * (1.0 - share))

    def _braked(self, motion: Motion, time_s: float) -> bool:
        # Without a velocity there is nothing to brake against.
        slow = motion.v_heading is None or float(np.hypot(*motion.v_heading[:2])) < BRAKED_M_S
        return slow or time_s - self._since_s > BRAKE_PATIENCE_S

    def _enter(self, stage: Stage, time_s: float) -> None:
        self.stage, self._since_s = stage, time_s


def brake(motion: Motion) -> SafeSticks:
    """Return sticks that lean against the horizontal velocity and hold the height."""
    ahead, left, up = motion.v_heading
    speed = max(float(np.hypot(ahead, left)), 1e-6)
    lean = min(LEAN_PER_SPEED * speed, BRAKE_LEAN)
    thrust = max(GRAVITY - CLIMB_DAMPING * up, 0.0) / max(math.cos(motion.tilt), 0.5)
    return SafeSticks(thrust, (lean * left / speed, -lean * ahead / speed))
