"""Twins' gates in images: those that the recording's detector saw, where each twin would see them, as wrong as it was.

Of a detector's errors no file knows anything. A twin borrows the recording's own: what all effects together leave of
them, gate by gate with a sign drawn anew (the wild bootstrap of Wu 1986), for a gate misleads as long as it looks the
same.
"""

from dataclasses import replace

import numpy as np

from swift_ros.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import sightings
from swift_sim_bridge.gap.footprints import Linearisation
from swift_sim_bridge.gap.nulls import solve
from swift_sim_bridge.gap.residuals import Replayer
from swift_sim_bridge.gap.sightings import Sightings
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms


def with_gates(tables: list[FlightTable], traces, t, vehicle: Vehicle, replayer: Replayer, recorded: Linearisation,
               seed: int) -> list[FlightTable]:  # fmt: skip
    """Return twins' tables with the gates that they see in their recording's images. traces: of the twins, their truth
    (n, ...) at t (n,) s; recorded: the recording's residuals and footprints."""
    terms, rng, found = sensor_terms(vehicle), np.random.default_rng([seed, 16]), []
    seen, left = replayer.recording.sightings, errors_left(replayer, recorded)
    for table, trace in zip(tables, traces, strict=True):
        moving = Moving(*(getattr(trace, name) for name in Moving._fields))
        again = sightings.seen_again(seen, _drawn(seen, left, rng), t, moving, terms)
        found.append(replace(table, seen=again))
    return found


def errors_left(replayer: Replayer, recorded: Linearisation) -> np.ndarray:
    """Return what all effects together leave of the recording's corners (n, 4, 2) px; zero where none is compared."""
    seen = [c for c, channel in enumerate(replayer.channels) if channel.layer == "camera"]
    columns = recorded.columns[:, :, seen]
    columns = columns[np.any(columns != 0, axis=(1, 2))].reshape(-1, recorded.residual[:, seen].size)
    left = recorded.residual[:, seen].ravel()
    left = left - solve(columns @ columns.T, columns @ left) @ columns
    kept, row, slot = replayer.seen_at
    errors = np.zeros((len(replayer.recording.sightings.t), 8))
    errors[kept] = left.reshape(len(replayer.t), -1, 8)[row, slot]
    return errors.reshape(-1, 4, 2)


def _drawn(seen: Sightings, errors, rng) -> np.ndarray:
    """Return errors (n, 4, 2) px with signs drawn anew: one for each gate from one side, near and far."""
    size = np.linalg.norm(seen.corners[:, 0] - seen.corners[:, 2], axis=-1)
    view = 2 * seen.gate + seen.behind
    middle = np.array([np.median(size[view == one]) if np.any(view == one) else 0.0
                       for one in range(2 * len(seen.track.gates))])  # fmt: skip
    sign = rng.choice([-1.0, 1.0], 2 * len(middle))
    return errors * sign[2 * view + (size > middle[view])][:, None, None]
