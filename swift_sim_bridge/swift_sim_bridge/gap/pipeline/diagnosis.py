"""What a diagnosis takes and returns, for one recording or several."""

from collections.abc import Callable
from dataclasses import dataclass

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution.evidence import Evidence, SelectedEffect
from swift_sim_bridge.gap.discovery.equation_search import EquationTerm
from swift_sim_bridge.gap.validation import holdout

VALIDATING = "before and after, on parts of the flights that no fit has seen"  # progress messages of both pipelines
REPEATING = "diagnosing again, with the repaired vehicle"


@dataclass(frozen=True)
class Options:
    """How a diagnosis is made.

    Attributes:
        progress: called with one line of text at each stage.
        seed: seed of the reference flights.
        knocked_out: ids of effects that are left out of the catalogue.
        validate: whether to compute the errors before and after the repair on parts of the flights that no fit has
            seen, and to diagnose the repaired vehicle again; a third of the computing time.
    """

    progress: Callable[[str], None] = print
    seed: int = 0
    knocked_out: tuple[str, ...] = ()
    validate: bool = True


@dataclass(frozen=True)
class Diagnosis:
    """The result of a diagnosis.

    Attributes:
        report: content of report.json.
        vehicle: the repaired vehicle.
        selected: the selected effects with their estimated parameters.
        evidence: what the search worked on.
        holdout_result: errors before and after the repair on parts of the flights that no fit has seen; empty without
            `Options.validate`.
        equation_terms: terms of the equation that describes what no effect of the catalogue explains.
        own_effects: selected effects of each recording alone, one tuple for each of several recordings; `selected` and
            `vehicle` hold their mean. Empty for one recording.
    """

    report: dict
    vehicle: Vehicle
    selected: tuple[SelectedEffect, ...]
    evidence: Evidence
    holdout_result: holdout.HoldoutResult
    equation_terms: tuple[EquationTerm, ...] = ()
    own_effects: tuple[tuple[SelectedEffect, ...], ...] = ()
