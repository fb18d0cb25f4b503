"""The firmware's filters of gyro and D term: inject a vibration or a step and measure what remains."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dumped_loop import profile, quiet, run

from swift_sim_bridge.flight_controller.rate_loop import filters, rpm_filter
from swift_sim_bridge.flight_controller.rate_loop.loop import DEGREES
from swift_sim_bridge.flight_controller.rate_loop.profile import RateLoopProfile

LOOP_HZ = 8000.0


def response(one, hz):
    """Return the gain of a filter at a frequency, from its impulse response."""
    start, impulse = filters.initial_memory(one, jnp.zeros(1)), jnp.zeros((400, 1)).at[0].set(1.0)
    _, impulse_response = jax.lax.scan(lambda memory, sample: filters.apply(one, memory, sample, 1e-3), start, impulse)
    return abs(np.sum(np.asarray(impulse_response)[:, 0] * np.exp(-2j * np.pi * hz * 1e-3 * np.arange(400))))


@pytest.mark.parametrize("kind", filters.TYPES)
def test_a_low_pass_is_down_three_decibels_at_its_cutoff(kind):
    # The firmware's discrete PT1, and so each in a chain, has a slightly lower cutoff than the continuous model.
    one = filters.Lowpass(jnp.asarray(10.0), kind)
    assert response(one, 10.0) == pytest.approx(0.7071, rel=0.04) and response(one, 0.0) == pytest.approx(1.0, abs=0.01)


def test_a_fixed_gyro_pt3_has_the_gain_of_a_pt1_and_d_one_that_meets_its_cutoff():
    # gyro_init.c, gyroInitLowpassFilterLpf: pt3FilterInit with pt1FilterGain.
    built = profile(gyro_lpf1_type="PT3", gyro_lpf1_dyn_min_hz=0, dterm_lpf2_type="PT3")
    assert not built.gyro_filters[-1].corrected and built.dterm_filters[-1].corrected


def test_a_notch_removes_its_centre_and_passes_distant_frequencies():
    notch = filters.Notch(jnp.asarray(80.0), jnp.asarray(60.0))
    assert response(notch, 80.0) < 0.01 and response(notch, 5.0) == pytest.approx(1.0, abs=0.02)
    assert response(notch, 60.0) == pytest.approx(0.7071, rel=0.05)


def vibrating(hz):
    time = np.arange(4000) / LOOP_HZ
    return np.stack([2.0 * np.sin(2 * np.pi * hz * time)] * 3, axis=-1)


def shaken(built: RateLoopProfile, hz, **inputs):
    """Return a motor's range under gyro vibration in the last 0.1 s of 0.5 s and in the first 10 ms, and the memory."""
    motors, memory = run(built, 4000, gyro=vibrating(hz), **inputs)
    return np.ptp(motors[-800:, 0]), np.ptp(motors[:80, 0]), memory


def test_the_rpm_filter_removes_the_harmonics_of_the_rotors_and_nothing_else():
    on = {"dshot_bidir": "ON", "rpm_filter_weights": "100,0,50"}
    filtered, bare = quiet(p_roll=50, **on), quiet(p_roll=50)
    speeds = 2 * np.pi * np.array([180.0, 190.0, 200.0, 210.0])
    whole = shaken(bare, 200.0)[0]
    assert whole > 0.1
    assert shaken(filtered, 200.0, rotors=speeds)[0] < 0.01 * whole
    assert shaken(filtered, 400.0, rotors=speeds)[0] > 0.5 * whole  # the second harmonic has no weight
    assert 0.05 * whole < shaken(filtered, 600.0, rotors=speeds)[0] < 0.6 * whole  # the third has half weight
    assert shaken(filtered, 60.0, rotors=speeds)[0] > 0.9 * whole


def test_a_notch_of_the_rpm_filter_fades_towards_its_lowest_frequency():
    # rpm_filter.c, rpmFilterUpdate: weight = margin / fade range, times the harmonic's; within min_hz and 0.48 / dt.
    term = quiet(dshot_bidir="ON", rpm_filter_weights="100,0,50", rpm_filter_fade_range_hz=40).rpm_filter
    places = [(1, 90.0), (1, 110.0), (1, 150.0), (3, 45.0), (3, 2000.0)]
    found = [[float(value) for value in rpm_filter.notch_of(term, n, hz, 1 / LOOP_HZ)] for n, hz in places]
    expected = [(100.0, 0.0), (110.0, 0.25), (150.0, 1.0), (135.0, 0.4375), (3840.0, 0.5)]
    assert np.allclose(found, expected)


def test_a_dynamic_notch_finds_the_vibration_and_removes_it():
    built = quiet(p_roll=50, **{"dyn_notch_count": 2})
    left, at_first, memory = shaken(built, 237.0)
    centres_hz = memory.terms["dynamic_notch"]["centre_hz"][-1]
    assert np.abs(centres_hz - 237.0).min(axis=-1).max() < 3.0
    assert left < 0.1 * at_first


def test_the_throttle_moves_a_dynamic_cutoff_in_steps():
    # mixer.c, updateDynLpfCutoffs: hundredths of the throttle, every 5 ms at most; pid.c, dynLpfCutoffFreq.
    built = quiet(p_roll=50, **{"gyro_lpf1_dyn_min_hz": 100, "gyro_lpf1_dyn_max_hz": 300})
    _, memory = run(built, 4000, throttle=np.minimum(np.linspace(0.0, 5.01, 4000), 0.501))
    swept = memory.terms["sweep_throttle"]
    changes = np.flatnonzero(np.diff(swept))
    assert np.all(np.diff(changes) >= 40) and np.allclose(100 * swept, np.round(100 * swept))
    steady = np.full(4000, 0.6)
    low, high = (shaken(built, 150.0, throttle=level)[0] for level in (0 * steady, steady))
    cutoff_hz = 100 + 200 * (0.6 * 0.4 * 0.5 + 0.6)
    gain = lambda hz: response(filters.Lowpass(jnp.asarray(hz / 8)), 150.0 / 8)  # noqa: E731
    assert high / low == pytest.approx(gain(cutoff_hz) / gain(100.0), rel=0.02)


def test_the_filters_of_d_act_on_d_alone():
    built = quiet(d_roll=40, **{"dterm_lpf1_static_hz": 80})
    turn = np.zeros((400, 3))
    turn[40:, 0] = 100.0 / DEGREES
    motors, _ = run(built, 400, gyro=turn)
    gain = 2 * np.pi * 80 / LOOP_HZ / (1 + 2 * np.pi * 80 / LOOP_HZ)
    kick = 40 * 0.000529 * 100.0 * LOOP_HZ * gain / 1000.0
    assert motors[40, 0] - 0.5 == pytest.approx(min(kick, 0.5), rel=1e-3)


def test_the_low_pass_of_yaw_p_is_that_of_the_firmware():
    built = quiet(p_yaw=100, **{"yaw_lowpass_hz": 100})
    motors, _ = run(built, 2, setpoint=(0, 0, 10.0 / DEGREES))
    gain = 2 * np.pi * 100 / LOOP_HZ / (1 + 2 * np.pi * 100 / LOOP_HZ)
    assert motors[0, 0] - 0.5 == pytest.approx(100 * 0.032029 * 10 * gain / 1000.0, rel=1e-3)
