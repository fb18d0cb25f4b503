"""Betaflight 4.5's rate loop and mixer, from the firmware's formulas (pid.c, mixer.c, filter.c), batchable in JAX.

The firmware works in degrees and in axes that are those of FLU: roll right, nose down, turn left are positive.
Motors 1-4: rear right, front right, rear left, front left. D acts on the measurement alone; the I term is reset while
the throttle is closed; at saturation body rates go first (Methods, low-level controller).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.profile import controller_from_vehicle

PTERM_SCALE = 0.032029  # firmware, pid.h: gains as users set them -> per deg/s
ITERM_SCALE = 0.244381
DTERM_SCALE = 0.000529
ITERM_RELAX_THRESHOLD = 40.0  # deg/s by which a setpoint runs ahead of its own low-pass while the I term stands still
PID_MIXER_SCALING = 1000.0
MIX = np.array([[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, 1.0, -1.0]])  # roll, pitch, yaw of quad X
DEGREES = 180.0 / np.pi


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Profile:
    """Gains (..., 3) on deg/s; cutoffs (...) Hz, 0 = off; iterm_limit (...) and pidsum_limit (..., 3) in PID units.

    windup_inverse (...): one over the share of the motors' range in which the I term fades out; motor_idle (...): 0..1;
    yaw_direction (...): -1, or +1 where the propellers turn outwards at the front (`yaw_motors_reversed`).
    """

    kp: jax.Array
    ki: jax.Array
    kd: jax.Array
    gyro_cutoff_hz: jax.Array
    dterm_cutoff_hz: jax.Array
    dterm_cutoff2_hz: jax.Array
    iterm_limit: jax.Array
    iterm_relax_cutoff_hz: jax.Array
    windup_inverse: jax.Array
    pidsum_limit: jax.Array
    motor_idle: jax.Array
    yaw_direction: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RateLoopState:
    """The loop's memory, (..., 3) in deg/s or PID units; mix_range (...): spread of the last motor differences."""

    iterm: jax.Array
    gyro: jax.Array
    dterm_gyro: jax.Array
    dterm_gyro2: jax.Array
    setpoint: jax.Array
    mix_range: jax.Array


def profile_from_vehicle(vehicle: Vehicle, dtype=None) -> Profile:
    """Return the unbatched profile of a vehicle file. Raises UsageError as `controller_from_vehicle`."""
    controller = controller_from_vehicle(vehicle)
    gains = np.array([controller.pid.roll, controller.pid.pitch, controller.pid.yaw]).T
    windup_free = 1.0 - controller.iterm_windup / 100.0
    profile = Profile(
        kp=gains[0] * PTERM_SCALE,
        ki=gains[1] * ITERM_SCALE,
        kd=gains[2] * DTERM_SCALE,
        gyro_cutoff_hz=controller.gyro_lpf1_static_hz,
        dterm_cutoff_hz=controller.dterm_lpf1_static_hz,
        dterm_cutoff2_hz=controller.dterm_lpf2_static_hz,
        iterm_limit=controller.iterm_limit,
        iterm_relax_cutoff_hz=controller.iterm_relax_cutoff,
        windup_inverse=1.0 / windup_free if windup_free > 0 else 1e6,
        pidsum_limit=np.array([controller.pidsum_limit, controller.pidsum_limit, controller.pidsum_limit_yaw]),
        motor_idle=controller.motor_idle / 100.0,
        yaw_direction=1.0 if controller.yaw_motors_reversed else -1.0,
    )
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=dtype or jnp.result_type(float)), profile)


def initial_loop_state(omega_body) -> RateLoopState:
    """Return the memory of a loop that has seen the gyro at rest; `omega_body` (..., 3) gives shape and type."""
    zero = jnp.zeros_like(omega_body)
    return RateLoopState(zero, zero, zero, zero, zero, zero[..., 0])


def _pt1(filtered, sample, cutoff_hz, dt):
    """Return the firmware's PT1 low-pass (..., 3) after one more sample; a cutoff (...) of 0 switches it off."""
    time_constant = 1.0 / (2.0 * np.pi * jnp.maximum(cutoff_hz, 1e-3))
    gain = jnp.where(cutoff_hz > 0, dt / (time_constant + dt), 1.0)[..., None]
    return filtered + gain * (sample - filtered)


def mix(pid_sum, throttle, profile):
    """Return (motor_command (..., 4) in 0..1, range (...)) of axis demands (..., 3) in PID units and throttle (...).

    Airmode with rate priority: differences are scaled only when their range exceeds the motors' own, and the throttle
    is moved into what they leave free.
    """
    demand = jnp.clip(pid_sum, -profile.pidsum_limit, profile.pidsum_limit) / PID_MIXER_SCALING
    roll, pitch, yaw = (demand[..., i, None] for i in range(3))
    roll_mix, pitch_mix, yaw_mix = (jnp.asarray(row, dtype=demand.dtype) for row in MIX)
    differences = roll * roll_mix + pitch * pitch_mix + profile.yaw_direction[..., None] * yaw * yaw_mix
    low, high = jnp.min(differences, axis=-1), jnp.max(differences, axis=-1)
    mix_range = high - low
    scale = 1.0 / jnp.maximum(mix_range, 1.0)
    throttle = jnp.clip(throttle, -low * scale, 1.0 - high * scale)
    output = differences * scale[..., None] + throttle[..., None]
    idle = profile.motor_idle[..., None]
    return idle + (1.0 - idle) * jnp.clip(output, 0.0, 1.0), mix_range


def rate_loop_step(loop_state, setpoint_omega_body, throttle, gyro_omega_body, profile, dt):
    """Return (loop_state, motor_command (..., 4) in 0..1) of one pass of the loop, `dt` s after the last.

    setpoint_omega_body, gyro_omega_body: (..., 3) rad/s; throttle: (...) 0..1, 0 = closed.
    """
    setpoint = setpoint_omega_body * DEGREES
    gyro = _pt1(loop_state.gyro, gyro_omega_body * DEGREES, profile.gyro_cutoff_hz, dt)
    error = setpoint - gyro

    dterm_gyro = _pt1(loop_state.dterm_gyro, gyro, profile.dterm_cutoff_hz, dt)
    dterm_gyro2 = _pt1(loop_state.dterm_gyro2, dterm_gyro, profile.dterm_cutoff2_hz, dt)
    dterm = profile.kd * (loop_state.dterm_gyro2 - dterm_gyro2) / dt

    slow_setpoint = _pt1(loop_state.setpoint, setpoint, profile.iterm_relax_cutoff_hz, dt)
    relax = jnp.maximum(1.0 - jnp.abs(setpoint - slow_setpoint) / ITERM_RELAX_THRESHOLD, 0.0)
    free = jnp.clip((1.0 - loop_state.mix_range) * profile.windup_inverse, 0.0, 1.0)[..., None]
    limit = profile.iterm_limit[..., None]
    iterm = jnp.clip(loop_state.iterm + profile.ki * error * relax * free * dt, -limit, limit)
    iterm = jnp.where(throttle[..., None] > 0, iterm, 0.0)

    motor_command, mix_range = mix(profile.kp * error + iterm + dterm, throttle, profile)
    return RateLoopState(iterm, gyro, dterm_gyro, dterm_gyro2, slow_setpoint, mix_range), motor_command
