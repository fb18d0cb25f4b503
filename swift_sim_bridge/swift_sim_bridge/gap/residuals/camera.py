"""Residuals of the camera: reprojection errors of gates in images."""

from typing import NamedTuple

import numpy as np

from swift_sim_bridge.gap.recording.gate_observations import GATES_PER_IMAGE
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.sensors.clock import Moving

COORDINATES = 8  # of one gate: four corners, across and down


class ComparedGates(NamedTuple):
    """The gate observations that have a place among the residuals.

    Attributes:
        observation: (k,) index among the recording's gate observations.
        row: (k,) time of the residuals.
        slot: (k,) 0 for the largest gate of an image, 1 for the next.
    """

    observation: np.ndarray
    row: np.ndarray
    slot: np.ndarray


def compared_gates(recording: Recording, t) -> ComparedGates:
    """Return the gate observations that are compared at times t (m,) s of the residuals."""
    row, rank = recording.gate_observations.places(t)
    kept = np.flatnonzero(rank < GATES_PER_IMAGE)
    return ComparedGates(kept, row[kept], rank[kept])


def compared_times(gates: ComparedGates, count: int) -> np.ndarray:
    """Return where (m, 8 GATES_PER_IMAGE) there is a gate to compare, for m = `count` times."""
    seen = np.zeros((count, GATES_PER_IMAGE), bool)
    seen[gates.row, gates.slot] = True
    return np.repeat(seen, COORDINATES, axis=1)


def corner_residuals(recording: Recording, gates: ComparedGates, count: int, moving: Moving, terms: dict) -> np.ndarray:
    """Return detected minus projected corners (1, m, 8 GATES_PER_IMAGE) px, zero where no gate is compared.

    Args:
        recording: the recording.
        gates: observations that are compared.
        count: number m of times of the residuals.
        moving: motion (n, ...) of the body.
        terms: sensor terms.
    """
    errors = recording.gate_observations.residual(recording.t, moving, terms)[gates.observation]
    found = np.zeros((1, count, GATES_PER_IMAGE, COORDINATES))
    found[0, gates.row, gates.slot] = errors.reshape(len(gates.observation), COORDINATES)
    return found.reshape(1, count, -1)
