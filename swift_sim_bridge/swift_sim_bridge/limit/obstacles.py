"""Frames beside the way as obstacles: a flight passes them on one side, or through the opening.

The program of a flight cannot choose the side. It is solved without the frame first; where the line touches it, the
points there are kept to one side, and the program is solved again.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_sim_bridge.limit.course import Course

# Index of the opening among the sides of a frame. Before it are ahead and behind, left and right, above and below.
OPENING = 6
NEIGHBOURS = 1  # points before and behind those that touch, on the same side: some 0.25 m at racing speed
TOLERANCE_M = 2e-3  # a touch by less is one of the solver's tolerance; the hull's sphere is larger than the hull


@dataclass(frozen=True)
class Touch:
    """Points of a flight at which the hull's sphere touches a frame beside the way, and their neighbours.

    Attributes:
        way: gates before and after the points, -1 for the podium.
        gate: index of the frame's gate.
        points: (k) indices of the points.
    """

    way: tuple[int, int]
    gate: int
    points: tuple[int, ...]

    def is_at(self, other: "Touch") -> bool:
        """Return whether both are of the same frame on the same way."""
        return (self.way, self.gate) == (other.way, other.gate)

    def joined(self, other: "Touch") -> "Touch":
        """Return the touch with the points of another one, too."""
        return replace(self, points=tuple(sorted({*self.points, *other.points})))


@dataclass(frozen=True)
class Detour:
    """A touch whose points keep to one side of the frame, by its index."""

    touch: Touch
    side: int


def planes(course: Course, gate: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (k, 3) in the gate's frame and offsets (k) m: the sphere is clear at normals @ p >= offsets."""
    track, axes = course.track, np.eye(3)
    if side == OPENING:
        return np.vstack([axes[1:], -axes[1:]]), np.full(4, course.reach_m - 0.5 * track.inner_sides[gate])
    half_outer = 0.5 * track.outer_sides[gate]
    axis, sign = side // 2, 1 - 2 * (side % 2)
    return sign * axes[[axis]], np.array([(track.half_depth, half_outer, half_outer)[axis] + course.reach_m])


def touches(course: Course, segments, p_world) -> list[Touch]:
    """Return where a flight touches frames beside its way.

    The gates at both ends of a segment are no obstacles in it: their passages have constraints of their own.

    Args:
        course: that is flown.
        segments: (n) index of each point's segment.
        p_world: (n, 3) m.
    """
    return [
        Touch(way, gate, points)
        for way in dict.fromkeys(_ways(course))
        for gate in range(len(course.track.gates))
        if gate not in way and (points := _touching(course, segments, p_world, way, gate))
    ]


def sides(course: Course, gate: int, p_world) -> list[int]:
    """Return the indices of a frame's sides, the one first to which points (n, 3) have the shortest way."""

    def way_m(side: int) -> float:
        normals, offsets = planes(course, gate, side)
        return float(np.max(offsets - _in_gate_frame(course, gate, p_world) @ normals.T))

    return sorted(range(OPENING + 1), key=way_m)


def _ways(course: Course) -> list[tuple[int, int]]:
    """Return the gates before and after each segment."""
    first = course.passages[-1] if course.begin is None else -1
    return list(zip((first, *course.passages[:-1]), course.passages, strict=True))


def _touching(course: Course, segments, p_world, way, gate: int) -> tuple[int, ...]:
    """Return the points on a way that touch a frame, and their neighbours."""
    on_way = np.array([one == way for one in _ways(course)])[segments]
    p_gate = _in_gate_frame(course, gate, p_world)

    def clear(side: int):
        normals, offsets = planes(course, gate, side)
        return np.all(p_gate @ normals.T >= offsets - TOLERANCE_M, axis=1)

    touching = on_way & ~np.any([clear(side) for side in range(OPENING + 1)], axis=0)
    near = np.convolve(touching, np.ones(2 * NEIGHBOURS + 1), "same") > 0
    return tuple(int(k) for k in np.flatnonzero(near & on_way))


def _in_gate_frame(course: Course, gate: int, p_world):
    return (p_world - course.track.positions[gate]) @ course.track.rotations[gate]
