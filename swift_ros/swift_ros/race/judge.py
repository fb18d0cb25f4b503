"""The judge of a race: stamped poses in; passages, laps, the finish, a crash or a missed gate out. No ROS.

Rules
- *Passage*: the centre crosses the plane of the next gate inside the opening, in the gate's direction, and the hull
  touches nothing. Only the next gate counts; any other may be flown through, either way. A passage is announced when
  the hull has left the gate, `CLEARING_S` after the crossing at the latest, and is stamped with the crossing.
- *Margin*: smallest distance from the hull to the inner edge while it is inside the gate's depth.
- *Crash*: the hull touches the frame of any gate, the ground or, after the first passage, the podium, or the centre
  leaves the flight volume.
- *Missed*: the plane of the next gate was crossed forwards within `MISS_REACH_M` of its centre but outside the opening,
  and no passage followed within `MISS_GRACE_S`. Until then the vehicle may come back.
- *Finish*: the last of `track.passages` passages. A lap is gate 1 to gate 1; the race begins at the start signal.

Between two poses the flight is a cubic through positions and velocities, tested every `STEP_S`, which is the step of
the simulator. With estimated poses a touch cannot be distinguished from an error of the estimate: with `contact=False`
neither frames nor podium nor ground are judged, and a passage has no margin.
"""

import math
from dataclasses import dataclass

import numpy as np

from swift_ros import geometry
from swift_ros.race import rules
from swift_ros.track import Track, to_gate_frame
from swift_ros.types import Odometry

STEP_S = 0.002  # s between two tests; the physics step of the simulator
# s, latest announcement of a passage after the crossing. The shipped hull (radius 0.18 m) has left a gate (depth 0.1 m)
# by then if it flies faster than 2.4 m/s.
CLEARING_S = 0.1
# m; a crossing of a gate's plane farther from its centre is a detour and no miss. Planes reach across the whole volume:
# gate 6 of the shipped track lies 0.1 m from the plane of gate 7, at 10.8 m from its centre.
MISS_REACH_M = 4.0
MISS_GRACE_S = 4.0  # s, time to come back after a miss; longer gives a slow return more time and ends lost races later
# A jump of the odometry crosses nothing: a speed of several times that of a race, or a gap of 50 poses at 100 Hz.
JUMP_M_S = 100.0
JUMP_S = 0.5
RIM_POINTS = 24  # points on the rim of the hull; with a radius of 0.18 m a chord is at most 1.6 mm inside the rim

IDLE, ARMED, RACING = "idle", "armed", "racing"
FINISHED, CRASHED, MISSED, STOPPED, LOST = "finished", "crashed", "missed", "stopped", "lost"
ENDS = (FINISHED, CRASHED, MISSED, STOPPED, LOST)


@dataclass(frozen=True)
class RaceEvent:
    """One message on `race/status`: the state of the race from `stamp_ns` on.

    Attributes:
        stamp_ns: from when the state holds; may lie in the future.
        state: one of the constants above.
        next_gate: index from 0.
        lap: laps completed.
        split_s: s since the previous passage, for the first since the start; NaN if the event is no passage.
        margin_m: m, hull to inner edge at the passage; NaN if there is none.
        text: for a reader.
    """

    stamp_ns: int
    state: str
    next_gate: int = 0
    lap: int = 0
    split_s: float = math.nan
    margin_m: float = math.nan
    text: str = ""

    @property
    def is_passage(self) -> bool:
        """Whether the event is the passage of a gate."""
        return not math.isnan(self.split_s)


@dataclass(frozen=True)
class _Crossing:
    """A crossing of the opening, which becomes a passage when the hull has left the gate."""

    stamp_ns: int
    gate: int


class Judge:
    """Judges one race; takes every pose in the order of stamps."""

    def __init__(self, track: Track, hull_radius: float, hull_height: float, contact: bool = True):
        """Make a judge that waits for a start signal.

        Args:
            track: of the race.
            hull_radius, hull_height: m, of the disc that encloses the vehicle.
            contact: whether touches are judged; False for estimated poses.
        """
        self.track = track
        self.contact = contact
        angle = np.linspace(0.0, 2 * np.pi, RIM_POINTS, endpoint=False)
        rim = hull_radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        up = np.array([0.0, 0.0, 0.5 * hull_height])
        rings = np.concatenate([rim, 0.5 * rim, np.zeros((1, 3))])
        self._hull_body = np.concatenate([rings + up, rings - up])
        self._reach = hull_radius + hull_height  # no point of the hull is further from its centre
        half_outer = 0.5 * track.outer_sides
        self._half_frames = np.stack([np.full_like(half_outer, track.half_depth), half_outer, half_outer], axis=-1)
        self.start(None)

    def start(self, stamp_ns: int | None) -> None:
        """Begin a race at the stamp of the start signal, or wait for one (None)."""
        self.passed = 0
        self.ended = stamp_ns is None
        self._last_passage_ns = stamp_ns or 0  # or the start; not used while `ended`
        self._previous: Odometry | None = None
        self._crossing: _Crossing | None = None
        self._margin = math.inf
        self._missed_since_ns: int | None = None

    @property
    def next_gate(self) -> int:
        """Index of the next gate, from 0."""
        return self.passed % len(self.track.gates)

    @property
    def lap(self) -> int:
        """Laps completed."""
        return max(0, (self.passed - 1) // len(self.track.gates))

    def update(self, pose: Odometry) -> list[RaceEvent]:
        """Return the events since the previous pose, in the order of time; none before the start or after the end.

        Poses before the start signal and poses that are not finite are ignored.
        """
        if self.ended or pose.stamp_ns < self._last_passage_ns or not _is_finite(pose):
            return []
        previous, self._previous = self._previous, pose
        if previous is None or pose.stamp_ns <= previous.stamp_ns:
            return []
        duration = 1e-9 * (pose.stamp_ns - previous.stamp_ns)
        if duration > JUMP_S or np.linalg.norm(pose.p_world - previous.p_world) > JUMP_M_S * duration:
            return []
        if self._is_uneventful(previous, pose, duration):
            self._margin = math.inf
            return self._overdue(pose.stamp_ns)
        events = []
        steps = max(1, round(duration / STEP_S))
        points, attitudes = _between(previous, pose, duration, steps)
        for i in range(steps):
            span = previous.stamp_ns + round(i * 1e9 * duration / steps), round(1e9 * duration / steps)
            event = self._step(points[i], points[i + 1], attitudes[i + 1], *span)
            if event is not None:
                events.append(event)
            if self.ended:
                break
        return events

    def touch(self, pose: Odometry) -> str:
        """Return a sentence on what the hull touches at one pose, or that it left the flight volume; "" for neither."""
        return self._touch(pose.p_world, pose.q_world_body) if _is_finite(pose) else ""

    def _step(self, before, after, q_after, stamp_ns: int, step_ns: int) -> RaceEvent | None:
        """Judge one step; at most one event happens in it, and a touch comes before a passage."""
        end_ns = stamp_ns + step_ns
        touch = self._touch(after, q_after)
        if touch:
            return self._end(end_ns, CRASHED, touch)
        crossed, share, offset = self._next_plane(before, after)
        if crossed and self._crossing is None:
            if rules.edge_margin(0.5 * self.track.inner_sides[self.next_gate], offset) > 0:
                self._crossing = _Crossing(stamp_ns + round(share * step_ns), self.next_gate)
            elif np.linalg.norm(offset) < MISS_REACH_M and self._missed_since_ns is None:
                self._missed_since_ns = stamp_ns + round(share * step_ns)
        if self._crossing is not None and self._is_clear(self._crossing, after, q_after, end_ns):
            return self._pass(self._crossing)
        return next(iter(self._overdue(end_ns)), None)

    def _overdue(self, stamp_ns: int) -> list[RaceEvent]:
        """Return the end of the race when a missed gate was not passed in time."""
        if self._missed_since_ns is None or stamp_ns - self._missed_since_ns <= 1e9 * MISS_GRACE_S:
            return []
        return [self._end(stamp_ns, MISSED, f"flew past gate {self.next_gate + 1} beside its opening")]

    def _is_uneventful(self, previous: Odometry, pose: Odometry, duration: float) -> bool:
        """Return whether no gate, bound or plane was near between two poses, so that their steps need no test."""
        track, p = self.track, pose.p_world
        # The cubic between two poses leaves their chord by at most so much for each of its velocities.
        bulge = 4 / 27 * duration * (math.hypot(*previous.v_body) + math.hypot(*pose.v_body))
        reach = self._reach + math.dist(p, previous.p_world) + bulge
        near = self._gates_within(p, reach).size > 0 or bool(rules.above_podium(np.asarray(track.start), p, reach))
        apart = np.min(p - track.bounds_min) > reach and np.min(track.bounds_max - p) > reach
        crossed, _, _ = self._next_plane(previous.p_world, p)
        return bool(apart and not near and not crossed and self._crossing is None)

    def _gates_within(self, p_world, reach: float) -> np.ndarray:
        """Return the indices of the gates whose frame, as a full box, is less than `reach` (m) away along its axes."""
        offsets = to_gate_frame(self.track.positions, self.track.rotations, p_world)
        return np.flatnonzero(np.all(np.abs(offsets) < self._half_frames + reach, axis=1))

    def _next_plane(self, before, after):
        """Return `rules.plane_crossing` of a move and the next gate."""
        gate = self.next_gate
        return rules.plane_crossing(self._in_gate_frame(gate, before), self._in_gate_frame(gate, after))

    def _in_gate_frame(self, gate: int, points):
        return to_gate_frame(self.track.positions[gate], self.track.rotations[gate], points)

    def _touch(self, p_world, q_world_body) -> str:
        """Return a sentence on what the hull touches, "" for nothing; update the margin to the next gate."""
        track = self.track
        if rules.outside_volume(track.bounds_min, track.bounds_max, p_world, p_world):
            below = self.contact and p_world[2] < track.bounds_min[2]
            return "touched the ground" if below else "left the flight volume"
        if not self.contact:
            return ""
        hull = self._hull(p_world, q_world_body)
        margin = math.inf
        for gate in self._gates_within(p_world, self._reach):
            clearance = self._clearance(int(gate), hull)
            if clearance < 0:
                return f"touched gate {gate + 1}"
            margin = clearance if gate == self.next_gate else margin
        turned_back = math.isinf(margin) and self._crossing is None  # the hull left the gate on the side it came from
        self._margin = math.inf if turned_back else min(self._margin, margin)
        if self.passed and self._is_in_podium(hull):
            return "touched the podium"
        return "touched the ground" if np.min(hull[:, 2]) < track.bounds_min[2] else ""

    def _is_in_podium(self, hull_world) -> bool:
        """Return whether any of the hull's points is in the podium."""
        start = np.asarray(self.track.start)
        top = start[2] + np.min(self._hull_body[:, 2])
        return bool(np.any(rules.above_podium(start, hull_world) & (hull_world[:, 2] < top)))

    def _hull(self, p_world, q_world_body):
        """Return points (n, 3) of the hull's surface in the map, m."""
        return p_world + geometry.rotate(q_world_body, self._hull_body)

    def _clearance(self, gate: int, hull_world) -> float:
        """Return the smallest distance (m) from the hull's points within the gate's depth to the inner edge.

        It is negative if a point is in the frame, infinite if no point is within the depth and the outer edges.
        """
        track, hull = self.track, self._in_gate_frame(gate, hull_world)
        inner, outer = 0.5 * track.inner_sides[gate], 0.5 * track.outer_sides[gate]
        inside = (np.abs(hull[:, 0]) <= track.half_depth) & (rules.edge_margin(outer, hull[:, 1:]) >= 0)
        return float(np.min(rules.edge_margin(inner, hull[inside, 1:]), initial=math.inf))

    def _is_clear(self, crossing: _Crossing, p_world, q_world_body, stamp_ns: int) -> bool:
        """Return whether the hull has left the gate of the crossing, or time is up."""
        if not self.contact or stamp_ns - crossing.stamp_ns >= 1e9 * CLEARING_S:
            return True
        hull = self._in_gate_frame(crossing.gate, self._hull(p_world, q_world_body))
        return bool(np.min(hull[:, 0]) > self.track.half_depth)

    def _pass(self, crossing: _Crossing) -> RaceEvent:
        """Turn the crossing into a passage."""
        split = 1e-9 * (crossing.stamp_ns - self._last_passage_ns)
        margin = self._margin if math.isfinite(self._margin) else math.nan
        self.passed += 1
        self._last_passage_ns = crossing.stamp_ns
        self._crossing, self._margin, self._missed_since_ns = None, math.inf, None
        text = f"gate {crossing.gate + 1}"
        if self.passed > 1 and crossing.gate == 0:
            text += f", lap {self.lap} done"
        self.ended = self.passed == self.track.passages
        state = FINISHED if self.ended else RACING
        return RaceEvent(
            stamp_ns=crossing.stamp_ns,
            state=state,
            next_gate=self.next_gate,
            lap=self.lap,
            split_s=split,
            margin_m=margin,
            text=text,
        )

    def _end(self, stamp_ns: int, state: str, text: str) -> RaceEvent:
        self.ended = True
        return RaceEvent(stamp_ns, state, self.next_gate, self.lap, text=text)


def _is_finite(pose: Odometry) -> bool:
    return all(np.all(np.isfinite(v)) for v in (pose.p_world, pose.q_world_body, pose.v_body))


def _between(first: Odometry, second: Odometry, duration: float, steps: int):
    """Return positions (steps + 1, 3) m and attitudes (steps + 1, 4) from one pose to the next, ends included.

    Positions follow the cubic through both positions and velocities, attitudes the chord between both quaternions.
    """
    s = np.linspace(0.0, 1.0, steps + 1)[:, None]
    v0 = duration * geometry.rotate(first.q_world_body, first.v_body)
    v1 = duration * geometry.rotate(second.q_world_body, second.v_body)
    move = second.p_world - first.p_world
    points = first.p_world + s * v0 + s**2 * (3 * move - 2 * v0 - v1) + s**3 * (v0 + v1 - 2 * move)
    points[-1] = second.p_world  # exactly: the next piece begins there, and a plane may lie between two that differ
    sign = 1.0 if np.dot(first.q_world_body, second.q_world_body) >= 0 else -1.0
    attitudes = geometry.normalize((1 - s) * first.q_world_body + s * sign * second.q_world_body)
    return points, attitudes


class ScheduledState:
    """The state of the race for subscribers of race/status: by stamps, not by arrival times (see RaceStatus.msg)."""

    def __init__(self):
        self._state = IDLE
        self._pending: list[tuple[int, str]] = []

    def schedule(self, stamp_ns: int, state: str) -> None:
        """Take one race/status; it replaces those that were scheduled for later."""
        self._pending = [*(entry for entry in self._pending if entry[0] <= stamp_ns), (stamp_ns, state)]

    def at(self, stamp_ns: int) -> str:
        """Return the state of the race for a vehicle state with this stamp; stamps must not decrease."""
        while self._pending and self._pending[0][0] <= stamp_ns:
            self._state = self._pending.pop(0)[1]
        return self._state
