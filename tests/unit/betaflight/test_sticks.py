"""Sticks: from rates to sticks and back; from thrust to throttle through the motor map and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import vehicle as vehicle_file
from swift_ros.betaflight import sticks
from swift_ros.betaflight.sticks import RateCurves
from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.vehicle import motor_command_for_speed

PROFILES = {
    "betaflight": RateCurves("betaflight", (120, 100, 210), (50, 70, 30), (0, 20, 40)),
    "raceflight": RateCurves("raceflight", (37, 50, 40), (80, 60, 0), (50, 0, 20)),
    "kiss": RateCurves("kiss", (100, 120, 90), (60, 70, 50), (0, 30, 10)),
    "actual": RateCurves("actual", (7, 20, 15), (67, 80, 50), (0, 54, 30)),
    "quick": RateCurves("quick", (90, 100, 80), (67, 110, 50), (10, 0, 40)),
}


def firmware_rate_deg_s(curves, axis, deflection):
    """Return the rate by the firmware's arithmetic (rc.c), implemented independently."""
    r, s, e = curves.rc_rate[axis], curves.super_rate[axis], curves.expo[axis] / 100
    x, a = deflection, abs(deflection)
    if curves.family == "betaflight":
        if e:
            x = x * a**3 * e + x * (1 - e)
        rate = r / 100
        if rate > 2:
            rate += 14.54 * (rate - 2)
        return 200 * rate * x / min(max(1 - a * s / 100, 0.01), 1)
    if curves.family == "raceflight":
        x = (1 + e * (x * x - 1)) * x
        return 10 * r * x * (1 + a * s * 0.01)
    if curves.family == "kiss":
        return 2000 / min(max(1 - a * s / 100, 0.01), 1) * (x**3 * e + x * (1 - e)) * r / 1000
    if curves.family == "actual":
        return x * r * 10 + max(0, s * 10 - r * 10) * a * (x**5 * e + x * (1 - e))
    top = max(s * 10, r * 2)
    return x * r * 2 / min(max(1 - (a**3 * e + a * (1 - e)) * (1 - r * 2 / top), 0.01), 1)


@pytest.mark.parametrize("family", sticks.FAMILIES)
def test_the_forward_curve_is_that_of_the_firmware(family):
    curves = PROFILES[family]
    for axis, sign in enumerate((1, 1, -1)):
        for stick in (1000, 1130, 1499, 1500, 1501, 1750, 2000):
            wanted = np.clip(firmware_rate_deg_s(curves, axis, (stick - 1500) / 500), -1998, 1998)
            rate = sticks.rates_from_sticks(np.full(3, float(stick)), curves)[axis]
            assert np.degrees(rate) * sign == pytest.approx(wanted, abs=1e-9)


def test_known_values_of_the_default_profiles():
    # Betaflight rates 1.2 / 0.5: 200 * 1.2 / (1 - 0.5) = 480 deg/s; Actual 70 / 670: 670 at full, 70/2 + 600/4 at half.
    assert np.degrees(sticks.max_rates(PROFILES["betaflight"])[0]) == pytest.approx(480)
    half = sticks.rates_from_sticks(np.array([1750.0, 1500.0, 1500.0]), PROFILES["actual"])
    assert np.degrees(half[0]) == pytest.approx(0.5 * 70 + 600 * 0.25)


@pytest.mark.parametrize("family", sticks.FAMILIES)
def test_every_stick_position_is_recovered(family):
    curves = PROFILES[family]
    positions = np.arange(1000, 2001, dtype=float)
    rates = sticks.rates_from_sticks(np.stack([positions] * 3, axis=-1), curves)
    back = sticks.sticks_from_rates(rates, curves)
    np.testing.assert_array_equal(back, np.stack([positions] * 3, axis=-1))


def test_the_closest_position_is_chosen_and_limited_to_the_ends():
    curves = PROFILES["actual"]
    wanted = np.random.default_rng(1).uniform(-9, 9, (200, 3)) * [1, 1, 0.8]
    chosen = sticks.sticks_from_rates(wanted, curves)
    table = curves.table * np.array(sticks.STICK_SIGNS)[:, None]
    best = np.abs(table[None] - wanted[:, :, None]).min(axis=-1)
    np.testing.assert_allclose(np.abs(sticks.rates_from_sticks(chosen * 1.0, curves) - wanted), best, atol=1e-12)
    np.testing.assert_array_equal(sticks.sticks_from_rates(np.array([99.0, -99.0, 99.0]), curves), [2000, 1000, 1000])


def test_zero_is_the_centre_of_the_deadband_and_other_rates_are_outside_it():
    curves = RateCurves("betaflight", (120,) * 3, (50,) * 3, (0,) * 3, deadband_us=(10, 10, 4))
    np.testing.assert_array_equal(sticks.sticks_from_rates(np.zeros(3), curves), [1500, 1500, 1500])
    small = sticks.rates_from_sticks(np.array([1511.0, 1489.0, 1505.0]), curves)
    np.testing.assert_array_equal(sticks.sticks_from_rates(small, curves), [1511, 1489, 1505])


def test_flu_signs_roll_right_nose_down_yaw_left():
    up = sticks.sticks_from_rates(np.array([2.0, 2.0, 2.0]), PROFILES["betaflight"])
    assert up[0] > 1500 and up[1] > 1500 and up[2] < 1500


def test_jax_and_numpy_agree():
    wanted = np.random.default_rng(2).uniform(-7, 7, (5, 4, 3)).astype(np.float32)
    for curves in PROFILES.values():
        in_jax = sticks.sticks_from_rates(jnp.asarray(wanted), curves)
        np.testing.assert_array_equal(np.asarray(in_jax), sticks.sticks_from_rates(wanted, curves))


def test_rates_that_do_not_cover_the_policy_are_reported():
    curves = RateCurves("betaflight", (120, 100, 100), (50, 30, 50), (0, 0, 0), limit_deg_s=(1998, 1998, 200))
    with pytest.raises(UsageError, match=r"pitch reaches 286 of 458 deg/s, yaw reaches 200 of 229 deg/s"):
        sticks.check_coverage(curves, (8.0, 8.0, 4.0))
    sticks.check_coverage(curves, (8.0, 4.9, 3.4))


def test_a_decreasing_curve_is_refused():
    with pytest.raises(UsageError, match="roll rate falls"):
        sticks.max_rates(RateCurves("actual", (20, 20, 20), (80, 80, 80), (250, 0, 0)))


@pytest.fixture(scope="module")
def racer():
    return load(vehicle_file.Vehicle, configuration_folder() / "drone.yaml")


def test_thrust_is_recovered_at_every_voltage(racer):
    c0, c1, c2, c3, c4 = racer.motor.map.coefficients
    thrust = np.linspace(3.0, 38.0, 19)[:, None]
    voltage = np.linspace(14.0, 16.8, 15)[None, :]
    throttle = sticks.throttle_for_thrust(thrust, voltage, racer, idle=0.055)
    command = 0.055 + 0.945 * throttle
    speed = c0 + c1 * voltage + c2 * np.sqrt(command) + c3 * command + c4 * voltage * np.sqrt(command)
    recovered = 4 * racer.thrust_coefficient * speed**2 / racer.mass
    reachable = throttle < 1
    assert reachable[:, -1].all()
    np.testing.assert_allclose(recovered[reachable], np.broadcast_to(thrust, recovered.shape)[reachable], rtol=1e-9)
    assert (recovered[~reachable] < np.broadcast_to(thrust, recovered.shape)[~reachable]).all()


def test_full_throttle_at_the_reference_voltage_gives_the_maximum_thrust(racer):
    thrust = np.array([0.0, racer.max_thrust / racer.mass])
    throttle = sticks.throttle_for_thrust(thrust, racer.battery.reference_voltage, racer, 0.055)
    np.testing.assert_allclose(throttle, [0.0, 1.0], atol=1e-3)


def test_the_slope_of_the_throttle_is_finite_where_the_thrust_is_cut(racer):
    def collective(thrust):
        return jnp.sum(sticks.throttle_for_thrust(thrust, jnp.float32(16.0), racer, 0.055))

    slope = jax.grad(collective)(jnp.array([-1.0, 0.0, 20.0], jnp.float32))
    assert slope[0] == 0.0 and slope[1] == 0.0 and 0.0 < slope[2] < 0.1


def test_a_linear_and_a_decreasing_motor_map_are_inverted_too():
    np.testing.assert_allclose(motor_command_for_speed(np.array([1000.0]), 16.0, (0, 0, 2000, 0, 0)), 0.25)
    np.testing.assert_allclose(motor_command_for_speed(np.array([50.0]), 16.0, (100, 0, 2000, 0, 0)), 0.0)
    commands = np.array([0.25, 0.81])
    speed = 100 + 10 * 16 + 3000 * np.sqrt(commands) - 500 * commands
    np.testing.assert_allclose(motor_command_for_speed(speed, 16.0, (100, 10, 3000, -500, 0)), commands)


def test_throttle_stick_spans_min_check_to_2000():
    positions = sticks.throttle_stick(np.array([-0.1, 0.0, 0.5, 1.0, 2.0]), 1050)
    np.testing.assert_array_equal(positions, [1050, 1050, 1525, 2000, 2000])
