"""Parts of recordings: those that fits use, and those that are held out."""

from dataclasses import dataclass

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

TRAINING_SHARE = 0.7  # of each flight, from its start, that the fits use; the rest is held out
CHOICE_SHARE = 0.5  # that the fits use between which a repair is chosen; the rest of the training part judges them


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
    return _rows_between(residual_model, 0.0, TRAINING_SHARE), _rows_between(residual_model, TRAINING_SHARE, 1.0)


def rows_of_choice(residual_model: ResidualModel) -> tuple[np.ndarray, np.ndarray]:
    """Return which residuals (m,) the fits use between which a repair is chosen, and which judge them.

    Both are in the part that fits use: what is held out has no part in the choice.
    """
    return (
        _rows_between(residual_model, 0.0, CHOICE_SHARE),
        _rows_between(residual_model, CHOICE_SHARE, TRAINING_SHARE),
    )


def _rows_between(residual_model: ResidualModel, begin: float, end: float) -> np.ndarray:
    """Return which residuals (m,) can be compared and lie between two shares of those that can."""
    good = residual_model.good
    before = np.cumsum(good)
    return good & (before > np.ceil(begin * before[-1])) & (before <= np.ceil(end * before[-1]))
