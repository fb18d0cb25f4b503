"""When simulated time may go on, and when the system's clock says it must. Pure: times are told by the caller.

Lockstep: tick k is published, and time stands until all that it causes has happened: the link says that its last frame
answers the state of tick k, that many frames have been read, and the judge is not too far behind.
"""

from dataclasses import dataclass

from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS

IMAGES_PER_SECOND, TICKS_PER_SECOND = 30, 100


def has_image(tick: int) -> bool:
    """Return whether an image is taken at a tick: 30 a second, as evenly as ticks allow, none at tick 0."""
    return (
        tick > 0
        and (tick * IMAGES_PER_SECOND) // TICKS_PER_SECOND > ((tick - 1) * IMAGES_PER_SECOND) // TICKS_PER_SECOND
    )


@dataclass(frozen=True)
class Owed:
    """What is still missing before time may go on, in words, nothing when empty; frames: only MSP bytes are."""

    what: tuple[str, ...]
    frames: bool = False

    def __bool__(self) -> bool:
        return bool(self.what)


class Lockstep:
    """judge_lead_ns: how far ticks may run ahead of what is judged, None where nobody judges; patience_s: steady time
    without any progress after which nobody is waited for any more."""

    def __init__(self, judge_lead_ns: int | None, patience_s: float):
        self._judge_lead_ns = judge_lead_ns
        self._patience_s = patience_s
        self._stamp_ns = -1
        self._answered_ns = -1
        self._judged_ns = 0
        self._sent_s = 0.0
        self.frames_sent = 0

    def publish(self, stamp_ns: int, steady_s: float) -> None:
        """Note that the tick `stamp_ns` has been published."""
        self._stamp_ns, self._sent_s = stamp_ns, steady_s

    def hear_link(self, command_stamp_ns: int, frames_sent: int) -> None:
        """Take the word of betaflight/link."""
        self._answered_ns, self.frames_sent = command_stamp_ns, frames_sent

    def hear_judge(self, judged_ns: int) -> None:
        """Take the word of race/judged."""
        self._judged_ns = judged_ns

    def owed(self, frames_read: int) -> Owed:
        """Return what the published tick still waits for."""
        missing, behind = [], self.frames_sent - frames_read
        if self._answered_ns != self._stamp_ns:
            missing.append("betaflight/link does not answer the newest state")
        if self._judge_lead_ns is not None and self._stamp_ns - self._judged_ns > self._judge_lead_ns:
            missing.append("race/judged lags behind")
        if behind > 0:
            missing.append(f"{behind} MSP frames are under way")
        return Owed(tuple(missing), frames=behind > 0 and len(missing) == 1)

    def is_stuck(self, steady_s: float) -> bool:
        """Return whether patience is over."""
        return self._stamp_ns >= 0 and steady_s - self._sent_s > self._patience_s


class Pace:
    """Ticks by the steady clock: what real time asks for, and how well it is kept.

    late: ticks begun more than one tick after they were due; the clock does not wait for them, they are made up for.
    """

    def __init__(self, begun_s: float):
        self._begun_s = begun_s
        self._next = 0
        self.late = 0

    def wait_s(self, steady_s: float) -> float:
        """Return the s until the next tick is due, negative when it is behind."""
        return self._begun_s + 1e-9 * TICK_NS * self._next - steady_s

    def begin(self, steady_s: float) -> None:
        """Count the tick that is begun now."""
        self.late += self.wait_s(steady_s) < -1e-9 * TICK_NS
        self._next += 1
