"""Errors of the map: the gates stand elsewhere than in the track file, which the pilot keeps using."""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.track import Gate, Track
from swift_sim_bridge.effects import (
    GATE_CHANNELS,
    Effect,
    Parameter,
    TermSpecification,
    scalar_parameter,
)


@dataclass(frozen=True)
class Displacement:
    """Displacement of a gate from its place on the map.

    Attributes:
        position: (3,) m, 0.05 to 0.5.
        yaw: rad, 0.02 to 0.17.
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0


@dataclass(frozen=True)
class GateDisplaced:
    """Displaced gates.

    Attributes:
        gates: displacement by number of the gate, counted from 1.
    """

    gates: dict[str, Displacement] = field(default_factory=dict)


@dataclass(frozen=True)
class MapScale:
    """Scale error of the map; the size of the gates is not affected.

    Attributes:
        scale: share by which gates are farther from the podium than on the map, 0.005 to 0.02.
    """

    scale: float


def displacement_effects(vehicle, gates: int) -> tuple[Effect, ...]:
    """Return one effect for each gate of the map."""
    effects = []
    for number in range(1, gates + 1):
        path = ("terms", "gate_displaced", "gates", number)
        parameters = [
            Parameter(f"position[{i}]", "m", (*path, "position", i), step=0.01, low=-3.0, high=3.0) for i in range(3)
        ]
        parameters.append(Parameter("yaw", "rad", (*path, "yaw"), step=5e-3, low=-np.pi / 3, high=np.pi / 3))
        effects.append(
            Effect(
                id="gate_displaced",
                layer="camera",
                parameters=tuple(parameters),
                equation="p_gate = p_map + position, psi_gate = psi_map + yaw",
                sentence=f"gate {number} stands {{values}} (m, rad of yaw) beside its place on the map",
                manoeuvre="the gate from three sides, slowly",
                channels=GATE_CHANNELS,
                idle={"gate_displaced": {"gates": {number: {"position": [0.0, 0.0, 0.0], "yaw": 0.0}}}},
                part="gate",
                variant=str(number),
            )
        )
    return tuple(effects)


def scale_effects(vehicle, gates: int) -> tuple[Effect, ...]:
    """Return the effect of a wrong scale of the map; none without gates."""
    if not gates:
        return ()
    return (
        Effect(
            id="map_scale",
            layer="camera",
            parameters=(scalar_parameter("scale", "", "map_scale", step=1e-3, low=-0.2, high=0.2),),
            equation="p_gate = p_start + (1 + scale) (p_map - p_start)",
            sentence="gates stand {scale:~.2%} {scale:farther from|nearer to} the podium",
            manoeuvre="all gates, each from both sides",
            channels=GATE_CHANNELS,
        ),
    )


TERMS = {
    "gate_displaced": TermSpecification(
        GateDisplaced,
        idle={},
        example={"gates": {1: {"position": [0.2, -0.1, 0.05], "yaw": 0.1}}},
        effects=displacement_effects,
    ),
    "map_scale": TermSpecification(MapScale, idle={"scale": 0.0}, example={"scale": 0.015}, effects=scale_effects),
}


def flown_track(track: Track, terms: dict) -> Track:
    """Return the track with its gates at their true places.

    Args:
        track: the map.
        terms: the vehicle's sensor terms.

    Raises:
        UsageError: the map lacks a displaced gate.
    """
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
    """Return the gate displaced by `by` (3,) m and `yaw` rad."""
    x, y, z = (float(value) for value in np.array(gate.position) + by)
    return replace(gate, position=(x, y, z), yaw_deg=gate.yaw_deg + float(np.degrees(yaw)))
