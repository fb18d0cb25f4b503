"""The track: gates in the map, points in a gate's frame, and `config/track.yaml`.

Gate frame: x along the passage, y left, z up, origin in the centre of the opening. Corners are ordered top-left,
top-right, bottom-right, bottom-left as seen before the passage. Functions take arrays of any library.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swift_ros import geometry
from swift_ros.plausibility import of_track
from swift_ros.plausibility.finding import Finding

# Signs of the corners' coordinates in the gate's frame, in the order above.
CORNER_SIGNS = np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0], [0.0, -1.0, -1.0], [0.0, 1.0, -1.0]])


@dataclass(frozen=True)
class Gate:
    """One gate.

    Attributes:
        position: (3,) m, centre of the opening in the map.
        yaw_deg: direction of passage, about +z from +x.
        pitch_deg: about the gate's y axis after the yaw; positive where the passage leads downwards.
        roll_deg: about the direction of passage.
        inner_side, outer_side: of this gate's frame, m; without them, those of the track.
    """

    position: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    inner_side: float | None = None
    outer_side: float | None = None


@dataclass(frozen=True)
class Track:
    """`config/track.yaml`. Metres, map frame, z up.

    Attributes:
        name: for a reader.
        gates: in the order of passage.
        inner_side, outer_side: of the frame of each gate that does not give its own.
        depth: of every frame, along the passage.
        start: (3,), position on the podium.
        start_yaw_deg: heading on the podium.
        laps: flying laps, gate 1 to gate 1.
        bounds_min, bounds_max: corners (3,) of the flight volume.
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
        sides = [(self.inner_side, self.outer_side), *zip(self.inner_sides, self.outer_sides, strict=True)]
        for number, (inner, outer) in enumerate(sides):
            if not 0 < inner < outer:
                which = f"gate {number}: " if number else ""
                cure = "give the sides of the opening and of the frame around it"
                if 0 < outer < inner:
                    gate = self.gates[number - 1]
                    inherited = number and None in (gate.inner_side, gate.outer_side)
                    cure = "give this gate both" if inherited else "exchange them"
                raise ValueError(
                    f"{which}'inner_side' {inner:g} m must be positive and less than 'outer_side' {outer:g} m; {cure}"
                )
        if self.laps < 1:
            raise ValueError("'laps' must be at least 1")

    def findings(self) -> list[Finding]:
        """Return what is impossible or odd about this track."""
        return of_track.findings(self)

    @property
    def passages(self) -> int:
        """Gate passages of a whole race: gate 1 from the podium, then every gate of every lap."""
        return 1 + self.laps * len(self.gates)

    @cached_property
    def inner_sides(self) -> np.ndarray:
        """Sides of the openings (n,), m."""
        return np.array([self.inner_side if gate.inner_side is None else gate.inner_side for gate in self.gates])

    @cached_property
    def outer_sides(self) -> np.ndarray:
        """Outer sides of the frames (n,), m."""
        return np.array([self.outer_side if gate.outer_side is None else gate.outer_side for gate in self.gates])

    @property
    def half_depth(self) -> float:
        """Half the depth of a frame along the passage, m."""
        return 0.5 * self.depth

    @cached_property
    def positions(self) -> np.ndarray:
        """Gate centres (n, 3) in the map, m."""
        return np.array([gate.position for gate in self.gates])

    @cached_property
    def yaws(self) -> np.ndarray:
        """Headings of passage (n,), rad."""
        return np.radians([gate.yaw_deg for gate in self.gates])

    @cached_property
    def attitudes(self) -> np.ndarray:
        """q_map_gate (n, 4)."""
        tilts = np.radians([(gate.roll_deg, gate.pitch_deg) for gate in self.gates])
        roll, pitch = (geometry.quaternion_from_rotation_vector(tilts[:, i, None] * np.eye(3)[i]) for i in range(2))
        tilt = geometry.quaternion_multiply(pitch, roll)
        return geometry.quaternion_multiply(geometry.quaternion_from_yaw(self.yaws), tilt)

    @cached_property
    def rotations(self) -> np.ndarray:
        """R_map_gate (n, 3, 3)."""
        return geometry.rotation_matrix(self.attitudes)

    @cached_property
    def corners(self) -> np.ndarray:
        """Inner corners (n, 4, 3) in the map, m, in the order TL, TR, BR, BL."""
        local = 0.5 * self.inner_sides[:, None, None] * CORNER_SIGNS
        return self.positions[:, None] + np.einsum("nij,nkj->nki", self.rotations, local)

    @cached_property
    def start_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Podium position (3,) m and attitude (4,)."""
        return np.array(self.start), geometry.quaternion_from_yaw(np.radians(self.start_yaw_deg))


def to_gate_frame(gate_position, gate_rotation, p_map):
    """Return points (..., 3) of the map in the frame of a gate (position (..., 3), R_map_gate (..., 3, 3))."""
    x, y, z = ((p_map - gate_position)[..., i, None] for i in range(3))
    # Term by term: as a reduction it took more than the physics of a whole training step.
    return gate_rotation[..., 0, :] * x + gate_rotation[..., 1, :] * y + gate_rotation[..., 2, :] * z
