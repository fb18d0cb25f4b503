"""Runaway-takeoff prevention: the firmware disarms a vehicle that turns against all its efforts while taking off.

Betaflight 4.5, core.c (`subTaskPidController` trips it, `processRx` ends the watch). The rate loop times its passes;
what frames tell is judged here.
"""

from dataclasses import dataclass

PID_SUM_LIMIT = 600.0  # PID units on any axis ..
GYRO_LIMITS_DEG_S = (15.0, 15.0, 50.0)  # .. while any turns faster than this ..
TRIP_S = 0.075  # .. for this long
CALM_PID_SUM = 100.0
ACTIVE_STICK = 0.15
HIGH_THROTTLE_PERCENT = 75


@dataclass(frozen=True)
class RunawaySettings:
    """throttle_percent: from which flight counts, with sticks that move, and from twice of which without; calm_ms: of
    such flight after which the watch ends."""

    throttle_percent: int
    calm_ms: int


class RunawayWatch:
    """Watches from the first arming until the vehicle has flown calmly for long enough. over: it has."""

    def __init__(self, settings: RunawaySettings):
        self._settings = settings
        self._calm_ms = 0
        self._since_ms: int | None = None
        self.over = False

    def take_frame(self, now_ms: int, throttle: float, deflections, pid_sum) -> None:
        """Judge an armed vehicle's flight at a frame: throttle 0..1, deflections (3,) -1..1, pid_sum (3,) PID units."""
        percent = int(100 * throttle)
        low = self._settings.throttle_percent
        moving = percent >= low and max(abs(value) for value in deflections) >= ACTIVE_STICK
        lifting = moving or percent >= min(2 * low, HIGH_THROTTLE_PERCENT)
        if lifting and max(abs(value) for value in pid_sum) < CALM_PID_SUM:
            self._since_ms = now_ms if self._since_ms is None else self._since_ms
            needed_ms = self._settings.calm_ms // (2 if percent >= HIGH_THROTTLE_PERCENT else 1)
            self.over = self.over or self._calm_ms + now_ms - self._since_ms > needed_ms
        elif self._since_ms is not None:
            self._calm_ms += now_ms - self._since_ms
            self._since_ms = None
