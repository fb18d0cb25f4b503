"""The limit's models of the vehicle against the simulator."""

import dataclasses

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration
from swift_ros.vehicle import Vehicle, motor_command_for_speed
from swift_sim_bridge.limit.models import AS_FLOWN, FULL_THRUST, OMEGA, POSE, P, Q, V, make_model
from swift_sim_bridge.limit.symbolic import symbolic
from swift_sim_bridge.physics import integrators
from swift_sim_bridge.physics.state import BATTERY, State, parameters_from_vehicle

STATE = np.array([1.0, -2.0, 3.0, 9.0, -4.0, 2.0, 0.1, -0.3, 0.2, 0.927, 3.0, -2.0, 1.0])


@pytest.fixture(scope="module")
def vehicle(repository) -> Vehicle:
    return configuration.load(Vehicle, repository / "config/drone.yaml")


@pytest.fixture(scope="module")
def as_flown(vehicle):
    return make_model(vehicle, AS_FLOWN)


def test_functions_of_jax_become_expressions_of_casadi():
    """Branches, clips, powers and calls of compiled functions have the same values in both."""

    @jax.jit
    def inner(a, b):
        return jnp.where(a > b, jnp.sqrt(a), jnp.exp(-b))

    def function(a, b):
        return inner(a, b), jnp.clip(a * b, -1.0, 1.0) + a**3, jnp.maximum(a, 0.5) / (1.0 + jnp.abs(b))

    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    compiled = ca.Function("f", [a, b], symbolic(function, [a, b]))
    for one, other in ((0.7, 0.2), (0.1, 0.4), (2.0, -3.0)):
        found = [float(value) for value in compiled(one, other)]
        assert found == pytest.approx([float(value) for value in function(one, other)], rel=1e-5)


def test_operations_without_a_counterpart_are_named():
    with pytest.raises(NotImplementedError, match="'erf_inv'"):
        symbolic(jax.scipy.special.erfinv, [ca.SX.sym("a")])


def test_full_thrust_lifts_by_the_thrust_of_the_vehicle_file(vehicle):
    model = make_model(vehicle, FULL_THRUST)
    hover = np.r_[np.zeros(9), 1.0, np.zeros(3)]
    force = values(model.observed, hover, model.control_high)[:3]
    assert force == pytest.approx([0.0, 0.0, vehicle.max_thrust / vehicle.mass], abs=1e-9)


def test_as_flown_moves_as_the_simulator_does(vehicle, as_flown):
    """With airspeed, rotation and a used pack, the model's rates are the simulator's change over a short step."""
    speeds, targets, dt = np.array([2000.0, 2500.0, 1500.0, 2200.0]), np.array([2600.0, 2100.0, 2600.0, 900.0]), 1e-4
    q = STATE[Q] / np.linalg.norm(STATE[Q])
    state = np.r_[STATE[P], STATE[V], q, STATE[OMEGA], speeds, 500.0, 0.1, 0.08]
    voltage = values(as_flown.observed, state, targets)[-1]
    with jax.enable_x64(True):
        before = State(
            p_world=jnp.array(state[P]),
            q_world_body=jnp.array(q),
            v_world=jnp.array(state[V]),
            omega_body=jnp.array(state[OMEGA]),
            rotor_speed=jnp.array(speeds),
            charge=jnp.array(500.0),
            rc_voltage=jnp.array(0.1),
            memory={BATTERY: {"rc2_voltage": jnp.array(0.08)}},
        )
        commands = motor_command_for_speed(jnp.array(targets), voltage, vehicle.motor.map.coefficients)
        parameters = parameters_from_vehicle(quiet(vehicle), jnp.float64)
        after, flown_voltage, _ = integrators.step(before, commands, parameters, dt, integrators.rk4)
    assert voltage == pytest.approx(float(flown_voltage), abs=1e-9)
    moved = np.r_[after.p_world, after.v_world, after.q_world_body, after.omega_body, after.rotor_speed]
    expected = (moved - state[: POSE + 4]) / dt
    rates = values(as_flown.rates, state, targets)
    assert rates[: POSE + 4] == pytest.approx(expected, rel=5e-3, abs=0.05)
    assert rates[POSE + 4] == pytest.approx((float(after.charge) - 500.0) / dt, rel=1e-6)
    assert rates[POSE + 5] == pytest.approx((float(after.rc_voltage) - 0.1) / dt, rel=1e-3)
    rc2 = float(after.memory[BATTERY]["rc2_voltage"])
    assert rates[POSE + 6] == pytest.approx((rc2 - 0.08) / dt, rel=1e-3)


def test_a_weak_pack_leaves_less_speed(as_flown):
    """3,000 of 5,580 A s take 0.81 V of the open-circuit voltage, and more under a load of constant power."""
    targets, volts, room = np.full(4, 2600.0), [], []
    for charge in (0.0, 3000.0):
        state = np.r_[np.zeros(9), 1.0, np.zeros(3), np.full(4, 2700.0), charge, 0.2, 0.1]
        volts.append(values(as_flown.observed, state, targets)[-1])
        room.append(values(as_flown.room, state, targets)[0])
    assert 0.81 < volts[0] - volts[1] < 0.9
    assert room[0] - room[1] == pytest.approx(154.1 * (volts[0] - volts[1]) / 2800.0, rel=1e-3)  # c4 of the motor map


def values(function, *arguments) -> np.ndarray:
    """Return the value of a CasADi function as a flat array."""
    return function(*arguments).full().ravel()


def quiet(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without the buffet of the vortex ring, which is random."""
    return dataclasses.replace(
        vehicle, terms={name: own for name, own in vehicle.terms.items() if name != "vortex_ring"}
    )
