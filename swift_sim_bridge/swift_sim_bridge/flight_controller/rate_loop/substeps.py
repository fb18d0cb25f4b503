"""The rate loop within the steps of the physics: several passes in a step, and the delay of the serial task.

The firmware runs at up to 8 kHz, faster than the physics. Betaflight reads MSP at 100 Hz (fc/tasks.c, TASK_SERIAL), so
a frame waits for up to 10 ms: `serial_phase_s` of a profile.
"""

import jax
import jax.numpy as jnp

from swift_sim_bridge.flight_controller.rate_loop.loop import LoopInput, rate_loop_step


def passes_per_step(profile, dt: float) -> int:
    """Return the number of passes of the loop in a physics step of `dt` s; 1 for a profile without a rate."""
    return max(1, round(profile.loop_hz * dt))


def steps_of_old_frame(profile, dt: float, substeps: int) -> int:
    """Return the number of physics steps of a tick that still use the frame of the previous tick."""
    return min(substeps, round(profile.serial_phase_s / dt))


def mean_motor_command(loop_state, measured: LoopInput, omega_body, profile, dt: float):
    """Run the passes of the rate loop that fall into one physics step.

    The first pass takes the measured gyro. Later passes extrapolate it by the change of the true rates since the
    previous step, because a gyro in steps would put spikes into the D term.

    Args:
        loop_state: memory of the passes before.
        measured: input at the start of the step.
        omega_body: (..., 3) rad/s, true rates at the start of the step.
        profile: profile of the loop.
        dt: s of the physics step, a plain number.

    Returns:
        (loop_state, motor_command (..., 4)), the mean over the passes.
    """
    passes = passes_per_step(profile, dt)
    if passes == 1:
        return rate_loop_step(loop_state, measured, profile, dt)
    gyro = measured.gyro_omega_body
    change_per_pass = (omega_body - loop_state.terms["omega_before"]) / passes

    def run_pass(loop_state, number):
        extrapolated = measured._replace(gyro_omega_body=gyro + number * change_per_pass)
        return rate_loop_step(loop_state, extrapolated, profile, dt / passes)

    loop_state, commands = jax.lax.scan(run_pass, loop_state, jnp.arange(passes, dtype=gyro.dtype))
    loop_state.terms["omega_before"] = omega_body
    return loop_state, jnp.mean(commands, axis=0)
