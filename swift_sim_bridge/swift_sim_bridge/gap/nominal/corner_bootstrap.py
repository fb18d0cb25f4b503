"""Twins' gates in images: those that the recording's detector saw, where each twin would see them, as wrong as it was.

Of a detector's errors no file knows anything. A twin borrows the recording's own: what all effects together leave of
them, with signs drawn anew (the wild bootstrap of Wu 1986), view by view: a gate from one side, near or far, misleads
for as long as it looks the same. How it misleads, shifted, stretched or sheared, effects can explain for the most part,
so that little of it is left: each view gets as much anew.
"""

from dataclasses import replace

import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.recording import gate_observations
from swift_sim_bridge.gap.recording.gate_observations import GateObservations
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms

DRAWS = 8  # of biases, that tell how much of one the effects leave
LEAST_SURVIVING = 0.1


def with_gates(
    tables: list[FlightTable],
    traces,
    t,
    vehicle: Vehicle,
    residual_model: ResidualModel,
    recorded: Linearisation,
    seed: int,
) -> list[FlightTable]:
    """Return twins' tables with the gates that they see in their recording's images. traces: of the twins, their truth
    (n, ...) at t (n,) s; recorded: the recording's residuals and footprints."""
    terms, rng, found = sensor_terms(vehicle), np.random.default_rng([seed, 16]), []
    seen, left = residual_model.recording.gate_observations, errors_left(residual_model, recorded)
    for table, trace in zip(tables, traces, strict=True):
        moving = Moving(*(getattr(trace, name) for name in Moving._fields))
        again = gate_observations.redetected(seen, _drawn(seen, left, rng), t, moving, terms)
        found.append(replace(table, detected_gates=again))
    return found


def errors_left(residual_model: ResidualModel, recorded: Linearisation) -> tuple[np.ndarray, float]:
    """Return what all effects together leave of the recording's corners (n, 4, 2) px, zero where none is compared, and
    by how much (px, standard deviation of each of six numbers) its detector shifts, stretches or shears gates in a
    view."""
    seen, (kept, row, slot) = residual_model.recording.gate_observations, residual_model.compared_gates
    flown = recorded.good[row]
    kept, row, slot = kept[flown], row[flown], slot[flown]
    if not len(row):
        return np.zeros((len(seen.t), 4, 2)), 0.0
    own = [c for c, channel in enumerate(residual_model.channels) if channel.layer == "camera"]

    def compared(values):
        """Return rows (..., m, c) of residuals as corners (..., 8 k) of the k sightings that are compared."""
        each = values[..., row, :][..., own].reshape(*values.shape[:-2], len(row), -1, 8)
        return each[..., np.arange(len(row)), slot, :].reshape(*values.shape[:-2], -1)

    columns = compared(recorded.sensitivity)
    columns = columns[np.any(columns != 0, axis=1)]
    shape, view = _shape(seen.corners[kept]), _views(seen)[kept]

    def left_of(values):
        return (values - solve(columns @ columns.T, columns @ values) @ columns).reshape(-1, 4, 2)

    left = left_of(compared(recorded.residual))
    unit = [
        left_of((shape @ one[view]).ravel())
        for one in np.random.default_rng(0).standard_normal((DRAWS, 4 * len(seen.track.gates), 3, 2))
    ]
    survives = np.mean([_bent(shape, view, one) for one in unit])
    errors = np.zeros((len(seen.t), 4, 2))
    errors[kept] = left
    return errors, _bent(shape, view, left) / max(survives, LEAST_SURVIVING)


def _bent(shape, view, errors) -> float:
    """Return how large (px) six numbers a view are that shift, stretch or shear its gates as errors (k, 4, 2) do."""
    found = [
        np.linalg.lstsq(shape[view == one].reshape(-1, 3), errors[view == one].reshape(-1, 2), rcond=None)[0]
        for one in np.unique(view)
    ]
    return 1.4826 * float(np.median(np.abs(found))) if found else 0.0


def _views(seen: GateObservations) -> np.ndarray:
    """Return a number (n,) for each gate from one side, near or far."""
    view, size = 2 * seen.gate + seen.behind, _half_sizes(seen.corners)
    middle = np.array(
        [np.median(size[view == one]) if np.any(view == one) else 0.0 for one in range(2 * len(seen.track.gates))]
    )
    return 2 * view + (size > middle[view])


def _half_sizes(corners) -> np.ndarray:
    """Return half the diagonal (n,) px of gates with corners (n, 4, 2)."""
    return 0.5 * np.linalg.norm(corners[:, 0] - corners[:, 2], axis=-1)


def _shape(corners) -> np.ndarray:
    """Return for each corner (n, 4, 3) one and where it lies about the gate's middle, in half diagonals: what errors go
    by that shift, stretch or shear a gate."""
    about = (corners - corners.mean(axis=1, keepdims=True)) / np.maximum(_half_sizes(corners), 1.0)[:, None, None]
    return np.concatenate([np.ones((*about.shape[:-1], 1)), about], axis=-1)


def _drawn(seen: GateObservations, left: tuple[np.ndarray, float], rng) -> np.ndarray:
    """Return errors (n, 4, 2) px of a twin's detector. left: errors (n, 4, 2) px and bias of the recording's."""
    errors, bias = left
    view, count = _views(seen), 4 * len(seen.track.gates)
    sign, bent = rng.choice([-1.0, 1.0], count), bias * rng.standard_normal((count, 3, 2))
    return errors * sign[view][:, None, None] + _shape(seen.corners) @ bent[view]
