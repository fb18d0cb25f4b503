"""The course of a race from idle to its end: who may arm and start, when, and what ends it. No ROS.

In lockstep a race must depend only on its seed. Therefore decisions fall at ticks, each when the pose and the link
status of the tick are both there, and "armed" and "racing" are announced `announce_ahead_s` before the stamp from which
they hold. The simulator never runs further ahead of `judged_ns` (topic race/judged) than half of that, so that each
announcement arrives in time. An end has the stamp of its event; what was flown up to that stamp cannot depend on when
the announcement arrived.
"""

from dataclasses import dataclass

from swift_ros.configuration import refuse_outside, setting
from swift_ros.graph.topic_table import NODES
from swift_ros.race.judge import ARMED, CRASHED, ENDS, FINISHED, IDLE, LOST, RACING, STOPPED, Judge, RaceEvent
from swift_ros.types import Odometry

# ns; automatic arming and start fall on whole multiples of this, so that a late answer rarely changes their stamp.
DECISION_NS = 500_000_000
LINK_FRESH_NS = 500_000_000  # ns; an older link status is stale: arming is refused


@dataclass(frozen=True)
class RaceSettings:
    """Section `race_monitor` of nodes.yaml."""

    auto_arm_s: float = setting("arm so many s after the first link status; 0: wait for race/arm", 0, 600)
    auto_start_s: float = setting("start so many s after arming; 0: wait for race/start", 0, 600)
    announce_ahead_s: float = setting("lockstep: arming and start are announced this long before they hold", 0.1, 2)
    arm_timeout_s: float = setting("the flight controller must report armed within this time", 0.1, 60)
    time_limit_s: float = setting("a race that lasts longer is stopped", 1, 3600)
    stall_s: float = setting("steady s (lockstep: working time) after which a clock that stands is a fault", 0.5, 60)
    nodes: tuple[str, ...] = setting("nodes of the race: the watchdog reports when their topics stop")

    def __post_init__(self):
        for name in self.nodes:
            refuse_outside(NODES, nodes=name)
        if "race_monitor" in self.nodes:
            raise ValueError("'nodes' names race_monitor, which would wait for its own topics; remove it there")


@dataclass(frozen=True)
class LinkStatus:
    """One message on `betaflight/link`.

    Attributes:
        stamp_ns: of the message.
        armed: the flight controller is armed.
        arming_blocks: reasons why it does not arm.
        angle: the flight controller is in angle mode, on the ground or as it ends a flight.
        failsafe: the failsafe of the betaflight node is active.
        reason: what the node last reported as an error since the race was armed; empty without one.
    """

    stamp_ns: int
    armed: bool = False
    arming_blocks: tuple[str, ...] = ()
    angle: bool = False
    failsafe: bool = False
    reason: str = ""


class Refused(Exception):
    """A request is refused; the text is one sentence with the reason."""


class RaceControl:
    """The state machine of a race. Poses, link statuses and requests return the events to publish, in order.

    Attributes:
        state: of the race.
        obstacles: sentences about the graph; while there are any, arming is refused.
    """

    def __init__(self, judge: Judge, settings: RaceSettings, ahead: bool):
        """Make a race that is idle.

        Args:
            judge: judges the poses.
            settings: delays and time limits.
            ahead: arming and start are announced before they hold (lockstep).
        """
        self._judge = judge
        self._settings = settings
        self._ahead = ahead
        self._lead_ns = round(1e9 * settings.announce_ahead_s) if ahead else 0
        self.state = IDLE
        self.obstacles: list[str] = []
        self._since_ns = 0
        self._link: LinkStatus | None = None
        self._arming_blocks: tuple[str, ...] = ()  # the last ones since the race was armed
        self._first_link_ns: int | None = None
        self._was_armed = False  # a race is armed by itself once
        self._pose_ns: int | None = None

    @property
    def judged_ns(self) -> int | None:
        """Stamp up to which all is judged and decided; None before the first pose (and link status, in lockstep)."""
        if not self._ahead or self._pose_ns is None or self._link is None:
            return self._pose_ns if not self._ahead else None
        return min(self._pose_ns, self._link.stamp_ns)

    @property
    def flies_on(self) -> bool:
        """Whether the pilot flies on after the finish, until the way of braking is free."""
        link = self._link
        return self.state == FINISHED and link is not None and link.armed and not link.angle and not link.failsafe

    def idle(self) -> RaceEvent:
        """Return the event of a race that has not begun."""
        return RaceEvent(0, IDLE, text="on the ground, disarmed")

    def arm(self, now_ns: int) -> list[RaceEvent]:
        """Arm for a race. Raises Refused."""
        if self.state in (ARMED, RACING):
            raise Refused(f"the race is {self.state} already; call race/stop first")
        if self.obstacles:
            raise Refused(self.obstacles[0])
        link = self._link
        if link is None or now_ns - link.stamp_ns > LINK_FRESH_NS:
            raise Refused("betaflight/link is silent; start the betaflight node and connect the flight controller")
        if link.failsafe and link.armed:
            raise Refused(
                f"the failsafe is ending a flight ({link.reason or 'no reason reported'}); wait until disarmed"
            )
        if link.arming_blocks:
            raise Refused(f"the flight controller does not arm: {', '.join(link.arming_blocks)}")
        self._arming_blocks, self._was_armed = (), True
        return [self._move(now_ns + self._lead_ns, ARMED, "armed, rotors idle")]

    def start(self, now_ns: int) -> list[RaceEvent]:
        """Give the start signal. Raises Refused."""
        if self.state != ARMED:
            raise Refused(f"the race is {self.state}, not armed; call race/arm first")
        if self._link is None or not self._link.armed:
            raise Refused("the flight controller has not armed yet")
        stamp_ns = now_ns + self._lead_ns
        self._judge.start(stamp_ns)
        return [self._move(stamp_ns, RACING, "start")]

    def stop(self, now_ns: int, text: str = "stopped by race/stop") -> list[RaceEvent]:
        """End the race, or the arming, by request; a second request stops the motors of a vehicle that still descends.

        While the pilot flies on after the finish, the first request makes the vehicle brake. Raises Refused when there
        is nothing to stop.
        """
        if self.flies_on:
            return [self._move(now_ns, STOPPED, f"{text}, after the finish")]
        if self.state in ENDS and self._link is not None and self._link.armed:
            return [self._move(now_ns, IDLE, "motors stopped by race/stop")]
        if self.state not in (ARMED, RACING):
            raise Refused(f"the race is {self.state}; there is nothing to stop")
        return [self._move(now_ns, STOPPED, text)]

    def abort(self, now_ns: int, text: str) -> list[RaceEvent]:
        """End the race, or the arming, as lost because of a fault; do nothing if there is none."""
        return [self._move(now_ns, LOST, text)] if self.state in (ARMED, RACING) or self.flies_on else []

    def update_pose(self, pose: Odometry) -> list[RaceEvent]:
        """Judge one pose."""
        self._pose_ns = pose.stamp_ns
        if self.flies_on and (touch := self._judge.touch(pose)):
            return [self._move(pose.stamp_ns, CRASHED, f"{touch} after the finish")]
        if self.state != RACING:
            return []
        events = self._judge.update(pose)
        if events and events[-1].state in ENDS:
            self.state = events[-1].state
        elif pose.stamp_ns - self._since_ns > 1e9 * self._settings.time_limit_s:
            events += self.stop(pose.stamp_ns, f"no finish within {self._settings.time_limit_s:g} s")
        return events

    def update_link(self, link: LinkStatus) -> list[RaceEvent]:
        """Take the link status of one tick: end the race if the arming was lost, arm and start when due."""
        previous, self._link = self._link, link
        self._first_link_ns = link.stamp_ns if self._first_link_ns is None else self._first_link_ns
        decisive = previous is not None and previous.stamp_ns // DECISION_NS < link.stamp_ns // DECISION_NS
        if self.state == ARMED:
            return self._while_armed(link, decisive)
        if self.state == RACING and previous is not None and previous.armed and not link.armed:
            why = f": {link.reason}" if link.reason else ""
            end = LOST if link.failsafe else STOPPED
            return [self._move(link.stamp_ns, end, f"the flight controller disarmed{why}")]
        auto = self._settings.auto_arm_s
        if (
            self.state == IDLE
            and auto
            and not self._was_armed
            and decisive
            and self._waited(link, self._first_link_ns, auto)
        ):
            try:
                return self.arm(link.stamp_ns)
            except Refused as refusal:
                if self._waited(link, self._first_link_ns, auto + self._settings.arm_timeout_s):
                    return [self._move(link.stamp_ns, STOPPED, f"arming refused: {refusal}")]
        return []

    def _while_armed(self, link: LinkStatus, decisive: bool) -> list[RaceEvent]:
        self._arming_blocks = link.arming_blocks or self._arming_blocks
        if not link.armed and self._waited(link, self._since_ns, self._settings.arm_timeout_s):
            why = ", ".join(self._arming_blocks) or link.reason or "it gave no reason"
            return [self._move(link.stamp_ns, STOPPED, f"the flight controller did not arm: {why}")]
        auto = self._settings.auto_start_s
        due = auto and decisive and link.armed and self._waited(link, self._since_ns, auto)
        return self.start(link.stamp_ns) if due else []

    @staticmethod
    def _waited(link: LinkStatus, since_ns: int, wait_s: float) -> bool:
        return link.stamp_ns - since_ns >= 1e9 * wait_s

    def _move(self, stamp_ns: int, state: str, text: str) -> RaceEvent:
        self.state, self._since_ns = state, stamp_ns
        if state in ENDS:
            self._judge.ended = True
        running = state == RACING or state in ENDS
        gate, lap = (self._judge.next_gate, self._judge.lap) if running else (0, 0)
        return RaceEvent(stamp_ns, state, gate, lap, text=text)
