"""An equation in the vehicle file: its force is what the accelerometer shows, and it is not extrapolated."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_flight import vehicle

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_sim_bridge.physics import integrators
from swift_sim_bridge.physics.state import parameters_from_vehicle, state_at_rest
from swift_sim_bridge.physics.terms import equation, quantities
from swift_sim_bridge.physics.terms.motion import Motion, instant_of
from swift_sim_bridge.simulation import checks

DT, GRAVITY = 0.002, 9.80665
STEP = jax.jit(integrators.step)
ATTITUDE = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
V_BODY, RATES = np.array([6.0, -4.0, 2.0]), np.array([1.0, -2.0, 0.5])


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def with_equation(**sides):
    return replace(vehicle(), terms={**vehicle().terms, "equation": sides})


def summand(coefficient: float, low: float = -1e9, high: float = 1e9) -> dict:
    return {"coefficient": coefficient, "range": [low, high]}


def after_a_step(flown, command: float = 0.6):
    """Return (accelerometer, turn acceleration, rotor speeds, voltage) of one step of a moving vehicle."""
    parameters = parameters_from_vehicle(flown)
    at_rest = state_at_rest(np.array([1.0, 2.0, 3.0]), ATTITUDE, parameters=parameters)
    v_world = geometry.rotate(ATTITUDE, V_BODY)
    state = replace(at_rest, v_world=v_world, omega_body=jnp.asarray(RATES), rotor_speed=jnp.full(4, 1300.0))
    moved, voltage, _ = STEP(state, jnp.full(4, command), parameters, DT)
    acceleration = (np.asarray(moved.v_world) - v_world) / DT + np.array([0.0, 0.0, GRAVITY])
    turn = (np.asarray(moved.omega_body) - RATES) / DT
    return geometry.rotate_inverse(ATTITUDE, acceleration), turn, moved, voltage


def shown(**sides):
    """Return what an equation changes of a step: (force N, moment N m, rotor speeds rad/s, voltage V)."""
    with_it, without = after_a_step(with_equation(**sides)), after_a_step(with_equation())
    force = vehicle().mass * (with_it[0] - without[0])
    moment = vehicle().inertia_matrix @ (with_it[1] - without[1])
    speeds = np.asarray(with_it[2].rotor_speed - without[2].rotor_speed)
    return force, moment, speeds, float(with_it[3] - without[3])


def test_the_accelerometer_shows_exactly_the_planted_force():
    force, moment, speeds, volts = shown(
        force_x={"v_x v_z": summand(0.01)},
        force_z={"|v| v_y": summand(-0.02), "omega_x omega_y": summand(0.3), "1": summand(0.5)},
    )
    speed = np.linalg.norm(V_BODY)
    assert force == pytest.approx([0.01 * 12.0, 0.0, 0.02 * 4.0 * speed - 0.3 * 2.0 + 0.5], abs=1e-9)
    assert moment == pytest.approx(np.zeros(3), abs=1e-9)
    assert speeds == pytest.approx(np.zeros(4), abs=1e-9) and volts == 0.0


def test_the_gyro_shows_exactly_the_planted_moment():
    force, moment, *_ = shown(moment_y={"v_x": summand(0.002)}, moment_z={"v_x v_y": summand(-1e-4)})
    assert moment == pytest.approx([0.0, 0.012, 24e-4], abs=1e-9)
    assert force == pytest.approx(np.zeros(3), abs=1e-9)


def test_beyond_its_range_a_product_keeps_the_value_of_the_bound():
    force, *_ = shown(force_x={"v_x": summand(0.1, -2.0, 3.0)}, force_y={"v_y": summand(0.1, -2.0, 3.0)})
    assert force == pytest.approx([0.3, -0.2, 0.0], abs=1e-9)


def test_motors_and_pack_get_what_the_equation_adds():
    *_, speeds, _ = shown(rotor_speed={"u": summand(50.0), "1": summand(-10.0)})
    up = vehicle().motor.time_constant_up
    assert speeds == pytest.approx(np.full(4, 20.0 * (1.0 - np.exp(-DT / up))), rel=1e-6)
    *_, volts = shown(voltage={"1": summand(0.25)})
    assert volts == pytest.approx(0.25)


def test_one_motor_may_have_a_coefficient_of_its_own():
    *_, speeds, _ = shown(rotor_speed={"u": summand(50.0), "rotor_2 u": summand(-20.0), "rotor_9": summand(7.0)})
    *_, shared, _ = shown(rotor_speed={"u": summand(50.0)})
    assert speeds == pytest.approx(shared * [1.0, 0.6, 1.0, 1.0], rel=1e-6)


def test_a_quantity_counts_from_a_value_on():
    force, *_ = shown(force_x={"over(v_x,4.5) v_z": summand(0.1)}, force_y={"over(v_x,7)": summand(0.1)})
    assert force == pytest.approx([0.1 * (V_BODY[0] - 4.5) * V_BODY[2], 0.0, 0.0], abs=1e-9)
    *_, speeds, _ = shown(rotor_speed={"over(u,0.9)": summand(50.0)})
    assert speeds == pytest.approx(np.zeros(4), abs=1e-9)


def test_what_adds_to_the_thrust_of_each_rotor_turns_the_vehicle_where_rotors_differ():
    force, moment, *_ = shown(rotor_thrust={"1": summand(-0.1), "v_z": summand(0.2)})
    rotors = vehicle().rotors
    hub_v_z = np.array([V_BODY[2] + RATES[0] * r.position[1] - RATES[1] * r.position[0] for r in rotors])
    added = -0.1 + 0.2 * hub_v_z
    assert force == pytest.approx([0.0, 0.0, added.sum()], abs=1e-9)
    arms = np.array([r.position for r in rotors])
    assert moment == pytest.approx([arms[:, 1] @ added, -arms[:, 0] @ added, 0.0], abs=1e-9)
    assert np.ptp(added) > 0.1


def test_a_quantity_counts_around_a_value():
    force, *_ = shown(force_x={"around(v_x,5,2)": summand(0.1)}, force_y={"around(v_x,9,2)": summand(0.1)})
    assert force == pytest.approx([0.1 * (1.0 - 0.25) ** 2, 0.0, 0.0], abs=1e-9)


def test_a_force_at_one_place_ends_at_its_radius():
    inside, *_ = shown(force_z={"near(1,2,3.5,1.0)": summand(2.0)})
    outside, *_ = shown(force_z={"near(1,2,5,1.0)": summand(2.0)})
    assert inside[2] == pytest.approx(2.0 * (1.0 - 0.25) ** 2) and outside[2] == 0.0


def test_every_named_quantity_has_a_unit_and_a_finite_value_in_flight():
    parameters = parameters_from_vehicle(vehicle())
    instant = instant_of(
        Motion(*map(jnp.asarray, ([1.0, 2, 3], ATTITUDE, V_BODY, RATES, [1300.0] * 4, [100.0] * 4))), parameters
    )
    for name in quantities.MOTION:
        assert np.isfinite(float(quantities.product_of(name).value(instant))), name
    hubs = quantities.hubs(instant)
    for name in quantities.ROTOR:
        assert np.isfinite([float(quantities.product_of(name, "rotor").value(hub)) for hub in hubs]).all(), name
    assert quantities.product_of("thrust v_xy^2").unit == "N m^2/s^2"
    assert equation.unit_of("force_z", "thrust v_xy^2") == "s^2/m^2"
    assert equation.unit_of("moment_x", "v_y") == "N s"


@pytest.mark.parametrize(
    ("sides", "named"),
    [
        ({"force_x": {"v_q": summand(1.0)}}, "force_x: 'v_q' has no quantity 'v_q'; there are v_x"),
        ({"rotor_speed": {"v_x": summand(1.0)}}, "rotor_speed: 'v_x' has no quantity"),
        ({"rotor_thrust": {"omega_x": summand(1.0)}}, "rotor_thrust: 'omega_x' has no quantity"),
        ({"force_x": {"around(v_x,1,0)": summand(1.0)}}, "has no quantity 'around"),
        ({"force_x": {"over(over(v_x,1),1)": summand(1.0)}}, "has no quantity 'over"),
        ({"force_x": {"v_x": summand(1.0, 3.0, -3.0)}}, "must rise, not fall from 3"),
        ({"force_x": {"v_x": summand(1.0)}, "covariance": [[1.0, 0.0], [0.0, 1.0]]}, "1 rows and columns"),
        ({"force_x": {"v_x": summand(1.0)}, "covariance": [[-1.0]]}, "no variance negative"),
        ({"lift": {"v_x": summand(1.0)}}, "unknown key 'lift'"),
    ],
)
def test_a_wrong_equation_is_refused_in_one_sentence(sides, named):
    with pytest.raises(UsageError, match=named):
        parameters_from_vehicle(with_equation(**sides))


def test_check_accepts_an_equation_and_names_a_summand_of_several_weights():
    assert checks.vehicle_findings(with_equation(**equation.EXAMPLE)) == []
    (finding,) = checks.vehicle_findings(with_equation(force_z={"v_z": summand(5.0, -10.0, 10.0)}))
    assert "force_z: v_z" in finding.sentence and "N s/m" in finding.sentence
