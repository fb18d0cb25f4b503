"""Terms of the physics: a planted coefficient is recovered from the flight, and each force equals its equation."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_flight import profile, vehicle
from planted_terms import ORDINARY, PLANTED, RANDOM, fly_without_terms, recovered, vehicle_with_idle_terms

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.physics import battery, integrators, motors
from swift_sim_bridge.physics.state import parameters_from_vehicle, start_memory, state_at_rest
from swift_sim_bridge.physics.terms import command_path, gust, inflow, motion, noise, propeller, registry
from swift_sim_bridge.physics.terms.vectors import Vector
from swift_sim_bridge.simulation import simulator

DT = 0.002
NUMPY = np.random.default_rng(7)


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("name", [*PLANTED, *ORDINARY])
def test_a_planted_coefficient_is_recovered_from_the_flight(name):
    assert recovered()[name] == pytest.approx(dict.fromkeys(recovered()[name], 1.0), rel=0.01)


def test_every_term_is_tested():
    assert set(PLANTED) | RANDOM == set(registry.PHYSICS)
    assert {"gust", "command_latency", "dropped_commands"} == RANDOM  # tested below


def test_an_idle_term_does_not_change_the_flight():
    idle, absent = fly_without_terms()
    assert np.allclose(idle, absent, rtol=0, atol=1e-10)


def wrench_with(planted: dict, moving: motion.Motion):
    """Return (force, moment) of one term at some instants: the wrench with it less the wrench without any."""
    both = [registry.wrench(moving, parameters_from_vehicle(replace(vehicle(), terms=own))) for own in (planted, {})]
    return tuple(np.asarray(a) - np.asarray(b) for a, b in zip(*both, strict=True))


def instants(count: int = 5) -> motion.Motion:
    quaternion = NUMPY.normal(size=(count, 4))
    return motion.Motion(
        NUMPY.uniform([-3, -3, 0.3], [3, 3, 0.6], (count, 3)),
        quaternion / np.linalg.norm(quaternion, axis=1)[:, None],
        NUMPY.normal(0, 6, (count, 3)),
        NUMPY.normal(0, 4, (count, 3)),
        NUMPY.uniform(500, 2500, (count, 4)),
        NUMPY.normal(0, 1e4, (count, 4)),
    )


POSITION = np.array([rotor.position for rotor in vehicle().rotors])
SPIN = np.array([rotor.spin for rotor in vehicle().rotors])


def at_hubs(force):
    """Return the wrench of forces (n, 4, 3) at the hubs."""
    return force.sum(axis=1), np.cross(POSITION, force).sum(axis=1)


def upward(force):
    return at_hubs(np.stack([0 * force, 0 * force, force], axis=-1))


@pytest.mark.parametrize(
    "name",
    [
        "flapping_moment",
        "axial_inflow",
        "translational_lift",
        "propeller_stall",
        "thrust_axis_tilt",
        "lift_cross",
        "rotor_gyroscopic",
        "ground_effect",
    ],
)
def test_a_term_equals_its_equation(name):
    m = instants()
    v, w, speed = m.v_body, m.omega_body, m.rotor_speed
    hub = v[:, None] + np.cross(w[:, None], POSITION)
    thrust = vehicle().thrust_coefficient * speed**2
    lateral, zero = np.hypot(v[:, 0], v[:, 1]), np.zeros(len(v))
    x, y, z, s = m.q_world_body.T
    up = np.stack([2 * (x * z - y * s), 2 * (y * z + x * s), 1 - 2 * (x * x + y * y)], axis=-1)
    height = np.maximum(m.p_world[:, 2, None] + up @ POSITION.T, 0.5 * vehicle().rotor_radius)
    none, spinning = np.zeros_like(v), 1e-5 * SPIN * speed
    h = np.stack([zero, zero, spinning.sum(axis=1)], axis=-1)
    h_rate = np.stack([zero, zero, (1e-5 * SPIN * m.rotor_acceleration).sum(axis=1)], axis=-1)
    across = np.stack([hub[..., 1], -hub[..., 0], 0 * hub[..., 2]], axis=-1)
    expected = {
        "flapping_moment": ({"k_f": 1e-6}, (none, 1e-6 * (speed[..., None] * across).sum(axis=1))),
        "axial_inflow": ({"k_z": 5e-5}, upward(-5e-5 * speed * hub[..., 2])),
        "translational_lift": ({"k_h": 4e-3}, upward(4e-3 * (hub[..., 0] ** 2 + hub[..., 1] ** 2))),
        "propeller_stall": (
            {"slope": 1.5, "onset": 0.05},
            upward(
                -1.5
                * np.maximum(np.hypot(hub[..., 0], hub[..., 1]) / (speed * vehicle().rotor_radius) - 0.05, 0)
                * thrust
            ),
        ),
        "thrust_axis_tilt": ({"tilt": [0.02, -0.01]}, at_hubs(thrust[..., None] * np.array([-0.01, -0.02, 0.0]))),
        "lift_cross": (
            {"a": 0.01, "b": 0.02},
            (np.stack([0.01 * v[:, 0] * v[:, 2], 0.01 * v[:, 1] * v[:, 2], 0.02 * lateral * v[:, 2]], axis=-1), none),
        ),
        "rotor_gyroscopic": ({"inertia": 1e-5}, (none, -h_rate - np.cross(w, h))),
        "ground_effect": ({"k": 1.0}, upward(thrust / (1 - (vehicle().rotor_radius / (4 * height)) ** 2) - thrust)),
    }
    entry, equation = expected[name]
    for found, planted in zip(wrench_with({name: entry}, m), equation, strict=True):
        assert np.allclose(found, planted, rtol=1e-5, atol=1e-9)


def test_a_vortex_ring_reduces_thrust_only_in_a_straight_descent():
    hover = np.full((5, 4), 1286.0)
    sinking = np.array([[0, 0, 0.0], [0, 0, -1.0], [0, 0, -6.94], [0, 0, -16.0], [10.0, 0, -6.94]])
    level, still = np.tile([0, 0, 0, 1.0], (5, 1)), np.zeros((5, 3))
    moving = motion.Motion(still, level, sinking, still, hover, 0 * hover)
    force, _ = wrench_with({"vortex_ring": {"loss": 0.3}}, moving)
    lost = -force[:, 2] / (4 * vehicle().thrust_coefficient * 1286.0**2)
    assert np.allclose(lost, [0.0, 0.0, 0.3, 0.0, 0.0], atol=0.01)


def test_gusts_have_the_variance_and_the_correlation_of_the_standard():
    planted, steps, count = gust.Gust(*(jnp.asarray(v) for v in (8.0, 0.0, 10.0, 12.0))), 1500, 256
    streams = noise.start(jax.random.key(1), (count,))
    keys = iter(jax.random.split(jax.random.key(2), 9))
    first = gust.start(planted, jnp.zeros(count), lambda: jax.random.normal(next(keys), (count,)), 4)

    @jax.jit
    def blow(memory, streams):
        def one(carry, _):
            memory, streams = carry
            step_done = motion.CompletedStep(None, None, 0.02, None, tuple(noise.white(streams, 5, 3, jnp.float64)))
            memory = gust.advance(memory, step_done, planted, None)
            return (memory, noise.advance(streams)), jnp.stack(gust.gust(None, planted, memory))

        return jax.lax.scan(one, (memory, streams), None, length=steps)[1]

    blown = np.asarray(blow(first, streams))  # (steps, 3, count)
    feet = 10.0 / 0.3048
    profile = 0.177 + 0.000823 * feet
    sigma = np.array([0.8 / profile**0.4, 0.8 / profile**0.4, 0.8])
    assert np.allclose(blown.std(axis=(0, 2)), sigma, rtol=0.04)
    assert np.allclose(blown[:50].std(axis=(0, 2)), sigma, rtol=0.15)  # from the first step on
    length = np.array([10.0 / profile**1.2, 10.0 / profile**1.2, 10.0])
    for axis, correlation in enumerate([np.exp(-1.0), 0.5 * np.exp(-1.0), 0.5 * np.exp(-1.0)]):
        lag = round(length[axis] / 12.0 / 0.02)
        found = np.mean(blown[lag:, axis] * blown[:-lag, axis]) / blown[:, axis].var()
        assert found == pytest.approx(correlation, abs=0.05)


def test_random_streams_are_white_and_independent():
    streams = noise.start(jax.random.key(3), (4096,))
    rows = []
    for _ in range(8):
        rows += [np.stack(noise.white(streams, salt, 3, jnp.float64)) for salt in (11, 12)]
        streams = noise.advance(streams)
    rows = np.concatenate(rows)
    assert np.allclose(rows.mean(axis=1), 0.0, atol=0.08) and np.allclose(rows.std(axis=1), 1.0, atol=0.04)
    assert np.abs(np.corrcoef(rows) - np.eye(len(rows))).max() < 0.08


def test_the_buffet_of_a_vortex_ring_has_variance_one_and_its_bandwidth():
    planted, streams = inflow.VortexRing(*map(jnp.asarray, (0.3, 0.1, 8.0))), noise.start(jax.random.key(1), (4096,))
    memory, rows = inflow.start_buffet(planted, jnp.zeros(4096), None, 4), []
    for _ in range(60):
        step_done = motion.CompletedStep(None, None, 0.01, None, tuple(noise.white(streams, 3, 4, jnp.float64)))
        memory, streams = inflow.advance_buffet(memory, step_done, planted, None), noise.advance(streams)
        rows.append(np.stack(memory["buffet"]))
    settled = np.stack(rows)[20:]
    assert settled.std() == pytest.approx(1.0, abs=0.02)
    assert np.mean(settled[1:] * settled[:-1]) == pytest.approx(np.exp(-2 * np.pi * 8.0 * 0.01), abs=0.02)


def test_a_damaged_propeller_shakes_once_per_revolution():
    planted = propeller.DamagedPropeller(*map(jnp.asarray, (2, 0.0, 3e-6)))
    parameters = parameters_from_vehicle(vehicle())
    one = motion.Motion(
        *(np.zeros(3), np.array([0, 0, 0, 1.0]), np.zeros(3), np.zeros(3)), np.full(4, 1500.0), np.zeros(4)
    )
    instant = motion.instant_of(jax.tree.map(jnp.asarray, one), parameters)
    memory, force, dt = propeller.start(planted, jnp.zeros(()), None, 4), [], 2.5e-4
    step = jax.jit(
        lambda old: propeller.advance(old, motion.CompletedStep(instant, None, dt, None), planted, parameters)
    )
    for _ in range(1000):
        memory = step(memory)
        force.append(float(memory["force_x"]))
    spectrum = np.abs(np.fft.rfft(force))
    assert np.fft.rfftfreq(1000, dt)[spectrum.argmax()] == pytest.approx(1500.0 / (2 * np.pi), abs=4.0)
    assert np.max(force) == pytest.approx(3e-6 * 1500.0**2, rel=0.01)


def test_a_slung_load_swings_at_its_natural_frequency_and_adds_its_weight():
    described = {"slung_load": {"mass": 0.05, "length": 0.4}}
    lone = replace(vehicle(), terms=described)
    parameters = parameters_from_vehicle(lone)
    hover = np.sqrt((lone.mass + 0.05) * 9.80665 / (4 * lone.thrust_coefficient))
    start = state_at_rest(jnp.array([0.0, 0.0, 9.0]), jnp.array([0, 0, 0, 1.0]), 4, parameters)
    hanging = start.memory["slung_load"] | {"rate": Vector(jnp.asarray(0.2), jnp.zeros(()), jnp.zeros(()))}
    start = replace(start, rotor_speed=jnp.full(4, hover), memory={**start.memory, "slung_load": hanging})
    stiff = replace(parameters.motors, map_coefficients=jnp.array([hover, 0, 0, 0, 0.0]))
    parameters = replace(parameters, motors=stiff)

    @jax.jit
    def swing(state):
        def one(state, _):
            state, _, _ = integrators.step(state, jnp.ones(4), parameters, DT)
            return state, (state.v_world, state.memory["slung_load"]["direction"].x)

        return jax.lax.scan(one, state, None, length=4000)[1]

    velocity, direction = map(np.asarray, swing(start))
    crossings = np.flatnonzero(np.diff(np.sign(direction)) > 0)
    # the vehicle moves against the load: the pendulum's length is that to the common centre of mass
    reduced = 0.4 * lone.mass / (lone.mass + 0.05)
    assert np.diff(crossings).mean() * DT == pytest.approx(2 * np.pi * np.sqrt(reduced / 9.80665), rel=0.01)
    assert np.abs(velocity[:, 2]).max() < 0.02
    assert np.abs(direction[-800:]).max() == pytest.approx(np.abs(direction[:800]).max(), rel=0.01)  # no energy lost


def throttle_in_force(planted: dict, ticks: int = 400):
    """Return the throttle in force (ticks, sub-steps) when 0, 1, 2, ... are sent, one in each tick of 10 ms."""
    coefficients = {name: registry.PHYSICS[name].coefficients(**entry) for name, entry in planted.items()}
    queue = command_path.start(coefficients, jnp.zeros(()), jax.random.key(4))

    def tick(queue, k):
        queue = command_path.send(queue, jnp.zeros(3), k, coefficients, 0.01)
        throttles = [command_path.received(queue, i * DT).throttle for i in range(5)]
        return command_path.hold(queue, 4 * DT), jnp.stack(throttles)

    return np.asarray(jax.jit(lambda queue: jax.lax.scan(tick, queue, 1.0 * jnp.arange(ticks))[1])(queue))


def test_a_delayed_command_acts_after_its_delay():
    in_force = throttle_in_force({"command_latency": {"delay": 0.024}}).ravel()[100:]
    given = np.repeat(np.arange(400), 5)[100:]
    assert (in_force == np.roll(given, 12))[20:].all()


def test_jitter_varies_the_delay_and_an_older_command_never_replaces_a_newer_one():
    in_force = throttle_in_force({"command_latency": {"delay": 0.03, "jitter": 0.004}}).ravel()
    delay = np.array([np.argmax(in_force >= k) for k in range(20, 380)]) * DT - 0.01 * np.arange(20, 380)
    assert delay.mean() == pytest.approx(0.031, abs=0.001)  # on average half a sub-step after it is due
    assert delay.std() == pytest.approx(0.004, abs=0.0006)
    assert (np.diff(in_force) >= 0).all()


def test_a_lost_command_leaves_the_last_one_in_force_and_the_planted_share_is_lost():
    in_force = throttle_in_force({"dropped_commands": {"share": 0.2}}, 3000)[:, 0]
    assert np.mean(np.diff(in_force) == 0) == pytest.approx(0.2, abs=0.025)


def test_a_rotor_s_lag_is_exact_at_any_step():
    parameters = parameters_from_vehicle(vehicle())
    once = motors.lag((jnp.asarray(300.0),), (2000.0,), 0.3, parameters.motors)[0]
    again = (jnp.asarray(300.0),)
    for _ in range(150):
        again = motors.lag(again, (2000.0,), DT, parameters.motors)
    assert float(once) == pytest.approx(float(again[0]), rel=1e-12)
    assert 300.0 < float(once) < 2000.0


def test_a_pack_with_optional_keys_follows_its_curve_energy_and_temperature():
    pack = parameters_from_vehicle(vehicle_with_idle_terms()).battery
    shares = np.array([0.0, 0.125, 0.25, 0.6, 1.0])
    drawn = [battery.open_circuit(0.0, pack, {"energy": 500.0 * share}) for share in shares]
    assert np.allclose(drawn, np.interp(shares, np.linspace(0, 1, 5), pack.open_circuit_curve))
    assert float(battery.resistance(pack, {"celsius": 35.0})) == pytest.approx(0.012 * 0.9)
    memory, seconds = {"rc2_voltage": 0.0, "energy": 0.0, "celsius": 15.0}, np.arange(0.0, 1.0, DT)
    for _ in seconds:
        memory = battery.advance_memory(memory, 300.0, 20.0, DT, pack)
    assert memory["energy"] == pytest.approx(300.0)
    assert float(memory["rc2_voltage"]) == pytest.approx(20.0 * 0.004 * (1 - np.exp(-1 / 0.3)))
    assert float(memory["celsius"]) == pytest.approx(15.0 + 0.012 * 1.1 * 400 / 2.0, rel=0.06)


@pytest.mark.parametrize(
    ("planted", "named"),
    [
        ({"damaged_propeller": {"rotor": 5, "loss": 0.1}}, "from 1 to 4"),
        ({"rotor_gain": {"gain": [0.1, 0.2]}}, "4 entries"),
        ({"drag_center": {"position": [0, 0, 0.01]}}, "linear_drag or body_drag"),
        ({"slung_load": {"mass": 0.1, "length": 0.0}}, "positive 'length'"),
        ({"command_latency": {"delay": 5.0}}, "at most 0.07"),
        ({"warp_drive": {}}, "gust.*gyro_bias"),
    ],
)
def test_an_impossible_term_is_refused_in_one_sentence(planted, named):
    with pytest.raises(UsageError, match=named):
        parameters_from_vehicle(replace(vehicle(), terms=planted))


def test_a_state_without_the_memory_of_its_terms_is_refused():
    for own in ({"gust": {"wind_20ft": 5.0}}, {"command_latency": {"delay": 0.02}}):
        parameters = parameters_from_vehicle(replace(vehicle(), terms=own))
        flight = simulator.initial_flight(jnp.zeros(3), jnp.array([0, 0, 0, 1.0]))
        with pytest.raises(UsageError, match="with the parameters given"):
            frame = ReceiverFrame(jnp.zeros(3), jnp.asarray(0.5), True)
            simulator.advance(flight, frame, simulator.FlightModel(parameters, profile()))
    gusty = parameters_from_vehicle(replace(vehicle(), terms={"gust": {"wind_20ft": 5.0}}))
    first, second = (start_memory(gusty, jnp.zeros(3), jax.random.key(seed))["gust"]["u"] for seed in (1, 2))
    assert not np.allclose(first, second) and len(np.unique(first)) == 3


def test_vehicles_that_differ_in_terms_of_airframe_and_commands_share_one_compiled_program():
    loaded = replace(
        vehicle(),
        terms={
            "payload": {"mass": 0.1, "position": [0.03, 0.0, 0.0]},
            "com_offset": {"position": [1e-3, 0.0, 0.0]},
            "command_latency": {"delay": 0.01},
            "body_drag": {"c": [0.1, 0.1, 0.1]},
        },
    )
    plain, shaken = (
        replace(vehicle(), terms=own)
        for own in ({"body_drag": {"c": [0.0, 0.0, 0.0]}}, {"damaged_propeller": {"rotor": 2, "loss": 0.1}})
    )
    plain, loaded, shaken = (
        registry.with_flight_terms(parameters_from_vehicle(one)) for one in (plain, loaded, shaken)
    )
    assert jax.tree.structure(plain) == jax.tree.structure(loaded)
    assert loaded.mass == pytest.approx(vehicle().mass + 0.1)
    assert set(shaken.terms) == {"damaged_propeller"}  # it has changed the rotor, and still gives vibration
