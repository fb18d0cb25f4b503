"""The rate loop in the time of the physics: several passes a step where its rate asks so, frames by the serial task.

A firmware runs at up to 8 kHz; the physics need not. Betaflight polls MSP at 100 Hz (fc/tasks.c, TASK_SERIAL), so that
a frame waits for up to 10 ms: `serial_phase_s` of a profile.
"""

import jax
import jax.numpy as jnp

from swift_sim_bridge.flight_controller.rate_loop.loop import rate_loop_step


def passes_per_step(profile, dt: float) -> int:
    """Return how many passes of the loop fall into a physics step of `dt` s; one where the profile names no rate."""
    return max(1, round(profile.loop_hz * dt))


def steps_of_old_frame(profile, dt: float, substeps: int) -> int:
    """Return how many of a tick's physics steps still fly the frame of the tick before."""
    return min(substeps, round(profile.serial_phase_s / dt))


def motor_command(loop_state, setpoint_omega_body, throttle, gyro, omega_body, profile, dt, rotor_speed=None):
    """Return (loop_state, motor_command (..., 4)) of a physics step of `dt` s, a plain number: the mean of its passes.

    gyro (..., 3) rad/s: what is measured of omega_body at the start. Later passes see it go on turning as since the
    step before: a staircase would make spikes of D. The rest as `rate_loop_step`.
    """
    passes = passes_per_step(profile, dt)
    if passes == 1:
        return rate_loop_step(loop_state, setpoint_omega_body, throttle, gyro, profile, dt, rotor_speed)
    turned = (omega_body - loop_state.terms["omega_before"]) / passes

    def one(loop_state, number):
        seen = gyro + number * turned
        return rate_loop_step(loop_state, setpoint_omega_body, throttle, seen, profile, dt / passes, rotor_speed)

    loop_state, commands = jax.lax.scan(one, loop_state, jnp.arange(passes, dtype=gyro.dtype))
    loop_state.terms["omega_before"] = omega_body
    return loop_state, jnp.mean(commands, axis=0)
