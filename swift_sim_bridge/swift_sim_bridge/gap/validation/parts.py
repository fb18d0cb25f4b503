"""Parts of recordings: those that fits use, and those that are held out."""

from dataclasses import dataclass

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

TRAINING_SHARE = 0.7  # of each flight, from its start, that the fits use; the rest is held out


@dataclass(frozen=True)
class Part:
    """A part of a recording.

    Attributes:
        residual_model: of the recording.
        rows: which residuals (m,) belong to the part.
    """

    residual_model: ResidualModel
    rows: np.ndarray

    @property
    def begin_s(self) -> float:
        """The time s at which the part begins."""
        return float(self.residual_model.t[np.argmax(self.rows)])

    @property
    def speed(self) -> np.ndarray:
        """The speed (k,) m/s at the residuals of the part."""
        speed = np.linalg.norm(self.residual_model.recording.v_world, axis=1)
        return speed[self.residual_model.filter.rows][self.rows]

    def errors(self, vehicle: Vehicle) -> np.ndarray:
        """Return the residuals (k, c) of the part, NaN where nothing was measured."""
        one = self.residual_model
        return np.where(one.measured, one.residual(vehicle), np.nan)[self.rows]


def whole(residual_model: ResidualModel) -> Part:
    """Return all of a recording that can be compared."""
    return Part(residual_model, residual_model.good)


def rows_by_part(residual_model: ResidualModel) -> tuple[np.ndarray, np.ndarray]:
    """Return which residuals (m,) the fits use, and which are held out."""
    good, t = residual_model.good, residual_model.t[residual_model.good]
    end_s = t[int(np.ceil(TRAINING_SHARE * len(t))) - 1] if len(t) else residual_model.t[-1]
    training = residual_model.t <= end_s
    return good & training, good & ~training
