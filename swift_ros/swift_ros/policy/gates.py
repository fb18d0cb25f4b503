"""Which gate the pilot flies at, as the pilot itself can know it: from its own estimate, shared by training and flight.

The estimate may cross a gate's plane a little beside the opening that the vehicle flew through, so a gate counts as
passed when the estimated centre crosses its plane in the direction of passage anywhere within `REACH_SHARE` of the
outer side. Wide enough for any estimate that still finds gates; narrow enough that the gate above or below, flown
through the other way, is never taken for it. The judge's rule is another, stricter one and works on the truth.
"""

from array_api_compat import array_namespace

from swift_ros.race.rules import plane_crossing
from swift_ros.track import to_gate_frame

REACH_SHARE = 1.5


def passed(gate_position, gate_rotation, outer_side: float, p_before, p_after):
    """Return (...) bool: between two estimated positions (..., 3) m the gate (position (..., 3), R_map_gate
    (..., 3, 3)) counts as passed."""
    xp = array_namespace(p_after)
    before = to_gate_frame(gate_position, gate_rotation, p_before)
    after = to_gate_frame(gate_position, gate_rotation, p_after)
    crossed, _, offset = plane_crossing(before, after)
    return crossed & (xp.max(xp.abs(offset), axis=-1) < 0.5 * REACH_SHARE * outer_side)


def advance(next_gate, positions, rotations, outer_side: float, p_before, p_after):
    """Return (next gate (...) int after the move from p_before to p_after (..., 3) m, passed (...) bool).

    next_gate: (...) int index; positions (n, 3), rotations (n, 3, 3): the track's.
    """
    xp = array_namespace(p_after)
    done = passed(positions[next_gate], rotations[next_gate], outer_side, p_before, p_after)
    following = (next_gate + 1) % positions.shape[0]
    return xp.where(done, following, next_gate), done
