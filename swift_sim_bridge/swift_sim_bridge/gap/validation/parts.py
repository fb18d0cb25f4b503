"""Parts of recordings: those that fits use, and those that are held out."""

from dataclasses import dataclass

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

TRAINING_SHARE = 0.7  # of each flight, from its start, that the fits use; the rest is held out
CHOICE_SHARE = 0.5  # that the fits use between which a repair is chosen; the rest of the training part judges them
SLOW_SHARE = 0.6  # of the seconds of the training part that count as slow


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


def rows_by_pace(residual_model: ResidualModel) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return which residuals (m,) of the part that fits use lie in slow seconds, and which in fast ones.

    There is one pair for the vehicle's speed and one for that of its rotors, where these were recorded. A second counts
    by the largest that it reaches.
    """
    recording, known = residual_model.recording, _rows_between(residual_model, 0.0, TRAINING_SHARE)
    second, pairs = np.floor(residual_model.t - residual_model.t[0]).astype(int), {}
    for name in ("v_world", "rotor_speed"):
        if not recording.has(name) or not known.any():
            continue
        pace = np.linalg.norm(getattr(recording, name), axis=1)[residual_model.filter.rows]
        reached = np.full(second[-1] + 1, -np.inf)
        np.maximum.at(reached, second[known], pace[known])
        slow = (reached <= np.quantile(reached[np.isfinite(reached)], SLOW_SHARE))[second]
        pairs[name] = known & slow, known & ~slow
    return pairs


def _rows_between(residual_model: ResidualModel, begin: float, end: float) -> np.ndarray:
    """Return which residuals (m,) can be compared and lie between two shares of those that can."""
    good = residual_model.good
    before = np.cumsum(good)
    return good & (before > np.ceil(begin * before[-1])) & (before <= np.ceil(end * before[-1]))
