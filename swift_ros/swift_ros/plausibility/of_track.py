"""Whether the numbers of a track file describe gates that stand in a hall and can be flown. No ROS."""

import itertools
from collections.abc import Iterator

import numpy as np

from swift_ros import geometry
from swift_ros.plausibility import frames
from swift_ros.plausibility.finding import IMPOSSIBLE, Finding, first_findings

TOLERANCE_M = 0.01  # of a gate that stands on the ground or at a wall
MAX_DISTINCT_ROLL_DEG, MAX_SEEN_PITCH_DEG = 30.0, 60.0  # beyond, the detector confuses or misses the corners
LARGEST_M = 20.0  # outer side or depth of a frame that someone builds
SIDES_M = (0.4, 4.0)  # of openings: from gates for palm-sized vehicles to those of large ones
ROOM_M = 0.5  # before and behind the opening, along the passage: less is no way through
MAX_AWAY_DEG = 100.0  # between the heading on the podium and the first gate
MAX_DISTANCE_M = 60.0  # between two gates; detection ends at some 20 m
TURN_RAD = 6.3  # a track whose angles are all smaller may have them in rad
# Mean cosine between a passage and the course through its gate: where the angles fit it, and where they contradict it.
FITTING, CONTRADICTING = 0.6, 0.3


def findings(track) -> list[Finding]:
    """Return what is impossible about a `swift_ros.track.Track`, or else what is odd."""
    return first_findings(
        track, ((_units,), (_volume, _angles), (_gates, _apart)), (_odd_gates, _odd_turns, _odd_course)
    )


def findings_with(track, vehicle) -> list[Finding]:
    """Return what is impossible about a track for a vehicle."""
    return [Finding(IMPOSSIBLE, text) for check in (_fits, _stands) for text in check(track, vehicle)]


def _numbers(indices) -> str:
    """Return gates by their numbers from 1, as the subject of a sentence: "gate 2", "gates 2 and 5"."""
    *first, last = [str(int(i) + 1) for i in indices]
    return f"gates {', '.join(first)} and {last}" if first else f"gate {last}"


def _fits(track, vehicle) -> Iterator[str]:
    width = 2.0 * vehicle.hull_radius
    for side in np.unique(track.inner_sides[track.inner_sides <= width]):
        yield (
            f"the opening of {_numbers(np.flatnonzero(track.inner_sides == side))} is {side:g} m wide, and "
            f"{vehicle.name} is {width:g} m; take a larger 'inner_side', or correct 'hull_radius'"
        )


def _stands(track, vehicle) -> Iterator[str]:
    start, floor = np.array(track.start), track.bounds_min[2]
    if start[2] - 0.5 * vehicle.hull_height < floor - 1e-6:
        yield (
            f"'start' is {start[2] - floor:.3g} m above the ground, and {vehicle.name} reaches "
            f"{0.5 * vehicle.hull_height:g} m below its centre; raise 'start'"
        )
    to_wall = float(min((start - track.bounds_min)[:2].min(), (track.bounds_max - start)[:2].min()))
    if to_wall < vehicle.hull_radius - 1e-6:
        yield (
            f"'start' is {to_wall:.3g} m from a wall, and {vehicle.name} reaches {vehicle.hull_radius:g} m to each "
            "side; move 'start'"
        )
    struck = [i for i in range(len(track.gates)) if frames.distance(track, i, start) < vehicle.hull_radius]
    if struck and not any(_struck_by_start(track)):
        yield f"on the podium {vehicle.name} touches the frame of {_numbers(struck)}; move 'start'"


def _units(track) -> Iterator[str]:
    largest = float(max(track.outer_sides.max(), track.depth))
    if largest > LARGEST_M:
        yield f"a frame is {largest:g} m large; give 'inner_side', 'outer_side' and 'depth' in m"
    if not track.depth > 0:
        yield "'depth' must be positive, in m"
    low, high = np.array(track.bounds_min), np.array(track.bounds_max)
    if not np.all(low < high):
        yield (
            f"'bounds_min' {low.tolist()} must be less than 'bounds_max' {high.tolist()} along each axis; "
            + ("exchange them" if np.all(high < low) else "give the lowest and the highest coordinates, in m")
        )


def _volume(track) -> Iterator[str]:
    low, high = np.array(track.bounds_min), np.array(track.bounds_max)
    start, buried = np.array(track.start), list(_buried(track))
    if np.any((start < low) | (start > high)) and not (buried and start[2] < low[2]):
        yield "'start' is outside of the flight volume; correct it, or 'bounds_min' and 'bounds_max'"
    yield from buried
    if buried:
        return
    away = np.any((track.positions < low) | (track.positions > high), axis=1)
    if len(track.gates) > 1 and away.all():
        yield "all gates are outside of the flight volume; give each 'position' in m, or correct the bounds"
        return
    yield from _sunk(track)
    yield from _in_walls(track)


def _buried(track) -> Iterator[str]:
    """Yield a sentence when all gates are below the ground, as in a map with z down."""
    low, high = np.array(track.bounds_min), np.array(track.bounds_max)
    heights, mirrored = track.positions[:, 2], track.positions * (1.0, 1.0, -1.0)
    if len(heights) > 1 and heights.max() < low[2]:
        inside = np.all((mirrored >= low) & (mirrored <= high))
        cure = "change the sign of each z" if inside else "raise each 'position', or correct 'bounds_min'"
        yield f"all gates are below the ground, the highest at z {heights.max():g} m, and z is up; {cure}"


def _sunk(track) -> Iterator[str]:
    """Yield a sentence on gates in the ground. The lower bar of a frame may be: then the ground is its threshold."""
    floor = track.bounds_min[2]
    opening = floor - track.corners[:, :, 2].min(axis=1)
    legs = floor - np.array([frames.corners(track, i, False)[:, 2].min() for i in range(len(track.gates))])
    yield from _reaching("opening", "the ground", opening, "raise 'position'")
    legs[opening > TOLERANCE_M] = 0.0
    yield from _reaching("frame", "the ground", legs, "raise 'position', or correct the angles")


def _in_walls(track) -> Iterator[str]:
    """Yield a sentence on gates that leave the flight volume sideways or upwards."""
    low, high = np.array(track.bounds_min), np.array(track.bounds_max)
    low[2] = -np.inf
    away = np.any((track.positions < low) | (track.positions > high), axis=1)
    if away.any():
        be = "is" if away.sum() == 1 else "are"
        yield f"{_numbers(np.flatnonzero(away))} {be} not within the flight volume; correct 'position', or the bounds"
    places = np.array([frames.corners(track, i) for i in range(len(track.gates))])
    beyond = np.maximum(places - high, low - places).max(axis=1)
    beyond[away] = 0.0
    yield from _reaching("frame", "a wall", beyond[:, :2].max(axis=1), "correct 'position', or the bounds")
    yield from _reaching("frame", "the ceiling", beyond[:, 2], "lower 'position', or raise 'bounds_max'")


def _reaching(part: str, into: str, depths, cure: str) -> Iterator[str]:
    """Yield a sentence on the gates of which a part reaches somewhere by depths (n,) m."""
    found = np.flatnonzero(depths > TOLERANCE_M)
    if len(found):
        parts, reach = (f"{part}s", "reach up to") if len(found) > 1 else (part, "reaches")
        yield f"the {parts} of {_numbers(found)} {reach} {depths[found].max():.2f} m into {into}; {cure}"


def _angles(track) -> Iterator[str]:
    """Yield a sentence when the course contradicts the angles in degrees, and fits them in rad."""
    yaws = np.array([gate.yaw_deg for gate in track.gates])
    if np.all(np.abs(yaws) <= TURN_RAD) and np.any(yaws != np.round(yaws)):
        fit_deg, fit_rad = _course_fit(track, np.radians(yaws)), _course_fit(track, yaws)
        if fit_rad > FITTING and fit_deg < CONTRADICTING:
            yield (
                f"each 'yaw_deg' is within {TURN_RAD} and fits the course as radians, while the passages in degrees "
                "lead elsewhere; give degrees"
            )


def _course_fit(track, yaws) -> float:
    """Return the mean cosine between headings (n,) rad of passage and the course at each gate."""
    places = np.concatenate([[track.start], track.positions, track.positions[:1]])[:, :2]
    ways = np.diff(places, axis=0)
    ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
    course = ways[:-1] + ways[1:]
    lengths = np.linalg.norm(course, axis=1)
    headings = np.stack([np.cos(yaws), np.sin(yaws)], axis=1)
    known = lengths > 0.5  # elsewhere the course turns back
    return float(np.mean(np.sum(course * headings, axis=1)[known] / lengths[known])) if known.any() else 1.0


def _gates(track) -> Iterator[str]:
    low, high = np.array(track.bounds_min), np.array(track.bounds_max)
    for number, (position, rotation) in enumerate(zip(track.positions, track.rotations, strict=True), start=1):
        for side, name in ((1.0, "behind"), (-1.0, "before")):
            point = position + side * ROOM_M * rotation[:, 0]
            if np.any((point < low) | (point > high)):
                what = "the ground" if point[2] < low[2] else "the ceiling" if point[2] > high[2] else "a wall"
                yield (
                    f"the passage of gate {number} has no room: {what} is less than {ROOM_M:g} m {name} its opening; "
                    "correct its 'position', 'pitch_deg' or 'yaw_deg'"
                )
                break
    yield from _struck_by_start(track)


def _struck_by_start(track) -> Iterator[str]:
    inside = [i for i in range(len(track.gates)) if frames.distance(track, i, np.array(track.start)) <= 0]
    if inside:
        yield f"'start' is within the frame of {_numbers(inside)}; move it"


def _apart(track) -> Iterator[str]:
    for i, j in itertools.combinations(range(len(track.gates)), 2):
        which = f"gates {i + 1} and {j + 1}"
        distance = float(np.linalg.norm(track.positions[i] - track.positions[j]))
        match frames.collision(track, i, j):
            case frames.ONE:
                if _follow(track, i, j) and track.rotations[i, :, 0] @ track.rotations[j, :, 0] > 0:
                    yield f"{which} follow each other at one place; remove one of them"
            case frames.BLOCKED:
                yield (
                    f"the frames of {which} overlap: their centres are {distance:.2f} m apart, and a bar of one is in "
                    "the opening of the other; correct one 'position' or its angles"
                )
            case frames.STRUCK:
                yield (
                    f"the frames of {which} overlap: their centres are {distance:.2f} m apart; correct one 'position' "
                    "or its angles, or let them share a bar"
                )


def _follow(track, i: int, j: int) -> bool:
    """Return whether gate j > i is next after gate i, or gate i after gate j."""
    return j == i + 1 or (i == 0 and j == len(track.gates) - 1)


def _odd_gates(track) -> Iterator[str]:
    for side in np.unique(track.inner_sides):
        if not SIDES_M[0] <= side <= SIDES_M[1]:
            which = _numbers(np.flatnonzero(track.inner_sides == side))
            yield f"the opening of {which} is {side:g} m wide; gates have {SIDES_M[0]:g} to {SIDES_M[1]:g} m"
    for number, gate in enumerate(track.gates, start=1):
        if abs((gate.roll_deg + 45.0) % 90.0 - 45.0) > MAX_DISTINCT_ROLL_DEG:
            yield f"gate {number} is rolled by {gate.roll_deg:g} degrees; the detector confuses its corners"
        if abs(gate.pitch_deg) > MAX_SEEN_PITCH_DEG:
            yield f"gate {number} is pitched by {gate.pitch_deg:g} degrees; the detector rarely finds it"


def _odd_turns(track) -> Iterator[str]:
    for i, j in itertools.combinations(range(len(track.gates)), 2):
        if _follow(track, i, j) and frames.collision(track, i, j) == frames.ONE:
            yield (
                f"gates {i + 1} and {j + 1} are one frame that is flown there and back; if they are two gates, correct "
                "one 'position'"
            )


def _odd_course(track) -> Iterator[str]:
    position, attitude = track.start_pose
    heading = geometry.rotate(attitude, np.array([1.0, 0.0, 0.0]))
    towards = geometry.normalize(track.positions[0] - position)
    away_deg = float(np.degrees(np.arccos(np.clip(heading @ towards, -1.0, 1.0))))
    if away_deg > MAX_AWAY_DEG:
        yield f"on the podium the vehicle looks {away_deg:.0f} degrees away from gate 1; see 'start_yaw_deg'"
    ways = np.linalg.norm(np.diff(track.positions, axis=0, append=track.positions[:1]), axis=1)
    for number, way in enumerate(ways, start=1):
        if way > MAX_DISTANCE_M:
            yield f"from gate {number} to the next it is {way:.0f} m; the odometry drifts without a gate in sight"
