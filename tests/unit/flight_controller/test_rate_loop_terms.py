"""Gain scheduling and outputs of the rate loop against the firmware (Betaflight 4.5, pid.c, mixer.c)."""

import numpy as np
import pytest
from dumped_loop import controller, profile, quiet, run

from swift_sim_bridge.flight_controller.rate_loop import mixer
from swift_sim_bridge.flight_controller.rate_loop.loop import DEGREES

P = 0.032029 / 1000.0  # pid.h, PTERM_SCALE over the mixer's: a motor's share of a deg/s
WANT = (10.0 / DEGREES, 0.0, 0.0)


def push(built, passes=3, **inputs):
    """Return half the final difference of rear left and rear right: the roll demand as a share of the range."""
    motors, _ = run(built, passes, **inputs)
    return 0.5 * (motors[-1, 2] - motors[-1, 0])


@pytest.mark.parametrize(
    ("throttle", "factor"),
    # pidUpdateTpaFactor: 1 - rate * (throttle - breakpoint) / (1 - breakpoint) above, and the low part below.
    [(0.3, 1.0), (0.5, 0.84), (1.0, 0.44), (0.05, 0.85)],
)
def test_throttle_attenuates_p_and_d(throttle, factor):
    settings = {"tpa_rate": 56, "tpa_breakpoint": 1300, "tpa_low_rate": 30, "tpa_low_breakpoint": 1100}
    both = quiet(p_roll=50, tpa_mode="PD", tpa_low_always="ON", **settings)
    alone = quiet(p_roll=50, tpa_mode="D", tpa_low_always="ON", **settings)
    middle = 0.5 * 50 * 10 * P
    assert push(alone, setpoint=WANT, throttle=throttle) == pytest.approx(2 * middle, rel=1e-3)
    assert push(both, setpoint=WANT, throttle=throttle) == pytest.approx(2 * middle * factor, rel=1e-3)


def test_the_low_part_of_tpa_ends_with_the_first_throttle():
    built = quiet(p_roll=50, tpa_mode="PD", tpa_rate=0, tpa_low_rate=50, tpa_low_breakpoint=1200)
    _, memory = run(built, 300, throttle=np.repeat([0.0, 0.3, 0.0], 100))
    assert np.all(memory.terms["tpa"][:100] == 0.5) and np.all(memory.terms["tpa"][100:] == 1.0)


def test_anti_gravity_adds_to_i_and_p_while_the_throttle_moves():
    built = quiet(p_roll=50, i_roll=80, i_yaw=80, anti_gravity_gain=100, anti_gravity_cutoff_hz=20)
    want = (10 / DEGREES, 0, 10 / DEGREES)
    calm, moving = (run(built, 400, setpoint=want, throttle=np.linspace(0.2, top, 400)) for top in (0.2, 0.6))
    grown = [memory.iterm[-1] for _, memory in (calm, moving)]
    # The derivative is 8 1/s, weighed by (1 - throttle)^3 / 2; its integral adds 0.34 * 100 times the error's.
    weighed = 8 * np.mean((1 - np.linspace(0.2, 0.6, 400)) ** 3) / 2
    assert (
        0.5 < (grown[1][0] - grown[0][0]) / (0.34 * 100 * weighed * 10 * 0.05) < 0.95
    )  # less than 1: lag of the low-pass
    assert grown[1][2] == pytest.approx(grown[0][2])
    ratio = moving[1].terms["anti_gravity_d"][-2] * 0.0034
    shares = [motors[-1] @ [-0.25, -0.25, 0.25, 0.25] for motors, _ in (calm, moving)]
    iterms = [memory.iterm[-1, 0] / 1000.0 for _, memory in (calm, moving)]
    assert (shares[1] - iterms[1]) / (shares[0] - iterms[0]) == pytest.approx(1 + ratio, rel=5e-3)
    assert profile(features=["-ANTI_GRAVITY"]).anti_gravity is None


def test_throttle_boost_limit_and_output_limit():
    def mean(throttle, **settings):
        return run(quiet(**settings), len(throttle), throttle=throttle)[0].mean(axis=1)

    step = np.repeat([0.3, 0.4], [400, 400])
    boosted = mean(step, throttle_boost=20, throttle_boost_cutoff=15)
    gain = 2 * np.pi * 15 / 8000 / (1 + 2 * np.pi * 15 / 8000)
    assert boosted[400] == pytest.approx(0.4 + 2.0 * (0.4 - 0.3) * (1 - gain), abs=0.01)
    assert boosted[-1] == pytest.approx(0.4, abs=0.01)
    full = np.array([0.5, 1.0])
    assert mean(full, throttle_limit_type="SCALE", throttle_limit_percent=80) == pytest.approx([0.4, 0.8])
    assert mean(full, throttle_limit_type="CLIP", throttle_limit_percent=80) == pytest.approx([0.5, 0.8])
    assert mean(full, motor_output_limit=60) == pytest.approx([0.3, 0.6])


def test_thrust_linearisation_curves_the_motor_outputs_and_compensates_the_throttle():
    # pidApplyThrustLinearization: output * (1 + amount (1 - output)^2), pidCompensateThrustLinearization before it.
    motors, _ = run(quiet(thrust_linear=40), 2, throttle=[0.5, 0.5])
    throttle = 0.5 / (1 + (0.4 - 0.5 * 0.16) * 0.25)
    assert motors[-1] == pytest.approx(throttle * (1 + 0.4 * (1 - throttle) ** 2), rel=1e-5)
    assert push(quiet(p_roll=50, thrust_linear=40), setpoint=WANT, throttle=0.2) > 1.15 * 50 * 10 * P


@pytest.mark.parametrize(("volts", "lost"), [(17.2, 0.25), (16.8, 0.25), (15.4, 0.125), (14.0, 0.0), (13.0, 0.0)])
def test_voltage_compensation_reserves_the_range_that_an_empty_pack_needs(volts, lost):
    # calculateThrottleAndCurrentMotorEndpoints: (4.2 - warning) / 4.2 of the range at 4.2 V a cell, none at warning.
    term = quiet(vbat_sag_compensation=150).sag_compensation
    assert float(mixer.range_lost_to_sag(np.asarray(volts), term)) == pytest.approx(lost, abs=1e-6)


def test_thrust_linearisation_acts_within_the_range_that_voltage_compensation_leaves():
    # applyMixToMotors: linearised first, then scaled to motorRangeMin..motorRangeMax.
    built = quiet(p_roll=50, thrust_linear=40, vbat_sag_compensation=100, dshot_idle_value=500)
    motors, _ = run(built, 2, setpoint=WANT, throttle=0.5)  # the meter begins at a full pack
    throttle = 0.5 / (1 + 0.32 * 0.25)
    output = throttle + 50 * 10 * P * np.array([-1, -1, 1, 1])
    bent = output * (1 + 0.4 * (1 - output) ** 2)
    assert motors[-1] == pytest.approx(0.05 + 0.95 * (1 - 0.7 / 4.2) * bent, rel=1e-4)
    assert quiet(cells=0, vbat_sag_compensation=100).sag_compensation is None


def test_d_stays_at_its_minimum_until_gyro_or_setpoint_move():
    built = quiet(d_roll=40, d_min_roll=20, d_max_gain=37, dterm_lpf1_static_hz=70)
    time = np.arange(1600) / 8000
    turning = lambda size: np.stack([size * np.sin(2 * np.pi * 40 * time), 0 * time, 0 * time], axis=-1)  # noqa: E731
    calm, wild = (run(built, 1600, gyro=turning(size)) for size in (0.02, 8.0))
    factor = [memory.terms["d_factor"][1][-400:, 0] for _, memory in (calm, wild)]
    assert factor[0] == pytest.approx(0.5, abs=0.03) and factor[1].max() > 0.9
    swings = [np.ptp(motors[-400:, 0]) / size for (motors, _), size in ((calm, 0.02),)]
    whole = np.ptp(run(quiet(d_roll=40, dterm_lpf1_static_hz=70), 1600, gyro=turning(0.02))[0][-400:, 0]) / 0.02
    assert swings[0] / whole == pytest.approx(0.51, abs=0.03)


@pytest.mark.parametrize(("kind", "axes"), [("SETPOINT", "RP"), ("GYRO", "RPY")])
def test_the_i_term_is_frozen_while_the_setpoint_moves(kind, axes):
    step = np.zeros((1600, 3))
    step[800:] = 100.0 / DEGREES
    built = quiet(i_roll=80, i_pitch=80, i_yaw=80, iterm_relax_type=kind, iterm_relax=axes)
    iterm = run(built, 1600, setpoint=step)[1].iterm
    free = 80 * 0.244381 * 100.0 * 51 / 8000  # after 51 passes without relax
    assert iterm[850, 0] < 0.1 * free < iterm[-1, 0]
    # pid_init.c: yaw's I counts 2.5 times, and is relaxed by RPY alone.
    assert iterm[850, 2] == pytest.approx(2.5 * free, rel=1e-2) if axes == "RP" else iterm[850, 2] < 0.25 * free


def test_incremental_relax_lets_the_i_term_shrink():
    swing = np.zeros((1600, 3))
    swing[:800], swing[800:] = 20.0 / DEGREES, -150.0 / DEGREES
    both = [run(quiet(i_roll=80, iterm_relax=kind), 1600, setpoint=swing)[1].iterm[:, 0] for kind in ("RP", "RP_INC")]
    assert both[0][860] > 0.9 * both[0][799] and both[1][860] < 0.8 * both[1][799]


def test_the_i_term_stops_growing_near_saturation_and_rotates_with_the_body():
    built = quiet(p_roll=250, i_roll=80, iterm_windup=60)
    _, memory = run(built, 400, setpoint=(125.0 / DEGREES, 0, 0))  # saturated: P alone takes the whole range
    assert np.all(memory.mix_range[10:] >= 1.0) and memory.iterm[-1, 0] == memory.iterm[10, 0]
    assert quiet(iterm_windup=100).windup_inverse is None
    passes = 4000  # half a turn in yaw at 2 pi rad/s: the I term of roll changes its sign
    _, memory = run(
        quiet(i_roll=80, iterm_rotation="ON"),
        passes,
        gyro=(0, 0, 2 * np.pi),
        setpoint=np.where(np.arange(passes)[:, None] < 40, [[1.0, 0, 0]], 0.0),
    )
    begun, ended = memory.iterm[40, :2], memory.iterm[-1, :2]
    assert ended == pytest.approx(-begun, abs=float(0.05 * np.abs(begun).max()))


@pytest.mark.parametrize(("kind", "expected"), [("LINEAR", [0.0, 0.4, 0.4, 0.8]), ("DYNAMIC", [0.0, 0.0, 0.0, 0.8])])
def test_other_mixers_only_add_at_low_throttle_and_only_subtract_at_full_throttle(kind, expected):
    built = quiet(p_roll=100, p_pitch=100, mixer_type=kind)
    want = 0.2 / (100 * P) / DEGREES  # 0.2 of the range on roll and on pitch: 0 to 0.4 either side of nothing
    motors, _ = run(built, 2, setpoint=(want, want, 0.0), throttle=[0.0, 0.0])
    assert np.sort(motors[-1]) == pytest.approx(expected, abs=2e-3)
    full, _ = run(built, 2, setpoint=(want, want, 0.0), throttle=[1.0, 1.0])
    assert full[-1].max() == pytest.approx(1.0, abs=2e-3)


def test_the_idle_of_analogue_motors_is_set_by_pulses():
    built = controller(motor_pwm_protocol="PWM", min_throttle=1080, max_throttle=1900)
    assert built.motor_idle == 8.0 and not built.digital and controller().digital
    analogue = quiet(motor_pwm_protocol="PWM", min_throttle=1080, max_throttle=1900)
    assert run(analogue, 2, throttle=[0.0, 1.0])[0].mean(axis=1) == pytest.approx([0.08, 0.9], abs=1e-6)
