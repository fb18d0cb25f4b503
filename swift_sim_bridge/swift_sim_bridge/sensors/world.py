"""The world that is flown in, where it is not what the map says: the track file stays what the pilot believes."""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.track import Gate, Track


@dataclass(frozen=True)
class Displacement:
    """By how much a gate stands beside its place on the map: position (3,) m (0.05 to 0.5), yaw rad (0.02 to 0.17)."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0


@dataclass(frozen=True)
class GateDisplaced:
    """`gate_displaced`: gates that stand beside their places on the map, by number, counted from 1."""

    gates: dict[str, Displacement] = field(default_factory=dict)


@dataclass(frozen=True)
class MapScale:
    """`map_scale`: share, 0.005 to 0.02, by which gates stand farther from the podium than on the map, as large as
    they are."""

    scale: float


TERMS = {"gate_displaced": GateDisplaced, "map_scale": MapScale}


def flown_track(track: Track, terms: dict) -> Track:
    """Return the track as it stands in the hall, of a map and the sensor terms. Raises UsageError for a gate that the
    map lacks."""
    gates = list(track.gates)
    if stretched := terms.get("map_scale"):
        start = np.array(track.start)
        gates = [_moved(gate, stretched.scale * (np.array(gate.position) - start)) for gate in gates]
    displaced = terms["gate_displaced"].gates if "gate_displaced" in terms else {}
    for number, by in displaced.items():
        if number not in map(str, range(1, len(gates) + 1)):
            raise UsageError(f"terms.gate_displaced names gate {number}; {track.name} has 1 to {len(gates)}")
        index = int(number) - 1
        gates[index] = _moved(gates[index], np.array(by.position), by.yaw)
    return track if gates == list(track.gates) else replace(track, gates=tuple(gates))


def _moved(gate: Gate, by, yaw: float = 0.0) -> Gate:
    position = tuple(float(value) for value in np.array(gate.position) + by)
    return Gate(position, gate.yaw_deg + float(np.degrees(yaw)))
