"""A pose and motor commands in slow rows: what lies between the rows is the recording's, not the vehicle's."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import planted_flight
import pytest

from swift_ros import geometry
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.inference.row_sampling import with_fitted_rows, with_rotor_spread
from swift_sim_bridge.gap.inference.sensitivity import linearise, perturbed_variants, with_effect_terms
from swift_sim_bridge.gap.nominal.rotor_speed_model import with_modelled_rotor_speeds
from swift_sim_bridge.gap.pipeline import references
from swift_sim_bridge.gap.pipeline.hypotheses import hypotheses_of
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

POSE = "p_world", "v_world", "q_world_body"
PASS_S = 0.002


@cache
def flight(inertia=1.0) -> FlightTable:
    """Return a flight of the shipped vehicle with a factor on its inertia."""
    vehicle = planted_flight.shipped()
    return flown(replace(vehicle, inertia=tuple(inertia * one for one in vehicle.inertia)))


def flown(vehicle, size=1.0) -> FlightTable:
    """Return a flight whose attitude has a noise of half a milliradian, as of motion capture. Of size 0 it hovers."""
    table, rng = planted_flight.record(vehicle, seconds=20.0, size=size), np.random.default_rng(8)
    q = table["q_world_body"]
    turn = geometry.quaternion_from_rotation_vector(5e-4 * rng.standard_normal((len(q.t), 3)))
    noisy = Samples(q.t, geometry.quaternion_multiply(q.values, turn))
    return FlightTable(table.name, {**table.channels, "q_world_body": noisy})


def logged(divisor: int, commands="held", noise=0.0, dense=None) -> FlightTable:
    """Return pose and commands of every `divisor`-th pass.

    Args:
        divisor: passes of the log between two rows.
        commands: `held`, the `mean` since the row before, or `late` by a pass.
        noise: standard deviation of a noise of the commands that comes and goes between two rows.
        dense: what flew; the shipped vehicle if None.
    """
    dense, rng = dense or flight(), np.random.default_rng(4)
    passes = np.arange(divisor, len(dense["p_world"].t), divisor)
    back = {"held": [0], "mean": range(divisor), "late": [1]}[commands]
    u = np.mean([dense["motor_command"].values[passes - one] for one in back], axis=0)
    u = np.clip(u + noise * rng.standard_normal(u.shape), 0.0, 1.0)
    channels = {name: Samples(dense[name].t[passes], dense[name].values[passes]) for name in POSE}
    return FlightTable("flight", channels | {"motor_command": Samples(dense["motor_command"].t[passes], u)})


def model(table: FlightTable) -> ResidualModel:
    vehicle = planted_flight.shipped()
    return ResidualModel(read_recording(with_modelled_rotor_speeds(table, vehicle), vehicle))


def effects_of(residual_model: ResidualModel):
    return hypotheses_of(planted_flight.shipped(), [residual_model.recording], (), ()).effects


def acts_later_s(table: FlightTable) -> float:
    """Return by how much the commands of a table act later than a smooth line through their rows, as the pose shows."""
    one = model(table)
    with jax.enable_x64(True):
        return with_fitted_rows(one, planted_flight.shipped(), effects_of(one)).command_rows.shift_s


@pytest.mark.parametrize(("commands", "earlier_passes"), [("mean", 2.0), ("late", 1.0)])
def test_the_pose_shows_what_commands_did_between_their_rows(commands, earlier_passes):
    held = acts_later_s(logged(5))
    assert held - acts_later_s(logged(5, commands)) == pytest.approx(earlier_passes * PASS_S, abs=1.2e-3)


def test_commands_in_slow_rows_are_no_error_of_the_vehicle_and_another_inertia_is(monkeypatch):
    """Before, the clean flight had a larger inertia, a slower motor and another torque."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 12)
    clean, heavy = (
        api.diagnose([logged(5, dense=one)], planted_flight.shipped(), lambda text: None, validate=False).report
        for one in (flight(), flight(inertia=1.3))
    )
    assert not clean["findings"]
    (inertia,) = heavy["findings"]
    assert inertia["effect"] == "inertia"
    found = [inertia["parameters"][f"inertia[{axis}]"]["value"] for axis in range(3)]
    assert found == pytest.approx(1.3 * np.array(planted_flight.shipped().inertia), rel=0.05)


def with_term(**term):
    vehicle = planted_flight.shipped()
    return replace(vehicle, terms={**vehicle.terms, **term})


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 0.3, 1.0])
def test_noise_of_commands_that_moves_no_motor_is_no_effect_and_no_equation(size, monkeypatch):
    """Before, a hover had another motor map, *confirmed*, and flights had moments that follow the attitude."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 12)
    table = logged(10, noise=0.02, dense=flown(planted_flight.shipped(), size=size))
    report = api.diagnose([table], planted_flight.shipped(), lambda text: None, validate=False).report
    assert not report["findings"]


@pytest.mark.slow
@pytest.mark.parametrize(("size", "noise"), [(0.0, 0.002), (0.0, 0.02), (0.3, 0.02)])
@pytest.mark.parametrize(
    ("planted", "possible"),
    [
        ({"payload": {"mass": 0.08, "position": [-0.005, 0.008, -0.03]}}, {"payload", "mass", "com_offset"}),
        ({"rotor_gain": {"gain": [-0.05, -0.01, -0.03, -0.02]}}, {"rotor_gain"}),
    ],
)
def test_a_load_is_no_loss_of_four_rotors_and_four_rotors_are_no_load(planted, possible, size, noise, monkeypatch):
    """Before, four weaker rotors in a flight of little motion were a load of 0 to 187 g, *confirmed*."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 12)
    table = logged(10, noise=noise, dense=flown(with_term(**planted), size=size))
    report = api.diagnose([table], planted_flight.shipped(), lambda text: None, validate=False).report
    assert report["findings"] and report["verdict"] != "unknown"
    for one in report["findings"]:
        assert possible & {one["effect"], *(other["effect"] for other in one["alternatives"])}
        file = {"mass": planted_flight.shipped().mass}
        intervals = {name: parameter["interval95"] for name, parameter in one["parameters"].items()}
        shown = any(not low <= file.get(name, 0.0) <= high for name, (low, high) in intervals.items())
        assert shown or one["verdict"] != "confirmed"


def test_noisy_commands_leave_the_size_of_the_moments_open():
    vehicle, lines = planted_flight.shipped(), []
    with jax.enable_x64(True):
        one = with_rotor_spread(model(logged(10, noise=0.05)), vehicle, lines.append)
        inertia = tuple(effect for effect in effects_of(one) if effect.id == "inertia")
        variants = perturbed_variants(with_effect_terms(vehicle, inertia), inertia, central=False)
        size = [
            np.linalg.norm(linearise(one, variants, marginal).sensitivity[:, :, one.columns["moment"]], axis=1)
            for marginal in (False, True)
        ]
    assert (np.array(one.rotor_spread.size[1:]) > 0.1).tolist() == [True, True, False]
    left = np.diag(size[1]) / np.diag(size[0])
    assert max(left[:2]) < 0.1
    (line,) = lines
    (rejection,) = one.recording.rejections
    assert "size of the rotors' moments about x, y" in line and "of the rotation" in rejection.reason


def test_commands_that_explain_the_rotation_leave_little_open():
    lines = []
    with jax.enable_x64(True):
        one = with_rotor_spread(model(logged(5)), planted_flight.shipped(), lines.append)
    assert 0.0 < max(one.rotor_spread.size) < 0.05 and not lines and not one.recording.rejections
