"""Pacing of the simulation: in lockstep with the graph, or by the steady clock. No ROS; the caller gives all times.

Lockstep: after tick k is published, simulated time stops until everything that the tick causes has happened. The
betaflight link reports that its last frame answers the state of tick k, the simulated flight controller has read as
many frames as the link has sent, and the race judge is not too far behind.
"""

from dataclasses import dataclass

from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS

IMPATIENT_S = 0.03  # s; a graph that is there answers a tick sooner, a silent one shall not hold simulated time
TICKS_PER_SECOND = 100


def has_image(tick: int, rate_hz: float) -> bool:
    """Return whether an image is taken at a tick: spaced as evenly as ticks allow, at most one a tick, none at tick 0.

    Args:
        tick: number of the control tick.
        rate_hz: of the camera, images per second.
    """
    return tick > 0 and tick * rate_hz // TICKS_PER_SECOND > (tick - 1) * rate_hz // TICKS_PER_SECOND


@dataclass(frozen=True)
class Pending:
    """What a tick still waits for; false when nothing is pending.

    Attributes:
        reasons: one phrase for each thing that is missing.
        only_frames: whether nothing but MSP frames is missing.
    """

    reasons: tuple[str, ...]
    only_frames: bool = False

    def __bool__(self) -> bool:
        return bool(self.reasons)


class Lockstep:
    """Decides when the next tick may begin.

    Attributes:
        frames_sent: MSP frames that the link has sent, by its last report.
    """

    def __init__(self, judge_lead_ns: int | None, patience_s: float):
        """Begin before the first tick.

        Args:
            judge_lead_ns: ns by which ticks may run ahead of the judged time; None without a judge.
            patience_s: s of working time without progress after which the simulation stops waiting.
        """
        self._judge_lead_ns = judge_lead_ns
        self._patience_s = patience_s
        self._stamp_ns = -1
        self._answered_ns = -1
        self._judged_ns = 0
        self._sent_s = 0.0
        self._frames_lost = 0
        self.frames_sent = 0

    def publish(self, stamp_ns: int, now_s: float) -> None:
        """Note that the tick `stamp_ns` has been published; `now_s` is the time of the clock that measures patience."""
        self._stamp_ns, self._sent_s = stamp_ns, now_s

    def lose_patience(self, now_s: float) -> None:
        """From now on wait IMPATIENT_S for each tick's answers, by another clock, whose time is `now_s`."""
        self._patience_s, self._sent_s = IMPATIENT_S, now_s

    @property
    def frames_due(self) -> int:
        """Frames that the flight controller reads if no more are lost."""
        return self.frames_sent - self._frames_lost

    def write_off(self, frames_read: int) -> int:
        """Stop waiting for frames that were sent and not read; return their number."""
        lost = self.frames_due - frames_read
        self._frames_lost += lost
        return lost

    def take_link_report(self, command_stamp_ns: int, frames_sent: int) -> None:
        """Note a message of betaflight/link: the stamp that its last frame answers, and the frames sent so far."""
        self._answered_ns, self.frames_sent = command_stamp_ns, frames_sent

    def take_judged_time(self, judged_ns: int) -> None:
        """Note a message of race/judged: the stamp up to which the race has been judged."""
        self._judged_ns = judged_ns

    def pending(self, frames_read: int) -> Pending:
        """Return what the published tick still waits for, after `frames_read` frames were read."""
        missing, behind = [], self.frames_due - frames_read
        if self._answered_ns != self._stamp_ns:
            missing.append("betaflight/link does not answer the newest state")
        if self._judge_lead_ns is not None and self._stamp_ns - self._judged_ns > self._judge_lead_ns:
            missing.append("race/judged lags behind")
        if behind > 0:
            missing.append(f"{behind} MSP frames are not read yet")
        return Pending(tuple(missing), only_frames=behind > 0 and len(missing) == 1)

    def waited_s(self, now_s: float) -> float:
        """Return the time since the last tick was published, s; 0 before the first."""
        return now_s - self._sent_s if self._stamp_ns >= 0 else 0.0

    def is_stuck(self, now_s: float) -> bool:
        """Return whether the last tick was published more than the patience ago."""
        return self.waited_s(now_s) > self._patience_s


class Pace:
    """Schedule of ticks by the steady clock.

    Late ticks do not shift the schedule: the simulation catches up.

    Attributes:
        late: number of ticks begun more than one tick after they were due.
    """

    def __init__(self, begun_s: float):
        self._begun_s = begun_s
        self._next = 0
        self.late = 0

    def wait_s(self, steady_s: float) -> float:
        """Return the time until the next tick is due, s; negative when it is overdue."""
        return self._begun_s + 1e-9 * TICK_NS * self._next - steady_s

    def begin(self, steady_s: float) -> None:
        """Count the tick that begins now."""
        self.late += self.wait_s(steady_s) < -1e-9 * TICK_NS
        self._next += 1
