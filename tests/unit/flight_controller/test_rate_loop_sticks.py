"""From receiver frames to setpoints: smoothing, feed-forward, airmode, serial task, rate of the loop."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dumped_loop import controller, profile, quiet, run
from free_flight import parameters, vehicle

from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop import stick_path
from swift_sim_bridge.flight_controller.rate_loop.loop import DEGREES, LoopInput, take_frame
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.flight_controller.rate_loop.substeps import (
    mean_motor_command,
    passes_per_step,
    steps_of_old_frame,
)
from swift_sim_bridge.simulation import simulator
from swift_sim_bridge.simulation.simulator import FlightModel

FF = 0.01 * 0.013754  # pid.h, FEEDFORWARD_SCALE: a gain of 100 on deg/s^2


def frames(built, setpoints_deg_s, **sticks):
    """Return the feed-forward in deg/s^2 after each frame of roll setpoints."""
    loop, found = simulator.initial_loop_state(jnp.zeros(3), built), []
    for setpoint in setpoints_deg_s:
        row = jnp.array([setpoint, 0.0, 0.0]) / DEGREES
        loop = take_frame(loop, ReceiverFrame(row, jnp.asarray(0.5), jnp.asarray(True), **sticks), built)
        found.append(float(loop.terms["feedforward"][0]))
    return np.array(found)


def forward(**settings):
    """Return a loop with feed-forward only; feed-forward needs smoothing."""
    plain = {"feedforward_smooth_factor": 0, "feedforward_boost": 0, "feedforward_jitter_factor": 0}
    return quiet(f_roll=100, rc_smoothing="ON", **{**plain, "feedforward_max_rate_limit": 0, **settings})


def test_the_feed_forward_of_a_steady_movement_is_its_speed():
    ramp = 3.0 * np.arange(1, 12)  # deg/s a frame at 100 Hz
    assert np.allclose(frames(forward(), ramp)[1:], 300.0, rtol=1e-4)
    slow = frames(forward(feedforward_smooth_factor=50), ramp)
    assert np.allclose(slow[1:5], 300.0 * (1 - 0.5 ** np.arange(2, 6)), rtol=0.01) and slow[-1] < 300.0
    motors, _ = run(forward(rc_smoothing_feedforward_cutoff=200), 2400, setpoint=_ramp(2400, 300.0))
    assert motors[-1, 2] - 0.5 == pytest.approx(FF * 100 * 300.0 / 1000.0, rel=0.02)


def _ramp(passes, deg_s2):
    held = np.floor(np.arange(passes) / 80) / 100 * deg_s2 / DEGREES
    return np.stack([held, 0 * held, 0 * held], axis=-1)


def test_one_repeated_frame_is_extrapolated_and_a_second_one_ends_the_movement():
    found = frames(forward(), [3.0, 6.0, 9.0, 9.0, 9.0, 9.0])
    assert np.allclose(found[1:], [300.0, 300.0, 300.0, 0.0, 0.0], rtol=1e-4)
    # rc.c: after a repeat the speed is that of two intervals.
    again = frames(forward(), [3.0, 6.0, 6.0, 12.0])
    assert again[3] == pytest.approx(300.0, rel=1e-4)


def test_a_repeated_frame_is_recognised_despite_rounding():
    built = forward()
    motors, memory = run(built, 400, setpoint=(124.0 / DEGREES, 0.0, 0.0))
    assert np.all(memory.terms["feedforward"][200:] == 0.0)


def test_a_movement_that_speeds_up_is_boosted():
    parabola = 0.5 * np.arange(8.0) ** 2
    plain, boosted = frames(forward(), parabola), frames(forward(feedforward_boost=20), parabola)
    # calculateFeedforward: 0.01 of the speed's change a second, times a tenth of the setting; the speed grows by 1
    # deg/s a frame each frame.
    assert (boosted - plain)[4:] == pytest.approx(1.0 * 100 * 100 * 0.01 * 2.0, rel=0.01)


def test_averaging_jitter_transition_and_the_limit_at_full_stick():
    ramp = 3.0 * np.arange(1, 7)
    double = frames(forward(feedforward_averaging="2_POINT"), [3.0, 9.0, 15.0, 15.0, 15.0])
    assert double == pytest.approx([300.0, 450.0, 600.0, 600.0, 300.0], rel=1e-4)
    sticks = stick_path.Sticks(jnp.array([0.15, 0.0, 0.0]), jnp.asarray(False))
    assert frames(forward(feedforward_transition=30), ramp[:1], sticks=sticks) == pytest.approx(
        0.5 * frames(forward(), ramp[:1], sticks=sticks)
    )
    # 3 deg/s are 2.24 us of a straight curve to 670: twice that below 7 us, and 1 - (1 - 2 * 2.24 / 14)^2 is left.
    calm = frames(forward(feedforward_jitter_factor=7), ramp)
    assert calm[3:] == pytest.approx(300.0 * (1 - (1 - 2 * 1500 / 670 / 14) ** 2), rel=1e-3)
    near = frames(forward(feedforward_max_rate_limit=10), [600.0, 640.0, 668.0])
    assert near[1:] == pytest.approx([10 * 30.0, 10 * 2.0], rel=1e-3)


def test_sticks_and_throttle_are_smoothed_by_the_rate_of_the_frames():
    assert list(profile().smoothing.cutoff_hz) == [37.0, 37.0, 37.0]  # 100 * 1.5 / 4
    slow = profile(rc_smoothing_auto_factor=250, rc_smoothing_throttle_cutoff=50)
    assert list(slow.smoothing.cutoff_hz) == [15.0, 50.0, 15.0]
    motors, _ = run(quiet(p_roll=100, rc_smoothing="ON"), 800, setpoint=(10.0 / DEGREES, 0, 0), throttle=0.5)
    gain = 2 * np.pi * 37 * 1.961459177 / 8000 / (1 + 2 * np.pi * 37 * 1.961459177 / 8000)
    share = [1 - sum((1 - gain) ** n * gain**k * _ways(n, k) for k in range(3)) for n in (41, 801)]
    spread = (motors[:, 2] - motors[:, 0]) / (2 * 100 * 0.032029 * 10 / 1000)
    assert spread[40] == pytest.approx(share[0], abs=0.01) and spread[-1] == pytest.approx(1.0, abs=1e-3)
    assert motors[10].mean() < 0.05 and motors[-1].mean() == pytest.approx(0.5, abs=1e-3)


def test_smoothing_and_feed_forward_follow_the_time_between_frames():
    built = forward(rc_smoothing_throttle_cutoff=50)
    cutoffs, ahead = _paced(built, [0.01] * 8 + [0.0125] * 60)
    assert np.all(cutoffs[7] == [37.0, 50.0, 37.0]) and np.all(cutoffs[-1] == [30.0, 50.0, 30.0])  # 80 * 1.5 / 4
    assert np.all(np.diff(cutoffs[:, 0]) <= 0.0) and ahead[[7, -1]] == pytest.approx([300.0, 240.0], rel=1e-3)
    broken, _ = _paced(built, [0.01] * 8 + [0.07, 0.025] + [0.01] * 8)
    assert np.all(broken[:, 0] == 37.0)  # rc.c: ignores pauses and intervals of about twice the last one


def test_after_a_repeated_frame_only_roll_uses_the_previous_interval():
    built = forward(f_pitch=100)
    loop = simulator.initial_loop_state(jnp.zeros(3), built)
    for setpoint, interval_s in ((3.0, 0.01), (3.0, 0.009), (6.0, 0.011)):
        row = jnp.array([setpoint, setpoint, 0.0]) / DEGREES
        frame = ReceiverFrame(row, jnp.asarray(0.5), jnp.asarray(True), interval_s=interval_s)
        loop = take_frame(loop, frame, built)
    # rc.c: all axes share one variable for the previous interval, and roll writes it first.
    assert loop.terms["feedforward"][:2] == pytest.approx([3.0 / 0.020, 3.0 / 0.022], rel=1e-4)


def _paced(built, intervals_s):
    """Return (cutoffs (n, 3) Hz, feed-forward (n,) deg/s^2) after frames at those intervals, 3 deg/s more in each."""
    loop, cutoffs, ahead = simulator.initial_loop_state(jnp.zeros(3), built), [], []
    for number, interval_s in enumerate(intervals_s):
        row = jnp.array([3.0 * number, 0.0, 0.0]) / DEGREES
        frame = ReceiverFrame(row, jnp.asarray(0.5), jnp.asarray(True), interval_s=interval_s)
        loop = take_frame(loop, frame, built)
        cutoffs.append(np.asarray(loop.terms["pace"]["cutoff_hz"]))
        ahead.append(float(loop.terms["feedforward"][0]))
    return np.array(cutoffs), np.array(ahead)


def _ways(n, k):
    """Return the impulse response of three equal low-passes in series (binomial coefficients)."""
    return np.prod([(n + j) / (j + 1) for j in range(k)]) if k else 1.0


def test_the_setpoint_changes_no_faster_than_its_limit():
    _, memory = run(quiet(p_roll=1, acc_limit=50), 80, setpoint=(100.0 / DEGREES, 0, 0))
    assert memory.terms["slewed"][:, 0] == pytest.approx(np.minimum(5000.0 / 8000 * np.arange(1, 81), 100.0), rel=1e-4)


def test_airmode_keeps_the_i_term_once_the_throttle_was_up():
    throttle = np.where(np.arange(1200) < 400, 0.1, np.where(np.arange(1200) < 800, 0.3, 0.0))
    for settings, kept in (({"features": ["AIRMODE"]}, True), ({"features": ["-AIRMODE"]}, False)):
        built = quiet(i_roll=80, airmode_start_throttle_percent=25, **settings)
        _, memory = run(built, 1200, setpoint=(1.0, 0, 0), throttle=throttle)
        assert memory.iterm[399, 0] > 0 and (memory.iterm[-1, 0] > memory.iterm[799, 0]) == kept
        assert kept or memory.iterm[-1, 0] == 0.0
    _, memory = run(quiet(i_roll=80, airmode_start_throttle_percent=25), 400, setpoint=(1.0, 0, 0), throttle=0.0)
    assert np.all(memory.iterm == 0.0)  # the throttle was not raised yet


def test_without_airmode_the_motor_differences_are_smaller_at_low_throttle():
    both = [
        run(quiet(p_roll=50, features=[name]), 2, setpoint=(0.5, 0, 0), throttle=0.2)[0][-1]
        for name in ("AIRMODE", "-AIRMODE")
    ]
    assert np.ptp(both[1]) == pytest.approx(0.7 * np.ptp(both[0]), rel=1e-3)


def test_a_frame_waits_for_the_serial_task():
    keys = {**vehicle().controller, "serial_phase_s": 0.004}
    built = profile_from_vehicle(replace(vehicle(), controller=keys))
    assert [steps_of_old_frame(each, 0.002, 5) for each in (built, profile_from_vehicle(vehicle()))] == [2, 0]
    flight = simulator.initial_flight(jnp.array([0.0, 0, 9]), jnp.array([0.0, 0, 0, 1]), profile=built)
    frame, model = ReceiverFrame(jnp.array([1.0, 0, 0]), jnp.asarray(0.5), True), FlightModel(parameters(), built)
    _, trace = jax.jit(lambda flight: simulator.advance(flight, frame, model))(flight)
    assert np.all(trace.motor_command[:2] == jnp.float32(0.055)) and np.all(trace.motor_command[2:].max(axis=1) > 0.5)


def test_the_loop_runs_its_passes_within_a_step_of_the_physics():
    built = quiet(d_roll=30, dterm_lpf1_static_hz=100)
    assert passes_per_step(built, 0.002) == 16 and controller().loop_hz == 8000.0
    loop = simulator.initial_loop_state(jnp.zeros(3), built)
    rates = [0.0, 0.1, 0.2, 0.3, 0.4]
    for rate in rates:  # a steady angular acceleration, seen at steps of 2 ms
        omega = jnp.array([rate, 0.0, 0.0])
        loop, motors = mean_motor_command(loop, LoopInput(jnp.zeros(3), jnp.asarray(0.5), omega), omega, built, 0.002)
    steady = 30 * 0.000529 * 0.1 / 0.002 * DEGREES / 1000.0
    assert motors[0] - 0.5 == pytest.approx(steady, rel=0.05)  # neither spikes of a staircase nor the lag of a step
