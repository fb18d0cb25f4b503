"""Hold-out validation: errors before and after the repair, on parts of the flights that no fit has used.

The repaired vehicle, alone and with a black-box model of the remaining forces, is compared with the nominal one, and
with the nominal one plus such a model of all it leaves out.
"""

from dataclasses import dataclass, field

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.rollout import Trajectories
from swift_sim_bridge.gap.validation.black_boxes import compared
from swift_sim_bridge.gap.validation.parts import Part, rows_by_part
from swift_sim_bridge.gap.validation.prediction_errors import evaluate


@dataclass(frozen=True)
class HoldoutResult:
    """The result of a hold-out validation.

    Attributes:
        entry: entry `held_out` of report.json.
        trajectories: of each recording, the rollouts of `black_boxes.MODELS` on its held-out part.
    """

    entry: dict = field(default_factory=dict)
    trajectories: tuple[Trajectories, ...] = ()


def validate(residual_models: tuple[ResidualModel, ...], before: Vehicle, after: Vehicle, effects) -> HoldoutResult:
    """Return the errors on the held-out part of each recording, see `prediction_errors.evaluate`.

    Args:
        residual_models: the recordings.
        before: the nominal vehicle.
        after: the vehicle with the selected effects, fitted to the training part of each flight.
        effects: the selected effects.
    """
    before, after = (with_effect_terms(vehicle, tuple(effects)) for vehicle in (before, after))
    split = [(one, *rows_by_part(one)) for one in residual_models]
    held_out = [Part(one, rows) for one, _, rows in split if rows.any()]
    if not held_out:
        return HoldoutResult()
    learned = [Part(one, rows) for one, rows, _ in split]
    return HoldoutResult(*evaluate(held_out, compared(learned, before, after, same_flights=True)))
