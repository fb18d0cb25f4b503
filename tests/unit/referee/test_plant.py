"""The referee's simulator: effects agree with their formulas, and the motion with that of the production simulator."""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros.configuration import build
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge import referee
from swift_sim_bridge.physics import battery, motors
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import quantities, registry
from swift_sim_bridge.physics.terms.motion import Motion
from swift_sim_bridge.physics.terms.vectors import Vector
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
    polynomial,
    vectors,
    vehicles,
)

FOLDER = Path(referee.__file__).parent
MAY_IMPORT_LATE = {"runner.py", "rotorpy_flight.py"}  # the tool, and RotorPy
FORBIDDEN = ("effects", "gap", "physics", "sensors", "simulation", "identification", "flight_controller")
ALL = {  # every effect of force and moment at once
    "rotor_drag": {"k_d": 6e-5},
    "linear_drag": {"c": [0.2, 0.3, 0.1]},
    "body_drag": {"c": [0.02, 0.03, 0.04]},
    "drag_center": {"position": [0.004, -0.006, 0.01]},
    "lift_cross": {"a": 0.01, "b": -0.02},
    "flapping_moment": {"k_f": 1e-6},
    "axial_inflow": {"k_z": 6e-5},
    "translational_lift": {"k_h": 5e-3, "saturation": 9.0},
    "propeller_stall": {"slope": 1.5, "onset": 0.02},
    "ground_effect": {"k": 2.0},
    "vortex_ring": {"loss": 0.3},
    "thrust_axis_tilt": {"tilt": [0.02, -0.01]},
    "com_offset": {"position": [0.003, -0.002, 0.005]},
    "payload": {"mass": 0.05, "position": [0.03, -0.02, 0.04]},
    "damaged_propeller": {"rotor": 2, "loss": 0.1},
    "wind": {"velocity": [3.0, -2.0, 0.5]},
    "local_draught": {"center": [0.5, 0.3, 1.0], "radius": 4.0, "velocity": [2.0, -3.0, 1.0]},
}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def content(**more) -> dict:
    """Return a vehicle of the referee without terms, with other entries."""
    return vehicles.draw_vehicle(np.random.default_rng(3), "test") | {"terms": {}} | more


def state(p=(0.0, 0.0, 5.0), v=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0), spin=1200.0, q=(0.0, 0.0, 0.0, 1.0)):
    q = np.asarray(q) / np.linalg.norm(q)
    spin = np.broadcast_to(spin, 4)
    lists = [tuple(jnp.asarray(float(x)) for x in row) for row in (p, q, v, w, spin)]
    return plant.State(*lists, jnp.asarray(300.0), jnp.asarray(0.1))


def held(u=0.3):
    nothing = (0.0, 0.0, 0.0)
    return plant.Inputs((u,) * 4, nothing, nothing, nothing, (0.0,) * 4)


def slopes(described: dict, at=None, u=0.3):
    slope, outputs = plant.derivative(at or state(), held(u), plant.plant_of(described))
    return slope, outputs


def more_force(described: dict, entry: dict, at) -> np.ndarray:
    """Return the force (N, body) that terms add at a state."""
    mass = described["mass"]
    return mass * np.subtract(
        slopes(described | {"terms": entry}, at)[1].specific_force, slopes(described, at)[1].specific_force
    )


def test_only_the_runner_imports_the_tool_and_no_module_the_production_simulator():
    sources = {path.name: path.read_text() for path in FOLDER.rglob("*.py")}
    paths = [path.relative_to(FOLDER).with_suffix("") for path in FOLDER.rglob("*.py") if path.stem != "__init__"]
    modules = [".".join(("swift_sim_bridge.referee", *path.parts)) for path in paths]
    program = f"import sys; from importlib import import_module; [*map(import_module, {modules})]; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert set(modules) <= set(loaded)
    assert not [name for name in loaded if re.match(rf"swift_sim_bridge\.({'|'.join(FORBIDDEN)})(\.|$)", name)]
    late = re.compile(r"^ +(from \S+ import|import) |import_module|__import__", re.MULTILINE)
    assert {name for name, text in sources.items() if late.search(text)} == MAY_IMPORT_LATE


@pytest.mark.parametrize("given", [{}, *({name: entry} for name, entry in ALL.items()), ALL])
def test_accelerations_agree_with_the_production_simulator_for_every_effect(given):
    if "drag_center" in given:
        given = given | {"body_drag": ALL["body_drag"]}
    described = content(terms=given)
    parameters = parameters_from_vehicle(build(Vehicle, described, "test"), np.float64)
    spin = np.array([1100.0, 1300.0, 1250.0, 900.0])
    at = state((0.2, -0.1, 0.3), (2.0, -3.0, -5.0), (1.0, -2.0, 0.5), spin, (0.1, -0.2, 0.3, 0.9))
    p, q, v, w, *_ = at
    air = registry.air_velocity(Vector(*p), {}, parameters)
    v_body = np.array(vectors.rotate_back(q, vectors.subtract(v, air)))
    motion = Motion(np.array(p), np.array(q), v_body, np.array(w), spin, np.zeros(4))
    force, moment = registry.wrench(motion, parameters)
    inertia = np.asarray(parameters.inertia)
    turning = np.linalg.solve(inertia, np.asarray(moment) - np.cross(w, inertia @ np.array(w)))
    slope, outputs = slopes(described, at)
    np.testing.assert_allclose(outputs.specific_force, np.asarray(force) / float(parameters.mass), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(outputs.angular_acceleration, turning, rtol=1e-8, atol=1e-8)
    gravity = vectors.subtract(vectors.rotate(q, outputs.specific_force), slope.v)
    np.testing.assert_allclose(gravity, [0.0, 0.0, GRAVITY], atol=1e-9)


def test_motors_and_battery_agree_with_the_production_simulator():
    described = content()
    parameters = parameters_from_vehicle(build(Vehicle, described, "test"), np.float64)
    at = state(spin=[1100.0, 1300.0, 1250.0, 900.0])
    power = battery.power(np.array(at.rotor_speed), parameters.rotors.torque_coefficient, parameters.battery)
    voltage, current = battery.voltage_and_current(power, at.charge, at.rc, parameters.battery)
    slope, outputs = slopes(described, at, u=0.4)
    assert outputs.voltage == pytest.approx(float(voltage), rel=1e-12)
    assert slope.charge == pytest.approx(float(current), rel=1e-12)
    target = motors.steady_speed(jnp.full(4, 0.4), voltage, parameters.motors)
    np.testing.assert_allclose(
        slope.rotor_speed, (target - np.array(at.rotor_speed)) / described["motor"]["time_constant_up"]
    )


def test_a_rotor_has_one_time_constant_for_speeding_up_and_one_for_slowing_down():
    motor = content()["motor"] | {"time_constant_up": 0.02, "time_constant_down": 0.05}
    described = content(motor=motor)
    low, high = (slopes(described, state(spin=spin), u=0.3)[0].rotor_speed[0] for spin in (300.0, 2000.0))
    voltages = [slopes(described, state(spin=spin), u=0.3)[1].voltage for spin in (300.0, 2000.0)]
    target = [plant.steady_speed(0.3, voltage, plant.plant_of(described)) for voltage in voltages]
    assert low == pytest.approx((target[0] - 300.0) / 0.02)
    assert high == pytest.approx((target[1] - 2000.0) / 0.05)


def test_one_motor_s_gain_scales_that_motor_s_steady_speed():
    plain, weak = (
        slopes(content(terms=given), u=0.5)[0].rotor_speed[2]
        for given in ({}, {"rotor_gain": {"gain": [0.0, 0.0, -0.1, 0.0]}})
    )
    described = content()
    lag, voltage = described["motor"]["time_constant_up"], slopes(described)[1].voltage
    steady = plant.steady_speed(0.5, voltage, plant.plant_of(described))
    assert float(plain - weak) == pytest.approx(float(0.1 * steady / lag), rel=1e-9)


def test_rotor_drag_is_proportional_to_rotor_speed_and_hub_velocity():
    force = more_force(content(), {"rotor_drag": {"k_d": 5e-5}}, state(v=(4.0, 0.0, 2.0), spin=1000.0))
    np.testing.assert_allclose(force, [-4 * 5e-5 * 1000.0 * 4.0, 0.0, 0.0], atol=1e-9)


def test_axial_inflow_reduces_thrust_in_a_climb_and_damps_a_roll():
    entry, at = {"axial_inflow": {"k_z": 6e-5}}, state(v=(0.0, 0.0, 3.0), spin=1000.0)
    np.testing.assert_allclose(more_force(content(), entry, at), [0.0, 0.0, -4 * 6e-5 * 1000.0 * 3.0], atol=1e-9)
    rolling = slopes(content(terms=entry), state(w=(2.0, 0.0, 0.0)))[1].angular_acceleration[0]
    assert rolling < slopes(content(), state(w=(2.0, 0.0, 0.0)))[1].angular_acceleration[0] - 0.1


def test_translational_lift_grows_with_the_square_of_the_speed_and_saturates():
    def lift(speed, saturation=0.0):
        entry = {"translational_lift": {"k_h": 5e-3, "saturation": saturation}}
        return more_force(content(), entry, state(v=(0.0, speed, 0.0)))[2]

    assert lift(6.0) == pytest.approx(4 * 5e-3 * 36.0)
    assert lift(6.0, saturation=6.0) == pytest.approx(0.5 * lift(6.0))
    assert lift(600.0, saturation=6.0) == pytest.approx(4 * 5e-3 * 36.0, rel=1e-3)


def test_the_ground_effect_follows_cheeseman_and_bennett():
    h, described = 0.1, content()
    gain = 1.0 / (1.0 - 1.5 * (described["rotor_radius"] / (4 * h)) ** 2) - 1.0
    force = more_force(described, {"ground_effect": {"k": 1.5}}, state(p=(0.0, 0.0, h), spin=1000.0))
    assert force[2] == pytest.approx(4 * described["thrust_coefficient"] * 1e6 * gain)


def test_a_vortex_ring_has_its_largest_loss_at_its_middle_and_none_with_lateral_airspeed():
    described = content()
    thrust = 4 * described["thrust_coefficient"] * 1e6
    disc = np.pi * described["rotor_radius"] ** 2
    induced = np.sqrt(described["thrust_coefficient"] / (2 * 1.225 * disc)) * 1001.0

    def lost(sink, across=0.0):
        at = state(v=(across * induced, 0.0, -sink * induced), spin=1000.0)
        return -more_force(described, {"vortex_ring": {"loss": 0.3}}, at)[2] / thrust

    assert lost(0.9) == pytest.approx(0.3, rel=1e-6)
    assert lost(0.2) == lost(1.6) == lost(0.9, across=1.2) == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < lost(0.6) < 0.3


def test_gyroscopic_moment_and_spin_up_torque_follow_from_angular_momentum():
    inertia, described = 1e-5, content()
    spin, w = np.array([1000.0, 1300.0, 1200.0, 900.0]), (2.0, -1.0, 0.0)
    at = state(w=w, spin=spin)
    given = content(terms={"rotor_gyroscopic": {"inertia": inertia}})
    ways = np.array([rotor["spin"] for rotor in described["rotors"]])
    h, h_rate = inertia * ways @ spin, inertia * ways @ np.array(slopes(described, at)[0].rotor_speed)
    expected = -np.cross(w, [0.0, 0.0, h]) - [0.0, 0.0, h_rate]
    found = np.subtract(slopes(given, at)[1].angular_acceleration, slopes(described, at)[1].angular_acceleration)
    np.testing.assert_allclose(found, expected / described["inertia"], rtol=1e-9)


def test_an_offset_of_the_centre_of_mass_gives_a_moment_of_the_thrust():
    described, offset = content(), (0.002, -0.003, 0.0)
    turning = slopes(content(terms={"com_offset": {"position": offset}}), state(spin=1000.0))[1].angular_acceleration
    thrust = 4 * described["thrust_coefficient"] * 1e6
    np.testing.assert_allclose(turning[:2], np.array([-offset[1], offset[0]]) * thrust / described["inertia"][:2])


def test_a_payload_on_one_arm_adds_mass_inertia_and_a_moment():
    given = plant.plant_of(content(terms={"payload": {"mass": 0.1, "position": [0.05, 0.0, 0.0]}}))
    plain = plant.plant_of(content())
    reduced = 0.1 * plain["mass"] / (0.1 + plain["mass"])
    assert given["mass"] == pytest.approx(plain["mass"] + 0.1)
    assert given["inertia"][2, 2] == pytest.approx(plain["inertia"][2, 2] + reduced * 0.05**2)
    assert given["inertia"][0, 0] == pytest.approx(plain["inertia"][0, 0])
    assert (
        slopes(content(terms={"payload": {"mass": 0.1, "position": [0.05, 0.0, 0.0]}}))[1].angular_acceleration[1] > 0.1
    )


def free(at: plant.State, described: dict, seconds: float, dt: float, u: float = 0.3) -> plant.State:
    numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), plant.plant_of(described))
    return _free(at, numbers, round(seconds / dt), dt, u)


@jax.jit
def _free(at, numbers, steps, dt, u):
    return jax.lax.fori_loop(0, steps, lambda _, now: flight.rk4(now, held(u), numbers, dt), at)


def test_a_falling_vehicle_reaches_its_terminal_speed():
    c = 0.05
    described = content(terms={"body_drag": {"c": [c, c, c]}}, torque_coefficient=1e-9, thrust_coefficient=1e-14)
    fallen = free(state(spin=150.0), described, 12.0, 0.01, u=1e-9)
    assert fallen.v[2] == pytest.approx(-np.sqrt(described["mass"] * GRAVITY / c), rel=1e-3)


def test_the_integration_error_is_of_fourth_order():
    described = content(terms={"body_drag": {"c": [0.02, 0.03, 0.04]}, "rotor_drag": {"k_d": 5e-5}})
    start = state(v=(5.0, -3.0, 1.0), w=(3.0, -4.0, 2.0), spin=900.0)
    exact, *ends = (
        np.concatenate([np.ravel(x) for x in free(start, described, 0.16, dt)[:4]]) for dt in (0.0005, 0.02, 0.01)
    )
    first, second = (np.abs(end - exact).max() for end in ends)
    assert 12.0 < first / second < 22.0


def test_without_moments_the_angular_momentum_is_constant():
    described = content(thrust_coefficient=1e-14, torque_coefficient=1e-16)
    start = state(w=(8.0, 1.0, 3.0), spin=150.0)
    end = free(start, described, 2.0, 0.001, u=1e-9)
    momentum = [
        np.array(vectors.rotate(at.q, vectors.scale(1.0, tuple(np.array(described["inertia"]) * np.array(at.w)))))
        for at in (start, end)
    ]
    np.testing.assert_allclose(momentum[1], momentum[0], rtol=1e-6)


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


STANDING_S = 4.0


def standing() -> paths.Path:
    """Return a path that stays at one place."""
    count = round(STANDING_S / paths.TICK_S)
    zeros = np.zeros((count, 3))
    return paths.Path(zeros + [0.0, 0.0, 3.0], zeros, zeros, np.zeros(count), np.zeros(count), zeros)


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


def test_an_equation_with_every_quantity_agrees_with_the_production_simulator():
    names = [*quantities.MOTION, "near(1,-1,2,6.0)", "thrust_2", "Omega_3"]
    names.remove("spin_Omega'")  # no rotor accelerates here
    row = {"coefficient": 0.01, "range": [-1e3, 1e3]}
    entry = {side: dict.fromkeys(names[i::6], row) for i, side in enumerate(polynomial.WRENCH)}
    entry["force_x"] |= {"v_x v_z": row, "v_y^2": row, "thrust v_xy^2": {"coefficient": 0.01, "range": [-5.0, 5.0]}}
    described = content(terms={"equation": entry})
    parameters = parameters_from_vehicle(build(Vehicle, described, "test"), np.float64)
    at = state((0.2, -0.1, 0.3), (2.0, -3.0, -5.0), (1.0, -2.0, 0.5), [1100, 1300, 1250, 900], (0.1, -0.2, 0.3, 0.9))
    v_body = np.array(vectors.rotate_back(at.q, at.v))
    motion = Motion(*map(np.array, (at.p, at.q)), v_body, np.array(at.w), np.array(at.rotor_speed), np.zeros(4))
    own = plant.plant_of(described, polynomial.summands_of([described]))
    for mine, other in zip(
        plant.wrench(at, tuple(v_body), (0.0,) * 4, (0.0,) * 4, own), registry.wrench(motion, parameters), strict=True
    ):
        assert np.array(mine) == pytest.approx(np.asarray(other), rel=1e-6)


@pytest.mark.parametrize(
    ("law", "size", "v", "force", "moment_z"),
    [
        ("vortex_bump", 0.2, (0.0, 0.0, -0.8), (0.0, 0.0, -0.2), 0.0),
        ("pad", 0.2, (0.0, 0.0, 0.0), (0.0, 0.0, 0.2), 0.0),
        ("lift", 0.01, (4.0, 0.0, 5.0), (0.0, 0.2, 0.0), 0.0),
        ("stall", 30.0, (15.0, 0.0, 0.0), None, 0.0),
        ("cross_drag", 0.1, (3.0, 2.0, 0.0), (-0.2, -0.3, 0.0), 0.0),
        ("weathercock", 1e-4, (3.0, 4.0, 0.0), (0.0, 0.0, 0.0), 2e-3),
    ],
)
def test_physics_without_a_name_follows_its_law(law, size, v, force, moment_z):
    """Forces in N; those of the first two laws as shares of the thrust, with v_z in multiples of the induced speed."""
    described = content()
    thrust = 4 * described["thrust_coefficient"] * 1200.0**2
    if law in ("vortex_bump", "pad"):
        area = 4 * np.pi * described["rotor_radius"] ** 2
        v = np.multiply(v, np.sqrt(thrust / (2 * plant.AIR_DENSITY * area)))
        force = np.multiply(force, thrust)
    at, strange = state((0.0, 0.0, 5.0), v), {law: size, "center": [0.0, 0.0, 5.0]}
    (_, before), (_, after) = slopes(described, at), slopes(described | {"strange": strange}, at)
    found = described["mass"] * np.subtract(after.specific_force, before.specific_force)
    if law == "stall":
        mu = 15.0 / (1200.0 * described["rotor_radius"])
        force = (0.0, 0.0, -thrust * 30.0 * max(mu - 0.04, 0.0) ** 2)
        assert mu > 0.05
    assert found == pytest.approx(force, abs=1e-4 * thrust)
    turned = np.subtract(after.angular_acceleration, before.angular_acceleration)
    assert turned[2] * described["inertia"][2] == pytest.approx(moment_z, abs=1e-6)
