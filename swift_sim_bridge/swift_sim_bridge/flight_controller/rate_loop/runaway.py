"""Runaway-takeoff prevention: the firmware disarms a vehicle that rotates despite full control effort at takeoff.

Source: Betaflight 4.5, core.c (`subTaskPidController` detects a runaway, `processRx` ends the detection). The rate loop
measures how long the conditions hold; this module evaluates receiver frames.
"""

from dataclasses import dataclass

# A runaway: PID sum and body rate of some axis above these limits for TRIP_S.
PID_SUM_LIMIT = 600.0  # PID units
GYRO_LIMITS_DEG_S = (15.0, 15.0, 50.0)  # roll, pitch, yaw
TRIP_S = 0.075  # s
# Normal flight, which ends the detection (core.c).
CALM_PID_SUM = 100.0  # PID units; below on all axes
ACTIVE_STICK = 0.15  # deflection of a stick that is moved
HIGH_THROTTLE_PERCENT = 75  # always counts as flight; half of `calm_ms` is then enough


@dataclass(frozen=True)
class RunawaySettings:
    """Settings of runaway-takeoff prevention.

    Attributes:
        throttle_percent: throttle from which flight counts when a stick is moved; without, twice this throttle.
        calm_ms: ms of such flight after which the detection ends.
    """

    throttle_percent: int
    calm_ms: int


class RunawayPrevention:
    """Is active from the first arming until the vehicle has flown normally for long enough.

    Attributes:
        finished: whether the vehicle has flown normally for long enough.
    """

    def __init__(self, settings: RunawaySettings):
        self._settings = settings
        self._calm_ms = 0
        self._since_ms: int | None = None
        self.finished = False

    def take_frame(self, now_ms: int, throttle: float, deflections, pid_sum) -> None:
        """Evaluate the flight of an armed vehicle at a receiver frame.

        Args:
            now_ms: ms since power-on.
            throttle: 0 to 1.
            deflections: (3,), -1 to 1.
            pid_sum: (3,) PID units.
        """
        percent = int(100 * throttle)
        low = self._settings.throttle_percent
        moving = percent >= low and max(abs(value) for value in deflections) >= ACTIVE_STICK
        lifting = moving or percent >= min(2 * low, HIGH_THROTTLE_PERCENT)
        if lifting and max(abs(value) for value in pid_sum) < CALM_PID_SUM:
            self._since_ms = now_ms if self._since_ms is None else self._since_ms
            needed_ms = self._settings.calm_ms // (2 if percent >= HIGH_THROTTLE_PERCENT else 1)
            self.finished = self.finished or self._calm_ms + now_ms - self._since_ms > needed_ms
        elif self._since_ms is not None:
            self._calm_ms += now_ms - self._since_ms
            self._since_ms = None
