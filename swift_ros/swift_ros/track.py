"""The track: gates in the map, which one is next, what is a passage, and `config/track.yaml`.

Gate frame: x along the passage, y left, z up, origin in the centre of the opening. Corner order everywhere: top-left,
top-right, bottom-right, bottom-left as seen by one who is about to pass. Array-agnostic where training shares it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from array_api_compat import array_namespace

from swift_ros import geometry

# Seen along the passage, left is +y of the gate frame.
CORNER_SIGNS = np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0], [0.0, -1.0, -1.0], [0.0, 1.0, -1.0]])
FROM_BEHIND = [1, 0, 3, 2]  # the corners as one sees them in this order who looks at the gate from behind


@dataclass(frozen=True)
class Gate:
    """position: (3,) m of the opening's centre in the map; yaw_deg: direction of passage about +z from +x."""

    position: tuple[float, float, float]
    yaw_deg: float


@dataclass(frozen=True)
class Track:
    """`config/track.yaml`. Metres, map frame, z up.

    gates: in the order of passage; inner_side, outer_side, depth: of every gate; start: (3,) podium, start_yaw_deg;
    laps: flying laps, gate 1 to gate 1; bounds_min, bounds_max: corners (3,) of the flight volume.
    """

    name: str
    gates: tuple[Gate, ...]
    inner_side: float
    outer_side: float
    depth: float
    start: tuple[float, float, float]
    start_yaw_deg: float
    laps: int
    bounds_min: tuple[float, float, float]
    bounds_max: tuple[float, float, float]

    def __post_init__(self):
        if not self.gates:
            raise ValueError("the track has no gates; list at least one under 'gates'")
        if not 0 < self.inner_side < self.outer_side:
            raise ValueError("'inner_side' must be positive and less than 'outer_side'")
        if self.laps < 1:
            raise ValueError("'laps' must be at least 1")

    @property
    def passages(self) -> int:
        """Gate passages of a whole race: gate 1 from the podium, then every gate of every lap."""
        return 1 + self.laps * len(self.gates)

    @cached_property
    def positions(self) -> np.ndarray:
        """Gate centres (n, 3) in the map, m."""
        return np.array([gate.position for gate in self.gates])

    @cached_property
    def yaws(self) -> np.ndarray:
        """Directions of passage (n,), rad."""
        return np.radians([gate.yaw_deg for gate in self.gates])

    @cached_property
    def rotations(self) -> np.ndarray:
        """R_map_gate (n, 3, 3)."""
        return geometry.rotation_matrix(geometry.quaternion_from_yaw(self.yaws))

    @cached_property
    def corners(self) -> np.ndarray:
        """Inner corners (n, 4, 3) in the map, m, order TL, TR, BR, BL seen along the passage."""
        local = 0.5 * self.inner_side * CORNER_SIGNS
        return self.positions[:, None] + np.einsum("nij,kj->nki", self.rotations, local)

    @cached_property
    def start_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Podium position (3,) m and attitude (4,)."""
        return np.array(self.start), geometry.quaternion_from_yaw(np.radians(self.start_yaw_deg))


def to_gate_frame(gate_position, gate_rotation, p_map):
    """Return points (..., 3) of the map in the frame of a gate (position (..., 3), R_map_gate (..., 3, 3))."""
    xp = array_namespace(p_map)
    return xp.sum(gate_rotation * (p_map - gate_position)[..., :, None], axis=-2)


def plane_crossing(before_gate, after_gate):
    """Return (crossed, share, offset) of the segment between two points (..., 3) in a gate's frame.

    crossed (...): bool, the plane x = 0 was crossed in the direction of passage; share (...): where on the segment,
    0..1; offset (..., 2): y and z (m) at the crossing, meaningful where crossed.
    """
    xp = array_namespace(before_gate)
    x0, x1 = before_gate[..., 0], after_gate[..., 0]
    crossed = (x0 < 0) & (x1 >= 0)
    length = xp.where(crossed, x1 - x0, xp.ones_like(x1))
    share = xp.where(crossed, -x0 / length, xp.zeros_like(x0))
    offset = before_gate[..., 1:] + share[..., None] * (after_gate[..., 1:] - before_gate[..., 1:])
    return crossed, share, offset
