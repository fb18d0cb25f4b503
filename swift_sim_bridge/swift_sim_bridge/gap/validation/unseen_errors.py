"""Errors of a repair on the parts of the flights that its fit has not used, by simulation and to first order."""

from typing import NamedTuple

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import Evidence
from swift_sim_bridge.gap.attribution.gauss_newton import residuals_at, with_effects
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.channels import VOLTAGE
from swift_sim_bridge.gap.residuals.propulsion import excess_above_full
from swift_sim_bridge.gap.validation.parts import rows_of_choice
from swift_sim_bridge.gap.validation.trial import Trial


def unseen_error(evidence: Evidence, vehicle: Vehicle, file: Vehicle | None = None) -> float:
    """Return the error of a vehicle on the unseen parts, see `log_error`.

    Args:
        evidence: the recordings.
        vehicle: the vehicle.
        file: the vehicle of the file, where something unknown acts on the voltage. The residual of a voltage has no
            mean, because the charge at the first row is unknown; but what takes it above that of a full pack, where the
            file does not, is an error, too.
    """
    parts = []
    for one in evidence.residual_models:
        unseen = rows_of_choice(one)[1][:, None] & one.counted
        residual = np.array(one.residual(vehicle))
        for c in (c for c, channel in enumerate(one.channels) if channel.quantity == VOLTAGE):
            if file:
                residual[:, c] += excess_above_full(one.recording, vehicle, file)
        parts.append(np.where(unseen, residual, np.nan))
    return log_error(parts)


def log_error(parts) -> float:
    """Return the sum over c channels of log(root mean square) of residuals (m, c) of each recording, NaN for none."""
    residual = np.concatenate(parts)
    squares = np.nansum(np.square(residual), axis=0) / np.maximum(np.sum(np.isfinite(residual), axis=0), 1)
    return float(0.5 * np.sum(np.log(squares[squares > 0])))


class LinearProblem(NamedTuple):
    """A trial to first order in p changes of its values, in their steps.

    Attributes:
        information: (p, p) products of the sensitivities of the residuals that the fit uses.
        gradient: (p,) products of these sensitivities and residuals.
        unseen: of each recording, the linearisation, and which residuals judge: 1, NaN for the others.
    """

    information: np.ndarray
    gradient: np.ndarray
    unseen: list[tuple[Linearisation, np.ndarray]]

    def error(self, step: np.ndarray) -> float:
        """Return the error, see `log_error`, of the residuals that judge after a change (p,)."""
        return log_error(
            [(line.residual + np.tensordot(step, line.sensitivity, 1)) * known for line, known in self.unseen]
        )


def linear_problem(evidence: Evidence, vehicle: Vehicle, trial: Trial, rows) -> LinearProblem:
    """Return a trial to first order about its values.

    Args:
        evidence: the recordings.
        vehicle: the vehicle of the file, with the terms of all names.
        trial: the trial.
        rows: of each recording, which residuals (m,) the fit uses, and which judge it.
    """
    repaired = with_effects(vehicle, list(trial.effects), trial.values)
    if trial.effects:
        lines = evidence.cache.linearisations(evidence.residual_models, repaired, trial.effects, True)
    else:
        lines = residuals_at(evidence, repaired)
    products, unseen = [], []
    models = zip(evidence.residual_models, lines, evidence.sigmas, rows, strict=True)
    for one, line, sigma, (used, judging) in models:
        weight = (used[:, None] & one.measured) / sigma
        x = (line.sensitivity * weight).reshape(len(line.sensitivity), weight.size)
        products.append((x @ x.T, x @ (line.residual * weight).ravel()))
        unseen.append((line, np.where(judging[:, None] & one.counted, 1.0, np.nan)))
    information, gradient = (sum(parts) for parts in zip(*products, strict=True))
    return LinearProblem(information, gradient, unseen)
