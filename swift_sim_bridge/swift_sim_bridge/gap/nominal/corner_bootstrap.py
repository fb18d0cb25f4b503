"""Gates in images of reference flights: those that the recording's detector found, with errors drawn by a bootstrap.

The vehicle file does not describe a detector's errors. Reference flights use the recording's own: what all effects
together leave of them, with random signs for each view (wild bootstrap, Wu 1986). A view is one gate from one side,
near or far: its errors persist as long as it looks the same. Errors that shift, stretch or shear a gate are mostly
explained by effects, so that little of them is left; each view gets random ones of the same size in addition.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.nominal.recorded_flight import RecordedFlight
from swift_sim_bridge.gap.recording import gate_observations
from swift_sim_bridge.gap.recording.gate_observations import SIGMA_FROM_MAD, GateObservations
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.terms import sensor_terms

DRAWS = 8  # random deformations from which the share that effects leave is estimated
MIN_SURVIVING = 0.1  # lower bound of that share, by which the observed deformations are divided


@dataclass(frozen=True)
class DetectorErrors:
    """Errors of the recording's detector.

    Attributes:
        corners_px: (n, 4, 2) errors of the corners that no effect explains, zero where none is compared.
        deformation_px: standard deviation of each of the six numbers that shift, stretch and shear the gates of a view.
    """

    corners_px: np.ndarray
    deformation_px: float


def with_gates(tables: list[FlightTable], traces, t, recorded: RecordedFlight, seed: int) -> list[FlightTable]:
    """Return reference flights with the gates that they see at the times of the recording's images.

    Args:
        tables: the reference flights.
        traces: their true motion (n, ...).
        t: (n,) s.
        recorded: the recording.
        seed: seed of the errors.
    """
    terms, rng, found = sensor_terms(recorded.vehicle), np.random.default_rng([seed, 16]), []
    observations = recorded.residual_model.recording.gate_observations
    errors = estimate_detector_errors(recorded.residual_model, recorded.linearisation)
    for table, trace in zip(tables, traces, strict=True):
        moving = Moving(*(getattr(trace, name) for name in Moving._fields))
        drawn = _drawn(observations, errors, rng)
        detected = gate_observations.redetected(observations, drawn, t, moving, terms)
        found.append(replace(table, detected_gates=detected))
    return found


def estimate_detector_errors(residual_model: ResidualModel, recorded: Linearisation) -> DetectorErrors:
    """Return the errors of the recording's detector that all effects together leave.

    Args:
        residual_model: gives the recording and its compared gates.
        recorded: residuals and sensitivities of the recording.
    """
    observations, gates = residual_model.recording.gate_observations, residual_model.compared_gates
    flown = recorded.good[gates.row]
    kept, row, slot = gates.observation[flown], gates.row[flown], gates.slot[flown]
    if not len(row):
        return DetectorErrors(np.zeros((len(observations.t), 4, 2)), 0.0)
    columns = [c for c, channel in enumerate(residual_model.channels) if channel.layer == "camera"]

    def compared(values):
        """Return residuals (..., m, c) as corners (..., 8 k) of the k compared gates."""
        each = values[..., row, :][..., columns].reshape(*values.shape[:-2], len(row), -1, 8)
        return each[..., np.arange(len(row)), slot, :].reshape(*values.shape[:-2], -1)

    sensitivity = compared(recorded.sensitivity)
    sensitivity = sensitivity[np.any(sensitivity != 0, axis=1)]

    def unexplained(values):
        """Return corners (k, 4, 2) px without what the effects explain."""
        sizes = solve(sensitivity @ sensitivity.T, sensitivity @ values)
        return (values - sizes @ sensitivity).reshape(-1, 4, 2)

    shape, view = _shape(observations.corners[kept]), _views(observations)[kept]
    left = unexplained(compared(recorded.residual))
    surviving = _surviving_share(unexplained, shape, view, 4 * len(observations.track.gates))
    errors = np.zeros((len(observations.t), 4, 2))
    errors[kept] = left
    return DetectorErrors(errors, _deformation(shape, view, left) / max(surviving, MIN_SURVIVING))


def _surviving_share(unexplained: Callable, shape, view, views: int) -> float:
    """Return the share of random deformations of the views that effects do not explain."""
    random = np.random.default_rng(0).standard_normal((DRAWS, views, 3, 2))
    left = [unexplained((shape @ drawn[view]).ravel()) for drawn in random]
    return np.mean([_deformation(shape, view, errors) for errors in left])


def _deformation(shape, view, errors) -> float:
    """Return the size (px) of the six numbers per view that shift, stretch or shear its gates like errors (k, 4, 2)."""
    found = [
        np.linalg.lstsq(shape[view == number].reshape(-1, 3), errors[view == number].reshape(-1, 2), rcond=None)[0]
        for number in np.unique(view)
    ]
    return SIGMA_FROM_MAD * float(np.median(np.abs(found))) if found else 0.0


def _views(observations: GateObservations) -> np.ndarray:
    """Return a number (n,) for each gate from one side, near or far."""
    side, size = 2 * observations.gate + observations.behind, _half_diagonals(observations.corners)
    middle = np.array(
        [
            np.median(size[side == number]) if np.any(side == number) else 0.0
            for number in range(2 * len(observations.track.gates))
        ]
    )
    return 2 * side + (size > middle[side])


def _half_diagonals(corners) -> np.ndarray:
    """Return half the diagonal (n,) px of gates with corners (n, 4, 2)."""
    return 0.5 * np.linalg.norm(corners[:, 0] - corners[:, 2], axis=-1)


def _shape(corners) -> np.ndarray:
    """Return for each corner 1 and its place (n, 4, 3) about the gate's centre, in half diagonals.

    Errors that shift, stretch or shear a gate are linear in these.
    """
    about = (corners - corners.mean(axis=1, keepdims=True)) / np.maximum(_half_diagonals(corners), 1.0)[:, None, None]
    return np.concatenate([np.ones((*about.shape[:-1], 1)), about], axis=-1)


def _drawn(observations: GateObservations, errors: DetectorErrors, rng) -> np.ndarray:
    """Return random errors (n, 4, 2) px of the detector in one reference flight."""
    view, count = _views(observations), 4 * len(observations.track.gates)
    sign, deformation = rng.choice([-1.0, 1.0], count), errors.deformation_px * rng.standard_normal((count, 3, 2))
    return errors.corners_px * sign[view][:, None, None] + _shape(observations.corners) @ deformation[view]
