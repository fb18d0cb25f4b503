"""A force at one place is in the repair, though the part of the flight that judges does not pass the place."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, flight, vehicle

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.attribution.evidence import SearchResult, Unexplained
from swift_sim_bridge.gap.discovery.polynomial_search import Found
from swift_sim_bridge.gap.pipeline import prepare, references
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.residuals.channels import SPECIFIC_FORCE
from swift_sim_bridge.gap.validation import repair_trials, unseen_errors

LIFT_M_S2, RADIUS_M = 4.0, 1.5


@pytest.mark.slow
def test_a_place_that_the_judging_part_does_not_pass_is_in_the_repair(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    table = flight(3)
    p, force = table["p_world"], table["specific_force_body"]
    center = p.values[len(p.values) // 5].round(2)
    at = np.stack([np.interp(force.t, p.t, axis) for axis in p.values.T], axis=1)
    weight = np.maximum(1.0 - np.sum((at - center) ** 2, axis=1) / RADIUS_M**2, 0.0) ** 2
    lifted = Samples(force.t, force.values + LIFT_M_S2 * weight[:, None] * [0.0, 0.0, 1.0])
    near = f"near({','.join(f'{x:.3f}' for x in (*center, RADIUS_M))})"
    rows_of_choice = repair_trials.rows_of_choice

    def elsewhere(model):
        fitted, judging = rows_of_choice(model)
        apart = np.linalg.norm(model.recording.p_world - center, axis=1)[model.filter.rows]
        return fitted, judging & (apart > 2.0 * RADIUS_M)

    for module in (repair_trials, unseen_errors):
        monkeypatch.setattr(module, "rows_of_choice", elsewhere)
    with jax.enable_x64(True):
        changed = FlightTable("lifted", {**table.channels, "specific_force_body": lifted})
        evidence = prepare.prepare_evidence([changed], vehicle(), Options(lambda text: None))
        evidence = replace(evidence, library=replace(evidence.library, places=(near,)))
        (channel,) = (
            one for one in evidence.residual_models[0].channels if (one.quantity, one.axis) == (SPECIFIC_FORCE, "z")
        )
        found = SearchResult((), (), evidence, unexplained=(Unexplained(channel, 0.5, 9.0, ""),))
        judge = repair_trials.Judge(evidence, vehicle(), found)
        best = judge.best_of(())
        everywhere = Found("force_y", "v_x v_z", (-90.0, 90.0), 0.01)
        both = judge._beside_names(best, [*best.found, everywhere])
        left = judge._not_shown(both)
    assert [one.product.startswith(near) for one in best.found] == [True]
    assert both.found == (*best.found, everywhere) and tuple(left) == best.found
