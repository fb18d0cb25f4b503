"""The referee's flights: pilot, commands, air and paths, what an effect changes, and what the instruments read."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plant_states import content, state

from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.referee import holdout
from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.effects.planting import conceal
from swift_sim_bridge.referee.simulator import (
    disturbances,
    flight,
    instruments,
    paths,
    pilot,
    plant,
    vehicles,
)

pytestmark = pytest.mark.usefixtures("double_precision")


STANDING_S = 4.0


def standing() -> paths.Path:
    """Return a path that stays at one place."""
    count = round(STANDING_S / paths.TICK_S)
    zeros = np.zeros((count, 3))
    return paths.Path(zeros + [0.0, 0.0, 3.0], zeros, zeros, np.zeros(count), np.zeros(count), zeros)


@cache
def fleet() -> dict:
    """Return flights of 4 s by name: a hover, and for each effect an order and its truth, with it and without."""
    still = flight.Order(content(), content(), standing(), 1)
    orders = []
    for name in EFFECTS:
        kind = {"ground_effect": "low", "vortex_ring": "dives"}.get(name, "lissajous")
        path = paths.draw_path(np.random.default_rng(10), kind, STANDING_S, 45.0, 14.0, 0.5)
        described = vehicles.draw_vehicle(np.random.default_rng(5), "test")
        planted = EFFECTS[name].plant(described, EFFECTS[name].detectable * 10, np.random.default_rng(2))
        if name == "local_draught":
            planted |= {("terms", name, "center", i): float(path.p[300, i]) for i in range(3)}
        orders += [flight.Order(one, described, path, 1) for one in (conceal(described, planted), described)]
    flown = flight.fly([still, *orders])
    pairs = list(zip(orders, flown[1:], strict=True))
    return {"hover": flown[0]} | {name: pairs[2 * i : 2 * i + 2] for i, name in enumerate(EFFECTS)}


def test_in_a_hover_the_rotors_carry_the_weight_and_the_accelerometer_reads_gravity():
    described, flown = content(), fleet()["hover"]
    thrust = described["thrust_coefficient"] * np.sum(flown.rotor_speed[-100:] ** 2, axis=1)
    np.testing.assert_allclose(thrust, described["mass"] * GRAVITY, rtol=1e-3)
    np.testing.assert_allclose(flown.specific_force[-100:], [[0.0, 0.0, GRAVITY]] * 100, atol=0.02)


def test_the_motor_commands_of_the_rate_loop_give_the_demanded_torque_and_thrust():
    described = content()
    own, torque = pilot.controls_of(described), (0.05, -0.04, 0.01)
    thrusts = np.array(pilot.thrusts(1.3 * described["mass"] * GRAVITY, torque, own))
    numbers = plant.plant_of(described)
    speeds = np.sqrt(thrusts / described["thrust_coefficient"])
    spins = state(spin=speeds)
    force, moment = plant.wrench(spins, (0.0, 0.0, 0.0), (0.0,) * 4, (0.0,) * 4, numbers)
    np.testing.assert_allclose(moment, torque, rtol=1e-9)
    assert force[2] == pytest.approx(1.3 * described["mass"] * GRAVITY)
    u = float(pilot.command_of(thrusts[0], own))
    assert float(plant.steady_speed(u, described["battery"]["reference_voltage"], numbers)) == pytest.approx(speeds[0])


def test_no_rotor_leaves_its_range_for_more_torque_than_the_rotors_have():
    own = pilot.controls_of(content())
    low, high = own["thrust"]
    for collective in (0.1 * high, 2.0 * high, 3.9 * high):
        found = np.array(pilot.thrusts(collective, (3.0, -2.0, 0.5), own))
        assert np.all(found >= low - 1e-9) and np.all(found <= high + 1e-9)


def test_commands_are_late_and_lost_according_to_the_terms():
    rng = np.random.default_rng(0)
    still = disturbances.command_ages({}, 100, 5, 0.002, rng)
    late = disturbances.command_ages({"command_latency": {"delay": 0.014}}, 100, 5, 0.002, rng)
    assert np.all(still == 0)
    np.testing.assert_array_equal(late[5:, :2], 2)  # 14 ms late: the one before last, in the first 4 ms of a tick
    np.testing.assert_array_equal(late[5:, 2:], 1)
    lost = disturbances.command_ages({"dropped_commands": {"share": 0.2}}, 20_000, 1, 0.01, rng)
    assert np.mean(lost > 0) == pytest.approx(0.2, abs=0.01)


def test_a_gust_has_the_standard_deviation_of_the_dryden_model():
    rng = np.random.default_rng(1)
    air = disturbances.gust({"wind_20ft": 10.0, "height": 3.05, "airspeed": 10.0}, 400_000, 0.002, rng)
    assert np.std(air[:, 2]) == pytest.approx(1.0, rel=0.1)
    profile = 0.177 + 0.000823 * 10.0
    assert np.std(air[:, 0]) == pytest.approx(1.0 / profile**0.4, rel=0.15)


@pytest.mark.parametrize("kind", paths.KINDS)
def test_a_path_s_velocity_and_acceleration_are_its_derivatives(kind):
    path = paths.draw_path(np.random.default_rng(4), kind, 12.0, 45.0, 14.0, 0.5)
    for value, slope in ((path.p, path.v), (path.v, path.a)):
        np.testing.assert_allclose(np.gradient(value, paths.TICK_S, axis=0)[2:-2], slope[2:-2], atol=0.12)
    np.testing.assert_allclose(np.gradient(path.yaw, paths.TICK_S)[2:-2], path.yaw_rate[2:-2], atol=0.01)
    assert np.linalg.norm(path.v, axis=1).max() <= 14.1


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_changes_the_recording(name):
    """Each effect is planted with ten times its detectable size."""
    tables = [instruments.record(truth, order.content, np.random.default_rng(0)) for order, truth in fleet()[name]]
    most = max(np.abs(tables[0][key].values - tables[1][key].values).max() for key in tables[0].channels)
    assert most > 0.005


def test_the_removed_share_is_one_for_the_true_vehicle_zero_for_the_nominal_and_a_half_between():
    (order, truth), (still, _) = fleet()["rotor_drag"]
    true, nominal = order.content, still.content
    half = {
        **true,
        "terms": {
            **true["terms"],
            "rotor_drag": {"k_d": 0.5 * (true["terms"]["rotor_drag"]["k_d"] + nominal["terms"]["rotor_drag"]["k_d"])},
        },
    }
    assert holdout.removed_share(truth, nominal, true, true) == pytest.approx(1.0)
    assert holdout.removed_share(truth, nominal, nominal, true) == pytest.approx(0.0)
    assert holdout.removed_share(truth, nominal, half, true) == pytest.approx(0.5, abs=0.1)
    assert holdout.removed_share(truth, true, true, true) is None
    assert holdout.rollout_errors(truth, [true])[0] < 1e-6
    beside_memory = replace(truth, memory=np.ones((len(truth.t), 3)))  # flown in a group with a law that has memory
    assert holdout.rollout_errors(beside_memory, [true])[0] < 1e-6


def test_what_a_flight_never_excites_does_not_act_in_it():
    order, truth = fleet()["rotor_drag"][0]
    still = fleet()["rotor_drag"][1][0].content
    assert holdout.significance(truth, still, order.content) > 30.0
    assert holdout.significance(truth, order.content, order.content) == 0.0
    never = order.content | {"strange": {"pad": 0.3, "center": [100.0, 0.0, 0.0]}}  # a place that it does not reach
    assert holdout.significance(truth, never, order.content) < 1e-3


def test_a_late_pose_is_an_earlier_pose_and_markers_have_their_offset():
    truth = fleet()["rotor_drag"][0][1]
    t = truth.t[1000:1400]
    p, q, v = instruments.marker_pose(truth, {}, t - 0.006)
    np.testing.assert_allclose(p, truth.p[997:1397], atol=1e-9)
    between, turned, _ = instruments.marker_pose(truth, {}, t - 0.001)
    np.testing.assert_allclose(between, 0.5 * (truth.p[999:1399] + truth.p[1000:1400]), atol=1e-4)
    np.testing.assert_allclose(np.abs(np.sum(turned * truth.q[1000:1400], axis=1)), 1.0, atol=1e-4)
    offset = {"marker_offset": {"position": [0.0, 0.0, 0.04]}}
    moved = instruments.marker_pose(truth, offset, t)[0] - truth.p[1000:1400]
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 0.04, atol=1e-9)


def test_an_accelerometer_with_a_lever_arm_measures_rotational_accelerations():
    truth = fleet()["rotor_drag"][0][1]
    arm = np.array([0.02, -0.01, 0.03])
    outputs = instruments.accelerometer(truth, {"imu_lever_arm": {"position": list(arm)}}) - truth.specific_force
    rate = np.gradient(truth.w, flight.LOOP_S, axis=0)
    expected = np.cross(rate, arm) + np.cross(truth.w, np.cross(truth.w, arm))
    np.testing.assert_allclose(outputs[200:-200], expected[200:-200], atol=0.05)
