"""A local draught beside a gain of thrust at the same place, as over a raised pad."""

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, STEP_S, flight, path, vehicle

from swift_sim_bridge.gap.attribution import wind
from swift_sim_bridge.gap.pipeline import prepare, references
from swift_sim_bridge.gap.pipeline.diagnosis import Options

RADIUS_M = 1.8


def place() -> np.ndarray:
    """Return a place that the flight passes."""
    return path().p_world[round(4.0 / STEP_S), 0] + [0.3, 0.2, -0.2]


def may_be_thrust(table) -> bool:
    """Return what the tool says of the draught that it finds in a flight."""
    with jax.enable_x64(True):
        evidence = prepare.prepare_evidence([table], vehicle(), Options(lambda text: None))
        evidence, keys, values = wind.select_local_wind(evidence, vehicle(), [], {}, lambda text: None)
        assert [key.split("[")[0] for key in keys] == ["local_draught"]
        effects = [one for one in evidence.effects if one.key in keys]
        return wind.may_be_thrust(evidence, vehicle(), effects, values)


@pytest.fixture(autouse=True)
def few_reference_flights(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)


def test_a_gain_of_thrust_over_a_pad_is_not_certainly_a_draught():
    pad = f"near({','.join(f'{x:.3f}' for x in (*place(), RADIUS_M))}) thrust"
    assert may_be_thrust(flight(6, equation={"rotor_thrust": {pad: {"coefficient": 0.15, "range": [0.0, 50.0]}}}))


@pytest.mark.slow
def test_a_draught_is_not_a_gain_of_thrust():
    assert not may_be_thrust(flight(6, local_draught=np.array([-2.0, 6.0, 0.0, *place(), RADIUS_M])))
