"""The referee's plant: effects agree with their formulas, and the motion keeps what it must."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plant_states import content, held, more_force, slopes, state

from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.referee.simulator import (
    flight,
    plant,
    vectors,
)

pytestmark = pytest.mark.usefixtures("double_precision")


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
