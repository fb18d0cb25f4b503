"""Geometry of the race's rules, which the judge, the training and the simulated contact share.

Arrays may be of any library and have any leading batch dimensions. Points are in the gate's frame (`swift_ros.track`):
x along the passage, y left, z up, origin in the centre of the opening.

Whether the hull touches a frame is tested three times, by design: the judge tests points of the hull's surface at every
physics step, for exact margins (`judge`); the training makes one conservative test a control tick for thousands of
races (`swift_sim_bridge.pilot.episodes.judging`); the physics needs the nearest point and its normal, to compute a
reaction (`swift_sim_bridge.physics.contact`). One test for all three would change their results or cost too much.
"""

from typing import Any, NamedTuple

from swift_ros.geometry import array_namespace

LEAST_TILT = 1e-12  # squared, in rad: the root has no gradient at a level hull, and rounding may lead below
PODIUM_RADIUS_M = 0.3  # of the round podium, on which the hull stands at the track's start


class PlaneCrossing(NamedTuple):
    """Where a segment crosses the plane x = 0 of a gate; meaningful where it does.

    Attributes:
        share: (...), 0..1, place on the segment.
        offset: (..., 2) m, y and z at the crossing.
        slope: (..., 2), change of y and z per metre of x.
    """

    share: Any
    offset: Any
    slope: Any


def crossing_directions(before_gate, after_gate):
    """Return whether the segment between two points (..., 3) crosses the plane (forwards, backwards), (...) bool."""
    x0, x1 = before_gate[..., 0], after_gate[..., 0]
    return (x0 < 0) & (x1 >= 0), (x0 >= 0) & (x1 < 0)


def crossing_point(before_gate, after_gate, crossed) -> PlaneCrossing:
    """Return where the segment between two points (..., 3) crosses the gate's plane, where `crossed` (...) holds."""
    xp = array_namespace(before_gate)
    x0, x1 = before_gate[..., 0], after_gate[..., 0]
    length = xp.where(crossed, x1 - x0, xp.ones_like(x1))
    share = xp.where(crossed, -x0 / length, xp.zeros_like(x0))
    move = after_gate[..., 1:] - before_gate[..., 1:]
    return PlaneCrossing(share, before_gate[..., 1:] + share[..., None] * move, move / length[..., None])


def plane_crossing(before_gate, after_gate):
    """Return where the segment between two points (..., 3) in a gate's frame crosses its plane forwards.

    Returns:
        crossed: (...) bool, the plane x = 0 was crossed in the direction of passage.
        share: (...), 0..1, place of the crossing on the segment.
        offset: (..., 2) m, y and z at the crossing; meaningful where crossed.
    """
    crossed, _ = crossing_directions(before_gate, after_gate)
    crossing = crossing_point(before_gate, after_gate, crossed)
    return crossed, crossing.share, crossing.offset


def edge_margin(half_side, offset, extent=0.0):
    """Return the distance (...) m from the edges of a square around the centre of the opening, negative outside it.

    Args:
        half_side: (..., 1) m, half the side of the square; or a number.
        offset: (..., 2) m, y and z.
        extent: (..., 2) m, how far the vehicle reaches beyond `offset` along y and z.
    """
    xp = array_namespace(offset)
    room = half_side - xp.abs(offset) - extent
    return xp.minimum(room[..., 0], room[..., 1])  # a reduction has no slope where a repetition rounds in another way


def hull_reach(hull_radius, hull_height, up):
    """Return how far the hull, a disc, reaches from its centre along an axis, m.

    Args:
        hull_radius, hull_height: m, of the disc.
        up: (...), component of the hull's upward axis (a unit vector) along that axis.
    """
    xp = array_namespace(up)
    across = xp.sqrt(xp.maximum(1.0 - up * up, LEAST_TILT))
    return hull_radius * across + 0.5 * hull_height * xp.abs(up)


def above_podium(start, points, reach=0.0):
    """Return (...) bool: points (..., 3) lie less than `reach` (m) beside the podium's top, at any height.

    Args:
        start: (3,) m, position of a vehicle on the podium.
        points: in the map, m.
        reach: (...) m, of the vehicle around each point.
    """
    xp = array_namespace(points)
    beside = points[..., :2] - start[:2]
    return xp.sum(beside * beside, axis=-1) < (PODIUM_RADIUS_M + reach) ** 2


def outside_volume(bounds_min, bounds_max, low, high):
    """Return (...) bool: the lowest point `low` or the highest `high` (..., 3) m of a vehicle is out of the bounds."""
    xp = array_namespace(high)
    return xp.any((low < bounds_min) | (high > bounds_max), axis=-1)
