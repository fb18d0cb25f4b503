"""A time-optimal flight as a line of states, and as a flight table."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.limit.collocation import Flight
from swift_sim_bridge.limit.models import OMEGA, Model, P, Q, V


@dataclass(frozen=True)
class Line:
    """States along a flight at n times, up to 20 ms apart.

    Attributes:
        t_s: (n) s from the start.
        p_world: (n, 3) m.
        v_world: (n, 3) m/s.
        q_world_body: (n, 4), x y z w.
        omega_body: (n, 3) rad/s.
        specific_force_body: (n, 3) m/s^2, acceleration without gravity.
        rotor_speed: (n, r) rad/s.
        voltage: (n) V.
        segments_s: (m) duration of each segment, s.
    """

    t_s: np.ndarray
    p_world: np.ndarray
    v_world: np.ndarray
    q_world_body: np.ndarray
    omega_body: np.ndarray
    specific_force_body: np.ndarray
    rotor_speed: np.ndarray
    voltage: np.ndarray
    segments_s: np.ndarray

    @property
    def speed(self) -> np.ndarray:
        """Speed (n) m/s."""
        return np.linalg.norm(self.v_world, axis=1)

    @property
    def length_m(self) -> float:
        """Length of the path, m."""
        return float(np.sum(np.linalg.norm(np.diff(self.p_world, axis=0), axis=1)))

    def mean(self, values) -> float:
        """Return the mean over time of values (n)."""
        return float(np.trapezoid(values, self.t_s) / self.t_s[-1])


def line_of(model: Model, flight: Flight) -> Line:
    """Return the line of a flight of a rigid body."""
    times, states, controls = flight.times_s, flight.states, flight.controls
    assert model.observed is not None, "a point mass has no attitude"
    observed = np.array(model.observed.map(len(times))(states.T, controls.T)).T
    q = states[:, Q]
    return Line(
        t_s=times,
        p_world=states[:, P],
        v_world=states[:, V],
        q_world_body=q / np.linalg.norm(q, axis=1, keepdims=True),
        omega_body=states[:, OMEGA],
        specific_force_body=observed[:, :3],
        rotor_speed=observed[:, 3:-1],
        voltage=observed[:, -1],
        segments_s=flight.durations_s,
    )


def write_table(line: Line, path: Path) -> None:
    """Write a line as a flight table (docs/flight-table.md). Raises UsageError when it cannot be written."""
    channels = {
        "p_world": line.p_world,
        "v_world": line.v_world,
        "q_world_body": line.q_world_body,
        "gyro_body": line.omega_body,
        "specific_force_body": line.specific_force_body,
        "rotor_speed": line.rotor_speed,
        "voltage": line.voltage,
    }
    table = FlightTable(path.stem, {name: Samples(line.t_s, values) for name, values in channels.items()})
    flight_files.write(table, path)
