"""Rows that are slower than the flight controller's loop: what lies between them is the recording's, not the vehicle's.

The logs have no pose, and come from a second, plain implementation of motors and battery that runs at 250 Hz.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest
from motor_log import VEHICLE, T, log

from swift_ros.recording.flight_table import FlightTable, RowSampling, Samples
from swift_sim_bridge.effects import MOTOR_CHANNELS
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.inference import nuisance
from swift_sim_bridge.gap.inference.row_sampling import row_bounds, with_fitted_rows
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

LOOP_S = T[1]
LOOP = replace(VEHICLE, controller={"type": "rate_p", "rate_hz": 1.0 / LOOP_S, "k_w": [20.0, 20.0, 8.0]})


def logged(dense: FlightTable, divisor: int, commands: str) -> FlightTable:
    """Return a log with a row for every `divisor`-th pass; its commands are `held`, the `mean`, or `late` by a pass."""
    passes = np.arange(divisor, len(T), divisor)
    back = {"held": [0], "mean": range(divisor), "late": [1]}[commands]
    channels = {name: Samples(T[passes], samples.values[passes]) for name, samples in dense.channels.items()}
    u = np.mean([dense["motor_command"].values[passes - one] for one in back], axis=0)
    return FlightTable(dense.name, {**channels, "motor_command": Samples(T[passes], u)})


def acts_later_s(divisor: int, commands: str) -> float:
    """Return by how much the commands act later than a smooth line through the rows."""
    return {"held": 0.5, "mean": 1.0 - 0.5 * divisor, "late": -0.5}[commands] * LOOP_S


@pytest.mark.parametrize("commands", ["held", "mean", "late"])
def test_what_the_commands_did_between_the_rows_is_recovered_beside_a_lag(commands):
    table = logged(log(3, lag_s=0.038), 2, commands)
    effects = tuple(effect for effect in catalogue(LOOP) if effect.channels == MOTOR_CHANNELS)
    with jax.enable_x64(True):
        found = with_fitted_rows(ResidualModel(read_recording(table, LOOP)), LOOP, effects).command_rows
    assert found.shift_s == pytest.approx(acts_later_s(2, commands), abs=5e-4)


def test_averaged_commands_in_slow_rows_are_not_a_motor_lag_and_a_true_lag_beside_them_is(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 12)
    clean, slow = (
        api.diagnose([logged(log(seed, lag_s=lag_s), 4, "mean")], LOOP, lambda text: None, validate=False).report
        for seed, lag_s in ((1, 0.033), (2, 0.043))
    )
    assert clean["verdict"] == "cannot_tell", clean["findings"]
    (lag,) = slow["findings"]
    assert lag["effect"] == "motor_time_constant"
    value = lag["parameters"]["time_constant_up"]
    assert value["value"] == pytest.approx(0.043, rel=0.04)
    low, high = value["interval95"]
    assert high - low > 5e-4  # the rows leave this much open
    assert clean["minimum_detectable"]["motor_time_constant"]["time_constant_up"] < 0.006


def test_rows_of_every_pass_or_with_a_declared_meaning_leave_nothing_open():
    dense = log(5)
    every = read_recording(dense, LOOP)
    assert every.motor_record.rows is None and not every.undeclared_rows_s
    table = logged(dense, 4, "mean")
    undeclared = read_recording(table, LOOP)
    assert row_bounds(undeclared) == {
        "time_offset": pytest.approx(2.0 * LOOP_S),
        "command_latency": pytest.approx(4.0 * LOOP_S),
        "motor_asymmetry": pytest.approx(0.2 * LOOP_S),
    }
    named = dict.fromkeys(table.channels, RowSampling("mean"))
    declared = read_recording(replace(table, sampling=named), LOOP)
    assert not declared.undeclared_rows_s
    assert declared.motor_record.rows.shift_s == pytest.approx(acts_later_s(4, "mean"))
    assert declared.motor_record.rows.sigma[0] < 0.2 * undeclared.motor_record.rows.sigma[0]


def test_a_nuisance_parameter_takes_its_direction_out_as_far_as_it_is_unknown():
    rng = np.random.default_rng(0)
    direction, other = rng.standard_normal((2, 200, 1))
    direction /= np.linalg.norm(direction)
    other -= direction * np.sum(other * direction)
    for sigma, left in ((0.1, 1.0), (3.0, 10.0**-0.5), (1e6, 0.0)):
        found = nuisance.without_nuisance(5.0 * direction + other, sigma * direction[None])
        assert np.sum(found * direction) == pytest.approx(5.0 * left, abs=0.03)
        assert np.allclose(found - direction * np.sum(found * direction), other)
