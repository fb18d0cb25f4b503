"""Passages and next gate by the pilot's own estimate, for training and flight.

A gate counts as passed when the estimated position crosses its plane in the direction of passage within a square of
`PASSAGE_WIDTH` times the outer side: the estimate can cross the plane outside of the opening although the vehicle
passes through it. The judge uses a stricter rule, on the true pose.
"""

from array_api_compat import array_namespace

from swift_ros.race.rules import edge_margin, plane_crossing
from swift_ros.track import to_gate_frame

# Width of the square, relative to the gate's outer side: large enough for estimates with which gates are still
# detected, small enough to exclude the gate above or below, which is passed in the other direction.
PASSAGE_WIDTH = 1.5


def passed(gate_position, gate_rotation, outer_side, p_before, p_after):
    """Return whether (...) a gate is passed between two positions.

    Args:
        gate_position: (..., 3), m.
        gate_rotation: R_map_gate (..., 3, 3).
        outer_side: (...) of the gate, m.
        p_before: estimated position (..., 3), m.
        p_after: next estimated position (..., 3), m.
    """
    before = to_gate_frame(gate_position, gate_rotation, p_before)
    after = to_gate_frame(gate_position, gate_rotation, p_after)
    crossed, _, offset = plane_crossing(before, after)
    return crossed & (edge_margin(0.5 * PASSAGE_WIDTH * outer_side[..., None], offset) > 0.0)


def advance(next_gate, positions, rotations, outer_sides, p_before, p_after):
    """Return the next gate (...) after a move, and whether (...) a gate was passed.

    Args:
        next_gate: index (...) of the next gate before the move.
        positions: of the track's gates (n, 3), m.
        rotations: of the track's gates (n, 3, 3).
        outer_sides: of the track's gates (n,), m.
        p_before: estimated position (..., 3), m.
        p_after: next estimated position (..., 3), m.
    """
    xp = array_namespace(p_after)
    done = passed(positions[next_gate], rotations[next_gate], outer_sides[next_gate], p_before, p_after)
    following = (next_gate + 1) % positions.shape[0]
    return xp.where(done, following, next_gate), done
