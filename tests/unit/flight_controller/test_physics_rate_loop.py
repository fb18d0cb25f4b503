"""The rate loop: each rule of the firmware, and the vehicle's response to rate commands with the shipped gains."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_flight import at, fly, parameters, profile, steady, thrust_of, vehicle

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.configuration.dump_profile import PTERM_SCALE
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop.loop import DEGREES, LoopInput, initial_loop_state, rate_loop_step
from swift_sim_bridge.flight_controller.rate_loop.mixer import mix
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.simulation import simulator
from swift_sim_bridge.simulation.simulator import FlightModel

DT = 0.002
pass_of_loop, mixed = jax.jit(rate_loop_step), jax.jit(mix)


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def hovering():
    return at(rotor_speed=np.full(4, 1380.0))


def answer(axis, rate, throttle, **changes):
    """Return (times in s, share of the commanded rate) after a step on one axis from steady flight."""
    settled, _ = fly(hovering(), *steady(np.zeros(3), throttle, 25), FlightModel(parameters(), profile(**changes)))
    setpoint = np.eye(3)[axis] * rate
    _, trace = fly(settled, *steady(setpoint, throttle, 75), FlightModel(parameters(), profile(**changes)))
    share = trace.omega_body[..., axis].ravel() / rate
    return DT * np.arange(1, len(share) + 1), share


@pytest.mark.parametrize(("axis", "rate"), [(0, 5.0), (0, -5.0), (1, 5.0)])
@pytest.mark.parametrize("throttle", [0.3, 0.6])
def test_a_step_in_roll_and_pitch_is_followed_quickly_and_without_ringing(axis, rate, throttle):
    times, share = answer(axis, rate, throttle)
    assert times[np.argmax(share > 0.632)] < 0.032
    assert 1.0 / (DT * np.sum(1.0 - share)) > 35.0  # 1/s, the bandwidth of the lag with the same area
    assert share.max() < 1.07
    assert np.abs(share[times > 0.08] - 1.0).max() < 0.05


def test_a_vehicle_with_a_cli_dump_responds_as_quickly(tmp_path):
    """Its sticks are smoothed and arrive at 100 Hz; feed-forward compensates the delay."""
    gains = {"p": 54, "i": 41, "d": 50}
    pid = {f"{letter}_{axis}": gain for letter, gain in gains.items() for axis in ("roll", "pitch")}
    settings = {**pid, "d_min_roll": 0, "d_min_pitch": 0, "dyn_notch_count": 0}
    (tmp_path / "dump.txt").write_text("".join(f"set {name} = {value}\n" for name, value in settings.items()))
    keys = {"type": "betaflight", "dump": "dump.txt", "loop_hz": 2000}
    built = profile_from_vehicle(replace(vehicle(), folder=str(tmp_path), controller=keys))
    flight = simulator.initial_flight(jnp.array([0.0, 0, 50]), jnp.array([0.0, 0, 0, 1]), profile=built)
    flight = replace(flight, state=hovering())
    model = simulator.FlightModel(parameters(), built)
    fly_on = jax.jit(
        lambda flight, rate: simulator.advance(flight, ReceiverFrame(rate, jnp.asarray(0.35), True), model)
    )
    share = []
    for tick in range(40):
        flight, trace = fly_on(flight, jnp.array([0.0 if tick < 15 else 5.0, 0, 0]))
        share += list(np.asarray(trace.omega_body[:, 0]) / 5.0)
    answered = np.array(share[75:])
    assert DT * np.argmax(answered > 0.632) < 0.032 and answered.max() < 1.12 and abs(answered[-1] - 1.0) < 0.02


def test_yaw_follows_as_fast_as_its_torque_allows():
    times, share = answer(2, 2.0, 0.4)
    assert times[np.argmax(share > 0.632)] < 0.2
    assert share.max() < 1.05 and abs(share[-1] - 1.0) < 0.05


def test_aggressive_flight_loses_little_thrust_by_saturation():
    time = 0.01 * np.arange(200)
    swings = np.stack([5 * np.sin(9 * time), 6 * np.sin(6 * time + 1), 1.0 * np.sin(3 * time)], axis=-1)
    _, calm = fly(hovering(), *steady(np.zeros(3), 1.0, 200), FlightModel(parameters(), profile()))
    _, wild = fly(hovering(), swings, np.ones(200), FlightModel(parameters(), profile()))
    lost = 1.0 - thrust_of(wild.rotor_speed[20:]).mean() / thrust_of(calm.rotor_speed[20:]).mean()
    assert lost < 0.08, lost
    followed = np.abs(wild.omega_body[20:, -1] - swings[20:]).mean(axis=0)
    assert np.all(followed < [1.3, 1.3, 0.5]), followed


def test_the_i_term_removes_the_error_of_a_weak_rotor():
    weak = vehicle().thrust_coefficient * np.array([0.85, 1.0, 1.0, 1.0])
    unequal = parameters(rotors={"thrust_coefficient": weak})
    left = []
    for ki in (jnp.zeros(3), profile().ki):
        _, trace = fly(hovering(), *steady(np.zeros(3), 0.4, 200), FlightModel(unequal, profile(ki=ki)))
        left.append(np.abs(trace.omega_body[-1, -1, :2]).max())
    assert left[0] > 0.05 and left[1] < 0.1 * left[0]


def test_a_closed_throttle_resets_the_i_term():
    loop = initial_loop_state(jnp.zeros(3))
    for _ in range(100):
        loop, _ = pass_of_loop(loop, LoopInput(jnp.full(3, 0.3), 0.5, jnp.zeros(3)), profile(), DT)
    assert np.all(np.abs(loop.iterm) > 0.1)
    loop, _ = pass_of_loop(loop, LoopInput(jnp.full(3, 0.3), 0.0, jnp.zeros(3)), profile(), DT)
    assert np.all(loop.iterm == 0.0)


def test_the_i_term_stops_at_its_limit_and_while_the_motors_are_saturated():
    wanted = jnp.array([20.0, 0.0, 0.0])
    held = replace(initial_loop_state(jnp.zeros(3)), setpoint=wanted)
    loop = held
    for _ in range(150):
        loop, _ = pass_of_loop(loop, LoopInput(wanted / DEGREES, 0.5, jnp.zeros(3)), profile(), 10 * DT)
    assert float(loop.iterm[0]) == pytest.approx(400.0)
    full = replace(held, mix_range=jnp.asarray(1.0))
    full, _ = pass_of_loop(full, LoopInput(wanted / DEGREES, 0.5, jnp.zeros(3)), profile(), DT)
    assert np.all(full.iterm == 0.0)


def test_d_acts_on_the_measurement_alone_with_opposite_sign():
    only_d = profile(kp=jnp.zeros(3), ki=jnp.zeros(3))
    loop, level = pass_of_loop(
        initial_loop_state(jnp.zeros(3)), LoopInput(jnp.array([9.0, 0, 0]), 0.5, jnp.zeros(3)), only_d, DT
    )
    assert np.ptp(level) == 0.0
    _, turning = pass_of_loop(loop, LoopInput(jnp.zeros(3), 0.5, jnp.array([0.5, 0.0, 0.0])), only_d, DT)
    assert turning[0] > turning[2] and turning[1] > turning[3]  # rolling right: the right side pushes


def test_the_demand_of_one_degree_per_second_of_error_is_that_of_the_firmware():
    unity = profile(kp=jnp.full(3, 45 * PTERM_SCALE), ki=jnp.zeros(3), kd=jnp.zeros(3), motor_idle=jnp.asarray(0.0))
    loop = initial_loop_state(jnp.zeros(3))
    _, command = pass_of_loop(loop, LoopInput(jnp.array([10.0, 0.0, 0.0]) / DEGREES, 0.5, jnp.zeros(3)), unity, DT)
    assert np.allclose(command, 0.5 + 0.001 * 45 * 0.032029 * 10 * np.array([-1, -1, 1, 1]), atol=1e-12)


@pytest.mark.parametrize("throttle", [0.0, 0.05, 0.5, 0.97, 1.0])
def test_at_saturation_the_motor_differences_are_kept_and_the_throttle_is_shifted(throttle):
    demand = jnp.array([150.0, -100.0, 50.0])
    output, spread = mixed(demand, jnp.asarray(throttle), profile())
    middle, _ = mixed(demand, jnp.asarray(0.5), profile())
    assert 0.0 < spread < 1.0
    assert np.allclose(output - output.mean(), middle - middle.mean(), atol=1e-12)
    assert output.min() >= 0.055 - 1e-12 and output.max() <= 1.0 + 1e-12


def test_differences_beyond_the_motors_range_are_scaled_together():
    output, spread = mixed(jnp.array([450.0, 400.0, 0.0]), jnp.asarray(0.9), profile(motor_idle=jnp.asarray(0.0)))
    assert float(spread) == pytest.approx(1.7)
    assert np.allclose(output, 0.5 + np.array([-450 + 400, -450 - 400, 450 + 400, 450 - 400]) / 1700.0)


@pytest.mark.parametrize(("reversed_", "sign"), [(False, 1), (True, -1)])
def test_yaw_speeds_up_the_rotors_with_opposite_spin(reversed_, sign):
    turned = replace(vehicle(), controller={**vehicle().controller, "yaw_motors_reversed": reversed_})
    output, _ = mixed(jnp.array([0.0, 0.0, 100.0]), jnp.asarray(0.5), profile_from_vehicle(turned))
    spins = np.array([rotor.spin for rotor in vehicle().rotors])
    assert np.all((output - 0.5 > 0.0275) == (sign * spins < 0))  # turning left: clockwise rotors push


def test_disarmed_motors_stop():
    flight, trace = fly(hovering(), *steady((3.0, 0, 0), 0.8, 50), FlightModel(parameters(), profile()), armed=False)
    assert np.all(trace.motor_command == 0.0) and flight.state.rotor_speed.max() < 1e-3


@pytest.mark.parametrize(
    ("change", "named"),
    [({"p_gain": 3}, "p_gain"), ({"type": "rate_pid"}, "rate_pid"), ({"motor_idle": 120}, "motor_idle")],
)
def test_a_profile_outside_the_range_of_the_firmware_is_an_error(change, named):
    with pytest.raises(UsageError, match=named):
        profile_from_vehicle(replace(vehicle(), controller={**vehicle().controller, **change}))
