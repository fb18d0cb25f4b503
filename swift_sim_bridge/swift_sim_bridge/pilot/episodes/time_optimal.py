"""The time-optimal lap as a guide of the training: where episodes start, and what the policy keeps near.

The reward has more than one line as its optimum, and small steps do not lead from one to another. Which one a training
from nothing finds depends on its seed. States of the time-optimal lap show the fastest.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros import configuration, geometry
from swift_ros.errors import UsageError
from swift_ros.race import limit
from swift_ros.race.limit import Limit
from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import FlightTable
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle

LAP, RACE = "lap_as_flown.csv", "race_as_flown.csv"  # files of `swiftros limit`
POINTS = 48  # of a segment; 0.3 m apart or less at 15 m/s and 1 s


@dataclass(frozen=True)
class Guide:
    """The time-optimal lap of a track with `g` gates.

    Attributes:
        points: (g, m, 3) m, positions on the way to each gate, of a flying lap and of the first lap of a race.
        velocities: (g, m, 3) m/s, at these points.
        thrust_axes: (g, m, 3), unit vectors of the thrust in the world, at these points.
        time_to_gate: (g, m) s, from these points to the gate.
        states: by name, arrays (g, r, ...) of states on the way from each gate to the next, evenly spread in time:
            p_world, v_world, q_world_body, omega_body and rotor_speed.
    """

    points: np.ndarray
    velocities: np.ndarray
    thrust_axes: np.ndarray
    time_to_gate: np.ndarray
    states: dict[str, np.ndarray]


def read_guide(folder: Path, track: Track, vehicle: Vehicle, rows: int) -> Guide:
    """Return the guide that `swiftros limit` wrote.

    Args:
        folder: its --out.
        track, vehicle: of the training.
        rows: states of each segment.

    Raises:
        UsageError: it is missing, or of another track or vehicle.
    """
    found = configuration.load(Limit, folder / limit.FILE)
    if found.key != limit.key_of(track, vehicle):
        raise UsageError(
            f"{folder} holds the time-optimal lap of '{found.vehicle}' on '{found.track}', and not of '{vehicle.name}' "
            f"on '{track.name}' as they are now; call `swiftros limit` with their files, and give its --out as --guide"
        )
    lap, race = (flight_files.read(folder / name) for name in (LAP, RACE))
    segments = _segments(found.as_flown.lap_s)  # gate 1 to 2, and so on
    on_lap = _way(lap, [segments[-1], *segments[:-1]])
    in_race = _way(race, _segments(found.as_flown.race_s[: len(segments)]))  # podium to gate 1, and so on
    points, velocities, axes, time_to_gate = (
        np.concatenate(both, axis=1) for both in zip(on_lap, in_race, strict=True)
    )
    times = np.stack([np.linspace(begin, end, rows, endpoint=False) for begin, end in segments])
    channels = {"p_world", "v_world", "q_world_body", "rotor_speed"}
    states = {name: _at(lap, name, times) for name in sorted(channels)} | {"omega_body": _at(lap, "gyro_body", times)}
    q = states["q_world_body"]
    return Guide(
        points=points,
        velocities=velocities,
        thrust_axes=axes,
        time_to_gate=time_to_gate,
        states=states | {"q_world_body": q / np.linalg.norm(q, axis=-1, keepdims=True)},
    )


def _segments(seconds) -> list[tuple[float, float]]:
    """Return begin and end of each segment, s."""
    ends = np.cumsum((0.0, *seconds))
    return list(zip(ends[:-1], ends[1:], strict=True))


def _way(table: FlightTable, segments) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (g, POINTS, 3) positions m, velocities m/s and thrust axes, and (g, POINTS) times to the end, s.

    Args:
        table: flight along the way.
        segments: begin and end of each, s.
    """
    times = np.stack([np.linspace(begin, end, POINTS) for begin, end in segments])
    q = _at(table, "q_world_body", times)
    up = geometry.rotate(
        q / np.linalg.norm(q, axis=-1, keepdims=True), np.broadcast_to((0.0, 0.0, 1.0), q.shape[:-1] + (3,))
    )
    return _at(table, "p_world", times), _at(table, "v_world", times), up, times[:, -1:] - times


def _at(table: FlightTable, channel: str, times) -> np.ndarray:
    """Return the values (..., k) of a channel at times (...), s, between its rows."""
    samples = table.channels[channel]
    columns = [np.interp(times, samples.t, column) for column in samples.values.T]
    return np.stack(columns, axis=-1)
