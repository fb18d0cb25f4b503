"""Whether the numbers of a track file describe gates that stand in a hall and can be flown. No ROS."""

from collections.abc import Iterator

import numpy as np

from swift_ros import geometry
from swift_ros.plausibility.finding import IMPOSSIBLE, ODD, Finding

TOLERANCE_M = 0.01  # of a gate that stands on the ground or at a wall
SAME_M, SAME_COSINE = 0.1, 0.999  # two entries of a file that are nearer than this are one gate, flown twice
MAX_DISTINCT_ROLL_DEG, MAX_SEEN_PITCH_DEG = 30.0, 60.0  # beyond, the detector confuses or misses the corners
SIDES_M = (0.4, 4.0)
MAX_AWAY_DEG = 100.0  # between the heading on the podium and the first gate
MAX_DISTANCE_M = 60.0  # between two gates; detection ends at some 20 m


def findings(track) -> list[Finding]:
    """Return what is impossible or odd about a `swift_ros.track.Track`, the impossible first."""
    impossible = [Finding(IMPOSSIBLE, text) for check in _IMPOSSIBLE for text in check(track)]
    return impossible + [Finding(ODD, text) for check in _ODD for text in check(track)]


def findings_with(track, vehicle) -> list[Finding]:
    """Return what is impossible about a track for a vehicle."""
    width = 2.0 * vehicle.hull_radius
    return [
        Finding(
            IMPOSSIBLE,
            f"the opening of gate {number} is {side:g} m wide, and {vehicle.name} is {width:g} m; take a larger gate, "
            "or correct 'hull_radius'",
        )
        for number, side in enumerate(track.inner_sides, start=1)
        if side <= width
    ]


def _volume(track) -> Iterator[str]:
    low, high = np.array(track.bounds_min), np.array(track.bounds_max)
    if not np.all(low < high):
        yield "'bounds_min' must be less than 'bounds_max' along each axis"
        return
    if not track.depth > 0:
        yield "'depth' must be positive, in m"
    start = np.array(track.start)
    if np.any((start < low) | (start > high)):
        yield "'start' is outside of the flight volume; correct it, or 'bounds_min' and 'bounds_max'"
    for number, corners in enumerate(track.corners, start=1):
        below = low[2] - corners[:, 2].min()
        if below > TOLERANCE_M:
            yield f"the opening of gate {number} reaches {below:.2f} m into the ground; raise its 'position'"
        elif np.any((corners < low - TOLERANCE_M) | (corners > high + TOLERANCE_M)):
            yield f"gate {number} is not within the flight volume; correct its 'position', or the bounds"


def _apart(track) -> Iterator[str]:
    count, normals = len(track.gates), track.rotations[:, :, 0]
    for j in range(count):
        for i in range(j):
            distance = float(np.linalg.norm(track.positions[i] - track.positions[j]))
            along = float(normals[i] @ normals[j])
            if distance < SAME_M and abs(along) > SAME_COSINE:
                follows = j == i + 1 or (i == 0 and j == count - 1)
                if follows and along > 0:
                    yield f"gates {i + 1} and {j + 1} follow each other at one place; remove one of them"
            elif distance < 0.5 * min(track.inner_sides[i], track.inner_sides[j]):
                yield (
                    f"gates {i + 1} and {j + 1} stand in each other, {distance:.2f} m apart; correct one 'position' or "
                    "its angles"
                )


def _odd_gates(track) -> Iterator[str]:
    for number, (gate, side) in enumerate(zip(track.gates, track.inner_sides, strict=True), start=1):
        if not SIDES_M[0] <= side <= SIDES_M[1]:
            yield f"the opening of gate {number} is {side:g} m wide; racing gates have 0.7 to 2.5 m"
        if abs((gate.roll_deg + 45.0) % 90.0 - 45.0) > MAX_DISTINCT_ROLL_DEG:
            yield f"gate {number} is rolled by {gate.roll_deg:g} degrees; the detector confuses its corners"
        if abs(gate.pitch_deg) > MAX_SEEN_PITCH_DEG:
            yield f"gate {number} is pitched by {gate.pitch_deg:g} degrees; the detector rarely finds it"


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


_IMPOSSIBLE = (_volume, _apart)
_ODD = (_odd_gates, _odd_course)
