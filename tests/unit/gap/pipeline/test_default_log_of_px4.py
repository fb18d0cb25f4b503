"""The default log of PX4 has a slow pose, a fast IMU and the collective thrust: enough for masses and drags."""

from dataclasses import replace

import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, flight, vehicle

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.pipeline import references

RATES_HZ = {"p_world": 10.0, "v_world": 10.0, "q_world_body": 20.0, "motor_command": 50.0, "voltage": 5.0}
HALF = 5  # rows on each side between which the velocity is the mean


@pytest.fixture(autouse=True)
def few_reference_flights(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)


def logged(table: FlightTable) -> FlightTable:
    """Return a flight as PX4 logs it by default: every command is the mean of all motors'."""
    p, channels = table["p_world"], {}
    v_world = (p.values[2 * HALF :] - p.values[: -2 * HALF]) / (p.t[2 * HALF :] - p.t[: -2 * HALF])[:, None]
    whole = {**table.channels, "v_world": Samples(p.t[HALF:-HALF], v_world)}
    for name in (*RATES_HZ, "gyro_body", "specific_force_body"):
        samples = whole[name]
        stride = round(samples.rate_hz / RATES_HZ.get(name, samples.rate_hz))
        channels[name] = Samples(samples.t[::stride], samples.values[::stride])
    commands = channels["motor_command"]
    mean = np.repeat(commands.values.mean(axis=1, keepdims=True), commands.values.shape[1], axis=1)
    channels["motor_command"] = Samples(commands.t, mean)
    return replace(table, channels=channels, skips_commands=True, one_clock=True)


def findings(seed: int, **planted) -> dict:
    report = api.diagnose([logged(flight(seed, **planted))], vehicle(), lambda text: None, validate=False).report
    return {one["effect"]: one for one in report["findings"]}


@pytest.mark.slow
def test_the_vehicle_of_the_file_gives_no_finding():
    assert not findings(seed=2)


@pytest.mark.slow
def test_a_mass_is_found_with_its_size():
    found = findings(seed=3, mass=[1.1 * vehicle().mass])
    (one,) = found.values()
    names = {one["effect"], *(other["effect"] for other in one["alternatives"])}
    assert "mass" in names, found


@pytest.mark.slow
def test_a_drag_is_found_with_its_size():
    found = findings(seed=4, linear_drag=[0.2, 0.3, 0.1])
    assert set(found) == {"linear_drag"}, found
    values = [one["value"] for one in found["linear_drag"]["parameters"].values()]
    np.testing.assert_allclose(values, [0.2, 0.3, 0.1], atol=0.03)
