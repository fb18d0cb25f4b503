"""A black box of what the repair leaves: it joins where unseen data call for it, and is refused where it fits noise."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from lissajous_flight import STEP_S, flight, vehicle

from swift_ros.recording.flight_table import RowSampling
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.nominal.rotor_speed_model import with_modelled_rotor_speeds
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.rollout import black_box_force
from swift_sim_bridge.gap.validation import holdout
from swift_sim_bridge.gap.validation.black_boxes import MODELS, Samples, compared, fit_remainder
from swift_sim_bridge.gap.validation.parts import whole
from swift_sim_bridge.gap.validation.running_level import running_level

DRAG = 6e-5  # N/(rad/s m/s), of a rotor
NOISE = 0.1  # m/s^2
AMPLITUDES, MIDDLE = [6.0, 6.0, 2.0, 2.0, 2.0, 1.0, 3.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 11.0]  # of the inputs


def states(seed: int, count: int = 1000) -> np.ndarray:
    """Return inputs of a black box (count, 7) along a smooth flight, 20 ms apart."""
    rng = np.random.default_rng(seed)
    t, rates = 0.02 * np.arange(count)[:, None], rng.uniform(0.5, 2.5, 7)
    return np.sin(rates * t + rng.uniform(0.0, 6.0, 7)) * AMPLITUDES + MIDDLE


def noise(seed: int, count: int = 1000) -> np.ndarray:
    return NOISE * np.random.default_rng(seed).standard_normal((count, 3))


def test_the_remainder_joins_on_the_axis_where_the_repair_leaves_a_force_and_on_no_other():
    inputs, targets = states(1), noise(2)
    force = 0.5 * np.tanh(0.5 * inputs[:, 0])
    targets[:, 0] += force
    box, kinds = fit_remainder([Samples(inputs, targets)], same_flights=True)
    assert kinds == {"x": "gp", "y": "none", "z": "none"}
    added = np.asarray(black_box_force(box, inputs))
    assert np.std(added[:, 0] - force) < 0.3 * np.std(force) and not added[:, 1:].any()


@pytest.mark.parametrize("seed", range(4))
def test_what_only_fits_noise_is_refused(seed):
    box, kinds = fit_remainder([Samples(states(seed), noise(seed + 10))], same_flights=True)
    assert set(kinds.values()) == {"none"} and not box.targets.any()


def test_a_drift_that_a_black_box_learns_by_heart_is_refused():
    inputs, targets = states(3), noise(4)
    inputs[:, 6] = np.linspace(9.0, 13.0, len(inputs))  # the pack empties: a stand-in for the time
    targets += np.sin(np.linspace(0.0, 12.0, len(inputs)))[:, None]
    _, kinds = fit_remainder([Samples(inputs, targets)], same_flights=True)
    assert set(kinds.values()) == {"none"}


def test_what_one_flight_alone_shows_is_refused_and_what_all_show_is_not():
    flights = [Samples(states(seed), noise(seed + 20)) for seed in range(3)]
    for seed, one in enumerate(flights):
        one.targets[:, 0] += 0.5 * np.tanh(0.5 * one.inputs[:, 0])
        one.targets[:, 1] += [0.5, -0.5, 0.5][seed] * np.tanh(0.5 * one.inputs[:, 1])
    _, kinds = fit_remainder(flights, same_flights=False)
    assert kinds["x"] != "none" and kinds["y"] == kinds["z"] == "none"


def test_each_axis_has_a_length_scale_of_its_own():
    flights = [Samples(states(seed) * [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], noise(seed + 50)) for seed in range(4)]
    for one in flights:
        one.targets[:, 0] += 0.5 * np.sin(0.8 * one.inputs[:, 0])
        one.targets[:, 2] += 0.1 * one.inputs[:, 0]
    *learned, other = flights
    box, kinds = fit_remainder(learned, same_flights=False)
    assert kinds == {"x": "gp", "y": "none", "z": "gp"} and box.lengths[0] < box.lengths[2]
    left = other.targets - np.asarray(black_box_force(box, other.inputs))
    assert np.std(left, axis=0) == pytest.approx([NOISE] * 3, rel=0.1)


BIASES = [0.4, 0.1, 0.7, -0.3]  # m/s^2 along y, of three flights and of another one


def biased_flights() -> list[Samples]:
    """Return four flights with the same force along x; along y each has a bias of its own."""
    flights = [Samples(states(seed), noise(seed + 30)) for seed in range(4)]
    for one, bias in zip(flights, BIASES, strict=True):
        one.targets[:, 0] += 0.5 * np.tanh(0.5 * one.inputs[:, 0]) + bias
        one.targets[:, 1] += bias
    return flights


def test_the_bias_of_the_learned_flights_is_not_carried_over_to_another_flight():
    *learned, other = biased_flights()
    box, kinds = fit_remainder(learned, same_flights=False)
    added = np.asarray(black_box_force(box, other.inputs))
    assert kinds["x"] != "none" and kinds["y"] == kinds["z"] == "none"
    assert not added[:, 1:].any()
    left = other.targets[:, 0] - added[:, 0]
    assert abs(left.mean() - BIASES[-1]) < 0.1  # its own bias is left, as it was
    assert np.std(left) < 0.5 * np.std(other.targets[:, 0])  # and the force is not


def test_the_bias_of_a_flight_is_left_to_its_running_level():
    inputs, targets = biased_flights()[0]
    box, kinds = fit_remainder([Samples(inputs[:700], targets[:700])], same_flights=True)
    assert kinds["x"] == "gp" and kinds["z"] == "none"
    left = targets - np.asarray(black_box_force(box, inputs))
    left = (left - running_level(0.02 * np.arange(len(left)), left))[700:]
    assert np.abs(left.mean(axis=0)).max() < 0.02
    assert np.std(left[:, 0]) < 0.5 * np.std(targets[700:, 0])


@cache
def strange_flight(seed: int) -> tuple:
    """Return a flight with a drag, and with a force that no name covers: it saturates with the forward speed."""
    table = flight(
        seed, rotor_drag=[DRAG], equation={"force_x": {"v_x": {"coefficient": -0.2, "range": [-12.0, 12.0]}}}
    )
    with jax.enable_x64(True):
        return table, ResidualModel(read_recording(table, vehicle()))


@cache
def repaired() -> tuple:
    """Return the drag, and the vehicle that has it."""
    drag = next(one for one in catalogue(vehicle()) if one.id == "rotor_drag")
    return drag, inject(vehicle(), drag, [DRAG])


def test_the_remainder_learns_from_the_thrust_of_the_repaired_vehicle_which_rollouts_give_it():
    learned = strange_flight(3)[1]
    stronger = replace(vehicle(), thrust_coefficient=1.2 * vehicle().thrust_coefficient)
    with jax.enable_x64(True):
        _, _, remainder, _, alone = compared([whole(learned)], vehicle(), stronger, same_flights=True).boxes
    thrust, of_file = ((box.inputs * box.scale)[:, 6] for box in (remainder, alone))
    np.testing.assert_allclose(thrust, 1.2 * of_file)
    np.testing.assert_array_equal(learned.rotor_speed(stronger), learned.recording.rotor_speed)


def test_motors_that_commands_drive_have_the_speeds_of_the_vehicle_that_is_compared():
    table = flight(3)
    kept = {name: table[name] for name in ("p_world", "q_world_body", "motor_command")}
    table = replace(table, channels=kept, sampling={"motor_command": RowSampling("held", loop_hz=1.0 / STEP_S)})
    slower = replace(vehicle(), motor=replace(vehicle().motor, time_constant_up=0.2, time_constant_down=0.2))
    with jax.enable_x64(True):
        model = ResidualModel(read_recording(with_modelled_rotor_speeds(table, vehicle()), vehicle()))
        of_file, of_slower = (model.rotor_speed(one) for one in (vehicle(), slower))
    np.testing.assert_allclose(of_file, model.recording.rotor_speed, rtol=1e-3)
    assert np.std(np.diff(of_slower, axis=0)) < 0.5 * np.std(np.diff(of_file, axis=0))


@pytest.mark.slow
def test_repair_and_remainder_together_predict_the_unseen_part_better_than_repair_or_black_boxes_alone():
    with jax.enable_x64(True):
        found = holdout.validate((strange_flight(3)[1],), vehicle(), repaired()[1], ())
    assert found.entry["remainder"] == {"x": "gp", "y": "none", "z": "none"}
    x, rollout = found.entry["one_step_rmse_by_axis"]["x"], found.entry["rollout_rmse_m"]["0.5"]
    assert x["with_remainder"] < 0.9 * min(x["after"], x["knn"], x["gp"])
    assert rollout["with_remainder"] < 0.7 * min(rollout["after"], rollout["knn"], rollout["gp"])
    for axis in "yz":
        errors = found.entry["one_step_rmse_by_axis"][axis]
        assert errors["with_remainder"] == pytest.approx(errors["after"], rel=0.02)
        assert max(errors["with_remainder"], errors["after"]) < min(errors["knn"], errors["gp"])
    assert found.trajectories[0].flown.shape[0] == len(MODELS)


def test_a_whole_flight_that_nothing_has_learned_from_is_predicted_by_axis(capsys):
    drag, after = repaired()
    learned, (unseen, _) = strange_flight(3)[1], strange_flight(4)
    evidence = SimpleNamespace(residual_models=(learned,))
    diagnosis = SimpleNamespace(selected=(SimpleNamespace(effect=drag),), vehicle=after, evidence=evidence)
    (entry,) = api.predict_unseen(diagnosis, vehicle(), [replace(unseen, name="later flight")])
    assert entry["recording"] == "later flight" and "later flight: predicting it" in capsys.readouterr().out
    for axis, errors in entry["one_step_rmse_by_axis"].items():
        assert errors["with_remainder"] < 1.02 * min(errors["after"], errors["knn"], errors["gp"]), axis
    assert entry["one_step_rmse_by_axis"]["x"]["with_remainder"] < 0.4 * entry["one_step_rmse_by_axis"]["x"]["after"]
    leveled = entry["one_step_rmse_with_level_by_axis"]
    assert leveled["x"]["with_remainder"] == entry["one_step_rmse_by_axis"]["x"]["with_remainder"]
    assert leveled["x"]["gp"] != entry["one_step_rmse_by_axis"]["x"]["gp"]
    assert entry["one_step_rmse_by_channel"]["gyro_x"]["before"] > 0.0
