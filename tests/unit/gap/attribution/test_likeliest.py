"""Of effects that a flight cannot distinguish, the likeliest is reported and repaired, whichever was found first."""

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, flight, vehicle

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.attribution import model_comparison, search
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult
from swift_sim_bridge.gap.attribution.gauss_newton import residuals_at
from swift_sim_bridge.gap.attribution.likeliest import with_likeliest_first
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.pipeline import prepare, references
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.pipeline.single_flight import repair

PROPELLER = "damaged_propeller[2]"


def evidence_of(key: str, values: tuple[float, ...]) -> tuple[Evidence, Vehicle]:
    """Return the evidence of a flight with this effect, and the vehicle with the terms of all effects."""
    with jax.enable_x64(True), pytest.MonkeyPatch.context() as patched:
        patched.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
        evidence = prepare.prepare_evidence([flight(4, **{key: values})], vehicle(), Options(lambda text: None))
        return evidence, with_effect_terms(vehicle(), evidence.effects)


def found_first(evidence: Evidence, known: Vehicle, key: str, values) -> SearchResult:
    """Return the result of a search that has selected this effect alone."""
    initial = model_comparison.normalised_squares(evidence, residuals_at(evidence, known))
    explanation = model_comparison.explain(evidence, known, [key], {key: np.array(values)}, initial)
    return SearchResult(tuple(search.described(evidence, known, explanation)), (), evidence)


def squares(evidence: Evidence, repaired: Vehicle) -> float:
    """Return the squares of what a repaired vehicle leaves of the flight."""
    return model_comparison.normalised_squares(evidence, residuals_at(evidence, repaired))


def test_a_centre_of_mass_stands_for_the_propeller_that_was_found_in_its_place():
    planted = 0.17e-3 * np.array([0.775, -1.0, 0.0])  # towards rotor 2: the moment of its damaged propeller
    evidence, known = evidence_of("com_offset", planted)
    with jax.enable_x64(True):
        first = found_first(evidence, known, PROPELLER, [0.006])
        (one,) = with_likeliest_first(first, known, print).selected
    assert first.selected[0].verdict == "ambiguous" and first.selected[0].confounders["com_offset"] > 0.9
    assert one.effect.key == one.likeliest == "com_offset" and one.verdict != "confirmed"
    assert one.values[:2] == pytest.approx(planted[:2], abs=3.0 * np.sqrt(one.covariance[0, 0]))
    with jax.enable_x64(True):
        before, after = (squares(evidence, repair(known, (some,))) for some in (first.selected[0], one))
    assert after < before


def test_a_damaged_propeller_that_was_found_stays():
    evidence, known = evidence_of(PROPELLER, (0.006,))
    with jax.enable_x64(True):
        first = found_first(evidence, known, PROPELLER, [0.006])
        (one,) = with_likeliest_first(first, known, print).selected
    assert one.effect.key == PROPELLER and one.values == pytest.approx([0.006], abs=0.002)
