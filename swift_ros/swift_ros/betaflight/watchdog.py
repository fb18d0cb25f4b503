"""Watchdog of the link's inputs: detects silent sources and a ROS clock that stops or jumps. No ROS.

The caller gives the readings of the clocks: ROS time, which is simulated in lockstep, the steady clock, and in lockstep
working time. In real time, a ROS clock that stops or jumps is a fault, not a pause.
"""

from dataclasses import dataclass

JUMP_S = 0.05  # s by which the steps of both clocks may differ in real time: ten times the error of a reading, 5 ms
MAX_PAUSE_S = 0.03  # s, longest pause between two calls in real time, 3 ticks; after it, queued messages are read first


@dataclass(frozen=True)
class ClockReading:
    """Readings of the clocks at one time.

    Attributes:
        ros_ns: ns of the ROS clock.
        steady_s: s of the steady clock.
        working_s: in lockstep, s of a `WorkingTime`; not used in real time.
    """

    ros_ns: int
    steady_s: float
    working_s: float = 0.0


class InputWatchdog:
    """Watches named sources and the ROS clock.

    Attributes:
        time_s: s of a clock that never stops: in lockstep simulated time, and working time while that stands;
            in real time steady time.
    """

    def __init__(self, limits_s: dict[str, float], lockstep_silence_s: float | None = None):
        """Start before the first reading.

        Args:
            limits_s: longest allowed silence of each source, s.
            lockstep_silence_s: None in real time, where the limits hold on both clocks. In lockstep, where simulated
                time waits for a slow machine: longest allowed silence in working time, s.
        """
        self._limits_s = limits_s
        self._lockstep_silence_s = lockstep_silence_s
        self._received: dict[str, ClockReading] = {}
        self._latest: ClockReading | None = None
        self._moved_s, self._highest_ns = 0.0, 0
        self._jump = ""
        self.time_s = 0.0

    def update(self, now: ClockReading) -> bool:
        """Take a reading of the clocks; call it before all other methods.

        Returns:
            Whether the watchdog itself was not called for too long.
        """
        latest, self._latest = self._latest, now
        if latest is None:
            self._moved_s, self._highest_ns = now.working_s, now.ros_ns
            return False
        ros_s, steady_s = 1e-9 * (now.ros_ns - latest.ros_ns), now.steady_s - latest.steady_s
        # In lockstep a message may be handled before the tick of /clock of its stamp: count only the increase of the
        # highest stamp.
        gained_s = 1e-9 * max(now.ros_ns - self._highest_ns, 0)
        self._highest_ns = max(self._highest_ns, now.ros_ns)
        if ros_s:
            self._moved_s = now.working_s
        if self._lockstep_silence_s is None:
            self.time_s += steady_s
            jump_s = ros_s - steady_s
        else:
            stalled = now.working_s - self._moved_s > self._lockstep_silence_s
            self.time_s += now.working_s - latest.working_s if stalled else gained_s
            jump_s = min(ros_s, 0.0)
        if abs(jump_s) > JUMP_S:
            self._jump = f"the clock jumped by {jump_s:+.2f} s"
        return self._lockstep_silence_s is None and steady_s > MAX_PAUSE_S

    def note_message(self, source: str, now: ClockReading) -> None:
        """Note a valid message of a source."""
        self._received[source] = now

    def fault(self, now: ClockReading, sources) -> str:
        """Return a phrase about a jump of the clock or the first silent source of `sources`; "" without a fault."""
        if self._jump:
            return self._jump
        for source in sources:
            received, limit_s = self._received.get(source), self._limits_s[source]
            if received is None:
                return f"{source} was never received"
            silent_s = 1e-9 * (now.ros_ns - received.ros_ns)
            if silent_s > limit_s:
                return f"{source} is silent for {silent_s:.2f} s"
            if self._lockstep_silence_s is None:
                silent_s = now.steady_s - received.steady_s
            else:
                limit_s, silent_s = self._lockstep_silence_s, now.working_s - received.working_s
            if silent_s > limit_s:
                return f"{source} is silent for {silent_s:.2f} s and the clock has stopped"
        return ""

    def clear_jump(self) -> None:
        """Accept the present time of the clock, while the vehicle is on the ground."""
        self._jump = ""
