"""The inputs of simulated and real firmware: set-ups as lines of the CLI, and sequences of sticks and gyro.

The gyro follows the sticks with a plausible lag and noise. The loop is open: both get the same inputs, whatever their
motors do.
"""

from dataclasses import dataclass

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable
from swift_sim_bridge.flight_controller.sitl.replay import FRAME_PASSES

FRAMES_HZ = 100  # rate of the stick frames, as the link sends them
FRAMES = 100  # of each sequence
MID_US, LOW_US, HALF_US = 1500, 1000, 500  # stick centre, lower end and half range
ARMED_US = 2000  # of AUX1
RESPONSE_S, NOISE_S = 0.03, 0.002  # time constants of the gyro's response to the sticks and of its noise
FULL_STICK_RAD_S = np.radians([500.0, 500.0, 280.0])  # rates of the gyro at full roll, pitch and yaw stick

# Needed by Betaflight SITL in every set-up: analogue motors, an ARM switch, no check that the gyro is at rest.
INSTRUMENT = (
    "feature -GPS",
    "feature -TELEMETRY",
    "map AETR1234",
    "aux 0 0 0 1700 2100 0 0",
    "set motor_pwm_protocol = PWM",
    "set min_command = 1000",
    "set max_throttle = 2000",
    "set pid_process_denom = 1",
    "set acc_calibration = 0,0,0,1",
    "set gyro_calib_duration = 50",
    "set serial_update_rate_hz = 1000",
    "set runaway_takeoff_prevention = OFF",
    "set small_angle = 180",
    "set pwr_on_arm_grace = 0",
)
# SITL is built without dynamic notches, DShot (hence no RPM filter) and a voltage meter: the simulation must not have
# them either.
LACKING = ("set dyn_notch_count = 0",)

_PLAIN = {
    "f_roll": 0,
    "f_pitch": 0,
    "f_yaw": 0,
    "d_min_roll": 0,
    "d_min_pitch": 0,
    "anti_gravity_gain": 0,
    "tpa_rate": 0,
    "tpa_low_rate": 0,
    "throttle_boost": 0,
    "rc_smoothing": "OFF",
    "yaw_lowpass_hz": 0,
    "gyro_lpf1_dyn_min_hz": 0,
    "gyro_lpf1_static_hz": 0,
    "gyro_lpf2_static_hz": 0,
    "dterm_lpf1_dyn_min_hz": 0,
    "dterm_lpf1_static_hz": 70,
    "dterm_lpf2_static_hz": 70,
    "p_roll": 52,
    "i_roll": 40,
    "d_roll": 48,
    "p_pitch": 56,
    "i_pitch": 42,
    "d_pitch": 52,
    "p_yaw": 75,
    "i_yaw": 8,
    "iterm_relax": "RPY",
    "pidsum_limit_yaw": 200,
    "min_throttle": 1055,
    "rates_type": "BETAFLIGHT",
    "roll_rc_rate": 120,
    "pitch_rc_rate": 120,
    "yaw_rc_rate": 100,
    "roll_srate": 60,
    "pitch_srate": 60,
    "yaw_srate": 30,
}
_EVERYTHING = {
    "gyro_lpf1_type": "PT2",
    "gyro_lpf2_type": "BIQUAD",
    "gyro_notch1_hz": 300,
    "gyro_notch1_cutoff": 220,
    "dterm_lpf1_type": "BIQUAD",
    "dterm_lpf2_type": "PT3",
    "dterm_notch_hz": 260,
    "dterm_notch_cutoff": 180,
    "tpa_mode": "PD",
    "tpa_rate": 80,
    "tpa_breakpoint": 1250,
    "tpa_low_always": "ON",
    "tpa_low_rate": 30,
    "tpa_low_breakpoint": 1150,
    "iterm_relax": "RPY_INC",
    "iterm_relax_type": "GYRO",
    "iterm_relax_cutoff": 20,
    "iterm_rotation": "ON",
    "iterm_windup": 60,
    "mixer_type": "LINEAR",
    "thrust_linear": 40,
    "throttle_limit_type": "SCALE",
    "throttle_limit_percent": 90,
    "feedforward_averaging": "2_POINT",
    "feedforward_transition": 30,
    "feedforward_boost": 25,
    "feedforward_smooth_factor": 40,
    "motor_output_limit": 90,
    "throttle_boost": 10,
    "d_max_gain": 50,
    "d_max_advance": 60,
    "acc_limit": 300,
    "anti_gravity_gain": 120,
    "rates_type": "QUICK",
    "roll_rc_rate": 110,
    "pitch_rc_rate": 110,
    "yaw_rc_rate": 90,
    "roll_srate": 80,
    "pitch_srate": 80,
    "yaw_srate": 50,
    "roll_expo": 30,
    "pitch_expo": 30,
    "yaw_expo": 10,
    "quickrates_rc_expo": "ON",
    "thr_mid": 40,
    "thr_expo": 30,
    "deadband": 4,
    "yaw_deadband": 6,
    "pidsum_limit": 400,
    "yaw_motors_reversed": "ON",
}
SET_UPS = {
    "default": (),
    "plain": tuple(f"set {name} = {value}" for name, value in _PLAIN.items()),
    "everything": tuple(f"set {name} = {value}" for name, value in _EVERYTHING.items()),
}


@dataclass(frozen=True)
class Sequence:
    """One sequence of inputs.

    Attributes:
        frames_us: (n, 5), roll, pitch, throttle, yaw and AUX1.
        gyro_omega_body: (n * FRAME_PASSES, 3) rad/s, FLU.
    """

    frames_us: np.ndarray
    gyro_omega_body: np.ndarray


def still(frames: int) -> Sequence:
    """Return the sequence of an armed vehicle at rest with zero throttle."""
    row = [MID_US, MID_US, LOW_US, MID_US, ARMED_US]
    return Sequence(np.tile(row, (frames, 1)), np.zeros((frames * FRAME_PASSES, 3)))


def sequences(seed: int) -> dict[str, Sequence]:
    """Return sequences of one second each, by name."""
    rng = np.random.default_rng(seed)
    time, zero = np.arange(FRAMES) / FRAMES_HZ, np.zeros(FRAMES)
    square = lambda period, size: size * np.sign(np.sin(2 * np.pi * time / period + 1e-9))  # noqa: E731
    tones = lambda hz, size: size * sum(np.sin(2 * np.pi * f * time + i) for i, f in enumerate(hz)) / len(hz)  # noqa: E731
    shake = lambda size: size * rng.standard_normal(FRAMES)  # noqa: E731
    wave = lambda rate, size=1.0, phase=0.0: size * np.sin(rate * time + phase)  # noqa: E731
    cut_us = np.where(time < 0.4, 1700, np.where(time < 0.7, LOW_US, 1500))
    switched_us = LOW_US + 1000 * (np.sin(6 * np.pi * time) > 0)
    steps = (square(0.4, 0.5), square(0.5, 0.4) * (time > 0.2), square(0.6, 0.5) * (time > 0.3))
    mixed = (tones([1, 3, 7, 13], 1.2), tones([1.5, 4, 9, 17], 1.2), tones([1, 2, 5], 1.0))
    flown = (wave(9, 0.8) + shake(0.2), wave(6, 0.6, 1) + shake(0.2), wave(3, 0.5) + shake(0.1))
    return {
        "rest": _sequence(rng, (zero, zero, zero), LOW_US + zero, share=0.0, noise_deg_s=0.0),
        "steps": _sequence(rng, steps, 1400 + 200 * (time > 0.5)),
        "multisine": _sequence(rng, mixed, 1500 + wave(4 * np.pi, 150)),
        "race-like": _sequence(rng, flown, 1600 + wave(5, 250) + shake(60), noise_deg_s=3.0),
        "saturation": _sequence(rng, (square(0.5, 1), square(0.3, 1), square(0.7, 1)), switched_us, share=0.4),
        "throttle cut": _sequence(rng, (wave(12, 0.3), wave(9, 0.3, 1.5), wave(5, 0.2)), cut_us),
    }


def _sequence(rng, deflections, throttle_us, share: float = 1.0, noise_deg_s: float = 1.0) -> Sequence:
    """Return sticks at `deflections` (roll, pitch, yaw, -1..1) and a gyro that follows a `share` of them."""
    roll, pitch, yaw = (MID_US + HALF_US * np.asarray(part) for part in deflections)
    columns = (roll, pitch, throttle_us, yaw, np.full(len(roll), ARMED_US))
    frames_us = np.clip(np.round(np.stack(columns, axis=-1)), LOW_US, 2000).astype(int)
    target = (frames_us[:, [0, 1, 3]] - MID_US) / HALF_US * [1.0, 1.0, -1.0] * FULL_STICK_RAD_S
    target = np.repeat(target, FRAME_PASSES, axis=0)
    noise = np.radians(noise_deg_s) * _lagged(20.0 * rng.standard_normal(target.shape), NOISE_S)
    return Sequence(frames_us, share * _lagged(target, RESPONSE_S) + noise)


def _lagged(values, time_constant_s: float):
    """Return values (passes, k) through a first-order low-pass filter."""
    gain = 1.0 / (1.0 + time_constant_s * FRAMES_HZ * FRAME_PASSES)
    lagged = np.zeros_like(values)
    for i in range(1, len(values)):
        lagged[i] = lagged[i - 1] + gain * (values[i] - lagged[i - 1])
    return lagged


def recorded(flight: FlightTable, full_stick_rad_s: float, start_s: float, seconds: float) -> Sequence:
    """Return sticks and gyro of a part of a recorded race; a thrust command of 40 m/s^2 is full throttle.

    Args:
        flight: the recording.
        full_stick_rad_s: body rate of a full stick.
        start_s: begin of the part, after the first thrust command.
        seconds: length of the part.

    Raises:
        UsageError: the flight has no gyro, no commands, or never commands thrust.
    """
    flight.require("gyro_body", "omega_command_body", "thrust_command")
    rates, thrust, gyro = (flight[name] for name in ("omega_command_body", "thrust_command", "gyro_body"))
    if not np.any(thrust.values > 0):
        raise UsageError(f"{flight.name} never commands thrust; give a recorded race")
    first_s = thrust.t[np.argmax(thrust.values > 0)]
    times = first_s + start_s + np.arange(round(seconds * FRAMES_HZ)) / FRAMES_HZ
    held = np.clip(np.searchsorted(rates.t, times, side="right") - 1, 0, len(rates.t) - 1)
    sticks = MID_US + HALF_US * rates.values[held] / full_stick_rad_s * [1.0, 1.0, -1.0]
    throttle_us = LOW_US + 50 + 950 * np.sqrt(np.clip(thrust.values[held] / 40.0, 0.0, 1.0))
    columns = (sticks[:, 0], sticks[:, 1], throttle_us, sticks[:, 2], np.full(len(times), ARMED_US))
    gyro_times = times[0] + np.arange(len(times) * FRAME_PASSES) / (FRAMES_HZ * FRAME_PASSES)
    omega = np.stack([np.interp(gyro_times, gyro.t, gyro.values[:, axis]) for axis in range(3)], axis=-1)
    return Sequence(np.clip(np.round(np.stack(columns, axis=-1)), LOW_US, 2000).astype(int), omega)
