"""Numbers of the file that are wrong by a large factor: found before the search, then fitted and named."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, STEP_S, flight, vehicle

from swift_ros.recording.flight_table import RowSampling
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.attribution.far_start import far_start
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

EFFECTS = {effect.key: effect for effect in catalogue(vehicle())}
EVERY_COMMAND = {"motor_command": RowSampling("held", loop_hz=1.0 / STEP_S)}


def flown(seed: int):
    return replace(flight(seed), sampling=EVERY_COMMAND)


def wrong(key: str, factor: float) -> Vehicle:
    """Return the file of the vehicle with the first number of an effect (of a drag all) wrong by a factor."""
    values = file_values(EFFECTS[key], vehicle())
    values[: 3 if "drag" in key else 1] *= factor
    return inject(vehicle(), EFFECTS[key], values)


def started(file: Vehicle) -> dict:
    with jax.enable_x64(True):
        model = ResidualModel(read_recording(flown(6), file))
        return far_start([model], file, catalogue(file), lambda text: None)


@pytest.mark.parametrize(
    ("key", "factor"),
    [("motor_time_constant", 0.1), ("motor_time_constant", 10.0), ("body_drag", 30.0), ("battery_sag", 10.0)],
)
def test_the_search_starts_near_the_true_value(key, factor):
    found = started(wrong(key, factor))
    assert set(found) == {key}
    assert found[key][0] == pytest.approx(file_values(EFFECTS[key], vehicle())[0], rel=0.3)


@pytest.mark.parametrize(("key", "factor"), [("motor_time_constant", 1.0), ("motor_time_constant", 1.4)])
def test_near_the_file_the_search_starts_with_nothing(key, factor):
    assert started(wrong(key, factor)) == {}


@pytest.mark.parametrize("factor", [0.1, pytest.param(10.0, marks=pytest.mark.slow)])
def test_a_lag_ten_times_off_is_named_with_its_size(factor, monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    file = wrong("motor_time_constant", factor)
    report = api.diagnose([flown(7)], file, lambda text: None, validate=False).report
    (lag,) = report["findings"]
    assert lag["effect"] == "motor_time_constant"
    true = vehicle().motor.time_constant_up
    assert lag["parameters"]["time_constant_up"]["value"] == pytest.approx(true, rel=0.05)
    assert np.isfinite(report["minimum_detectable"]["motor_time_constant"]["time_constant_up"])
