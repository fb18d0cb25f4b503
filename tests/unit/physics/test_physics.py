"""Physics: conserved quantities are conserved, and planted values are recovered from the flight."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_flight import at, coast, fly, in_vacuum, parameters, profile, steady, thrust_of, vehicle

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.physics import battery, integrators, motors
from swift_sim_bridge.physics.state import parameters_from_vehicle, unstacked
from swift_sim_bridge.simulation import simulator
from swift_sim_bridge.simulation.simulator import FlightModel

OFF = np.zeros(4)
TUMBLING = {"q_world_body": (0.5, -0.5, 0.1, 0.7), "v_world": (9.0, -4.0, 3.0), "omega_body": (7.0, -5.0, 3.0)}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def tumbling():
    quaternion = geometry.normalize(np.array(TUMBLING["q_world_body"]))
    return at(**{**TUMBLING, "q_world_body": quaternion}, rotor_speed=(900.0, 1500.0, 600.0, 2000.0))


@pytest.mark.parametrize(("integrator", "order"), [("semi_implicit_euler", 1), ("exponential", 2), ("rk4", 4)])
def test_an_integrator_has_its_order(integrator, order):
    stiff = {"open_circuit_slope": 0.0, "resistance": 0.0, "rc_resistance": 0.0}
    flown, command = parameters(battery=stiff), jnp.array([0.3, 0.9, 0.6, 0.2])

    def end(dt, by):
        state, _, _ = coast(tumbling(), command, flown, dt, round(0.16 / dt), by)
        return np.concatenate([state.p_world, state.q_world_body, state.v_world, 0.1 * state.omega_body])

    truth = end(0.00025, "rk4")
    errors = [np.linalg.norm(end(dt, integrator) - truth) for dt in (0.008, 0.004, 0.002)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.allclose(orders, order, atol=0.3), (errors, orders)


@pytest.mark.parametrize(("integrator", "momentum", "energy"), [("exponential", 1e-12, 1e-4), ("rk4", 1e-7, 1e-7)])
def test_a_free_tumble_conserves_energy_and_angular_momentum(integrator, momentum, energy):
    body = in_vacuum()

    def invariants(state):
        turned = geometry.rotate(state.q_world_body, body.inertia @ state.omega_body)
        turning = 0.5 * state.omega_body @ body.inertia @ state.omega_body
        flying = 0.5 * body.mass * state.v_world @ state.v_world + body.mass * GRAVITY * state.p_world[2]
        return turned, turning + flying

    start = replace(tumbling(), rotor_speed=OFF)
    end, _, _ = coast(start, OFF, body, 0.002, 1000, integrator)
    assert np.linalg.norm(end.omega_body - start.omega_body) > 1.0  # it does tumble
    assert np.allclose(invariants(end)[0], invariants(start)[0], rtol=momentum)
    assert np.allclose(invariants(end)[1], invariants(start)[1], rtol=energy)
    assert abs(float(np.linalg.norm(end.q_world_body)) - 1.0) < 1e-12


@pytest.mark.parametrize("integrator", integrators.INTEGRATORS.values())
def test_an_accelerometer_in_a_roll_measures_the_thrust_along_its_z_axis(integrator):
    """In a roll at 12 rad/s the attitude of 1 ms later would rotate it by 0.012 rad."""
    rolling = at(omega_body=(12.0, 0.0, 0.0), rotor_speed=np.full(4, 1400.0))
    move = jax.jit(partial(simulator.move, world=None, dt=0.002, integrator=integrator))
    _, trace = move(unstacked(rolling), jnp.full(4, 0.5), in_vacuum())
    force = np.asarray(trace.specific_force_body)
    assert force[2] > GRAVITY and np.linalg.norm(force[:2]) < 5e-4 * force[2]


def test_a_stone_falls_half_g_t_squared():
    end, _, _ = coast(at(), OFF, in_vacuum(), 0.002, 500)
    assert np.allclose(end.p_world, [0.0, 0.0, 50.0 - 0.5 * GRAVITY], atol=1e-9)
    assert np.allclose(end.v_world, [0.0, 0.0, -GRAVITY], atol=1e-9)


def test_a_vehicle_hovers_at_the_command_whose_thrust_equals_its_weight():
    flown = parameters()
    speed = np.sqrt(vehicle().mass * GRAVITY / (4 * vehicle().thrust_coefficient))
    load = battery.power(jnp.full(4, speed), flown.rotors.torque_coefficient, flown.battery)
    voltage, _ = battery.voltage_and_current(load, 0.0, 0.0, flown.battery)
    commands = np.linspace(0.01, 1.0, 2000)
    speeds = motors.steady_speed(commands, voltage, flown.motors)
    command = np.interp(speed, speeds, commands)
    end, _, _ = coast(at(rotor_speed=np.full(4, speed)), jnp.full(4, command), flown, 0.002, 500)
    assert np.allclose(end.p_world, [0.0, 0.0, 50.0], atol=0.01)
    assert np.allclose(end.v_world, 0.0, atol=0.02)


def test_full_throttle_from_a_full_pack_is_35_newtons_at_the_reference_voltage():
    end, voltage, current = coast(at(), jnp.ones(4), parameters(), 0.002, 150)
    assert thrust_of(end.rotor_speed) == pytest.approx(35.0, rel=0.005)
    assert float(voltage) == pytest.approx(vehicle().battery.reference_voltage, abs=0.05)
    assert 60.0 < float(current) < 90.0


@pytest.mark.parametrize(("start", "command", "planted"), [(300.0, 0.8, 0.025), (2400.0, 0.1, 0.045)])
def test_the_planted_lag_of_a_motor_is_recovered_from_its_step_response(start, command, planted):
    lagging = in_vacuum(motors={"time_constant_up": 0.025, "time_constant_down": 0.045})
    speeds = [start]
    for steps in (20, 2000):
        end, _, _ = coast(at(rotor_speed=np.full(4, start)), jnp.full(4, command), lagging, 0.002, steps)
        speeds.append(float(end.rotor_speed[0]))
    begin, later, final = speeds
    assert 0.04 / np.log((begin - final) / (later - final)) == pytest.approx(planted, rel=1e-6)


def test_the_planted_rotor_drag_is_recovered_at_two_rotor_speeds():
    sliding = in_vacuum(rotor_drag={"k_d": 6e-5}, motors={"min_speed": 0.0, "map_coefficients": (0, 0, 0, 2000, 0)})
    for command in (0.4, 0.9):
        speed = np.full(4, 2000.0 * command)
        end, _, _ = coast(at(v_world=(10.0, 5.0, 0.0), rotor_speed=speed), jnp.full(4, command), sliding, 0.002, 100)
        found = -np.log(np.asarray(end.v_world[:2]) / [10.0, 5.0]) / 0.2 * vehicle().mass / speed.sum()
        assert np.allclose(found, 6e-5, rtol=1e-6)


def test_rotor_drag_at_the_hubs_damps_yaw():
    spinning = in_vacuum(rotor_drag={"k_d": 6e-5}, motors={"min_speed": 0.0, "map_coefficients": (0, 0, 0, 2000, 0)})
    command, speed = jnp.full(4, 0.5), np.full(4, 1000.0)
    end, _, _ = coast(at(omega_body=(0.0, 0.0, 5.0), rotor_speed=speed), command, spinning, 0.002, 100)
    arm_squared = 0.0775**2 + 0.1**2
    rate = 6e-5 * 4000.0 * arm_squared / float(spinning.inertia[2, 2])
    assert float(end.omega_body[2]) == pytest.approx(5.0 * np.exp(-0.2 * rate), rel=1e-6)


def test_a_falling_body_reaches_its_terminal_velocity():
    end, _, _ = coast(at(), OFF, in_vacuum(body_drag={"c": (0.0, 0.0, 0.02)}), 0.002, 10000)
    assert float(end.v_world[2]) == pytest.approx(-np.sqrt(vehicle().mass * GRAVITY / 0.02), rel=1e-4)


def test_accelerating_the_rotors_turns_the_body_the_other_way():
    no_air = {"thrust_coefficient": np.zeros(4), "torque_coefficient": np.zeros(4)}
    free = in_vacuum(rotor_gyroscopic={"inertia": 2e-5}, rotors=no_air)
    command = jnp.where(free.rotors.spin > 0, 0.8, 0.2)
    end, _, _ = coast(at(), command, free, 0.0005, 400)
    of_rotors = 2e-5 * float(jnp.sum(free.rotors.spin * end.rotor_speed))
    assert of_rotors > 0.02
    assert float(free.inertia[2, 2] * end.omega_body[2]) == pytest.approx(-of_rotors, rel=1e-6)


def test_a_race_costs_the_pack_less_than_eight_percent_of_its_thrust():
    throttle = 0.86 + 0.14 * np.sign(np.sin(np.arange(1750) / 20.0))  # full and 0.72 by turns
    flight, trace = fly(at(), np.zeros((1750, 3)), throttle, FlightModel(parameters(), profile()))
    mean_thrust = np.mean(thrust_of(trace.rotor_speed))
    assert 29.0 < mean_thrust < 33.0
    start, _ = fly(at(), *steady(np.zeros(3), 1.0, 50), FlightModel(parameters(), profile()))
    end, _ = fly(flight, *steady(np.zeros(3), 1.0, 50), FlightModel(parameters(), profile()))
    left = thrust_of(end.state.rotor_speed) / thrust_of(start.state.rotor_speed)
    assert 0.92 < left < 0.99, left


def test_mean_racing_thrust_draws_the_papers_power():
    flown = parameters()
    speed = jnp.full(4, np.sqrt(29.16 / 4 / vehicle().thrust_coefficient))
    load = battery.power(speed, flown.rotors.torque_coefficient, flown.battery)
    assert float(load) == pytest.approx(866.0, rel=0.04)


def test_an_overload_leaves_the_voltage_finite():
    voltage, current = battery.voltage_and_current(jnp.asarray(1e6), 0.0, 0.0, parameters().battery)
    assert np.isfinite(voltage) and np.isfinite(current) and voltage > 0


def test_each_member_of_a_batch_flies_as_it_does_alone_with_its_parameters():
    mass, k_d = np.array([0.8, 0.87, 0.95]), np.array([2e-5, 4e-5, 8e-5])
    setpoints, throttles = steady((2.0, -1.0, 0.5), 0.6, 50)
    batch = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (3, *leaf.shape)), tumbling())
    shared = parameters(mass=mass, rotor_drag={"k_d": k_d})
    together, _ = fly(batch, setpoints[:, None], throttles[:, None], FlightModel(shared, profile()))
    for i in range(3):
        alone = parameters(mass=mass[i], rotor_drag={"k_d": k_d[i]})
        single, _ = fly(tumbling(), setpoints, throttles, FlightModel(alone, profile()))
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a[i], b, rtol=1e-9, atol=1e-9), together, single)  # noqa: B023


def test_single_precision_stays_close_to_double():
    commands = steady((3.0, -2.0, 1.0), 0.5, 100)
    double, _ = fly(tumbling(), *commands, FlightModel(parameters(), profile()))
    with jax.enable_x64(False):
        start = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=jnp.float32), tumbling())
        single, _ = fly(start, *commands, FlightModel(parameters(jnp.float32), profile(jnp.float32)))
    assert single.state.p_world.dtype == np.float32
    assert np.allclose(single.state.p_world, double.state.p_world, atol=2e-3)
    assert np.allclose(single.state.q_world_body, double.state.q_world_body, atol=1e-3)


@pytest.mark.parametrize(
    ("terms", "named"), [({"warp_drive": {}}, "warp_drive"), ({"rotor_drag": {"k_d": 1.0, "k_x": 2.0}}, "k_x")]
)
def test_an_unknown_term_or_coefficient_is_an_error_that_names_it(terms, named):
    with pytest.raises(UsageError, match=named):
        parameters_from_vehicle(replace(vehicle(), terms=terms))
