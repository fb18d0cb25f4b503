"""Rate loops configured by the lines of a CLI dump, for the tests of the rate loop: no files, no physics.

`quiet` switches off everything that is not under test: one effect remains, and it compiles fast.
"""

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.flight_controller.configuration import cli_dump
from swift_sim_bridge.flight_controller.configuration.controller_section import DumpedController
from swift_sim_bridge.flight_controller.configuration.dump_profile import profile_from_dump
from swift_sim_bridge.flight_controller.rate_loop.loop import LoopInput, initial_loop_state, rate_loop_step, take_frame
from swift_sim_bridge.flight_controller.rate_loop.stick_path import FRAMES_HZ, ReceiverFrame

LOOP_HZ = 8000.0
FEW_PASSES = 4  # up to so many passes, compiling takes longer than running without it
QUIET = {
    "gyro_lpf1_static_hz": 0,
    "gyro_lpf1_dyn_min_hz": 0,
    "gyro_lpf2_static_hz": 0,
    "dyn_notch_count": 0,
    "dterm_lpf1_static_hz": 0,
    "dterm_lpf1_dyn_min_hz": 0,
    "dterm_lpf2_static_hz": 0,
    "yaw_lowpass_hz": 0,
    "rc_smoothing": "OFF",
    "anti_gravity_gain": 0,
    "throttle_boost": 0,
    "tpa_rate": 0,
    "tpa_low_rate": 0,
    "iterm_relax": "OFF",
    "d_min_roll": 0,
    "d_min_pitch": 0,
    "dshot_idle_value": 0,
    "airmode_start_throttle_percent": 0,
    **{f"{letter}_{axis}": 0 for letter in "pidf" for axis in ("roll", "pitch", "yaw")},
}


def controller(cells=4, loop_hz=8000.0, features=(), **settings) -> DumpedController:
    """Return the controller of a dump with these settings."""
    lines = [f"set {name} = {value}" for name, value in settings.items()] or ["set p_roll = 45"]
    dump = cli_dump.parse("\n".join([*lines, *(f"feature {name}" for name in features)]), "a dump")
    return DumpedController(dump.settings, dump.features, dump.unmodelled, loop_hz, 0.0, cells)


def profile(cells=4, loop_hz=8000.0, features=(), **settings):
    """Return the loop's profile of a dump with these settings."""
    built = profile_from_dump(controller(cells, loop_hz, features, **settings))
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(float)), built)


def quiet(cells=4, loop_hz=8000.0, features=(), **settings):
    """Return the profile of a loop that does nothing but what `settings` ask for."""
    return profile(cells, loop_hz, features, **{**QUIET, **settings})


def _one(loop, now, profile, dt):
    """Return (loop, (motors, loop)) after one pass; where `is_frame`, a receiver frame comes first."""
    measured, is_frame = now
    frame = ReceiverFrame(measured.setpoint_omega_body, measured.throttle, jnp.asarray(True))
    taken = take_frame(loop, frame, profile)
    loop = jax.tree.map(lambda new, old: jnp.where(is_frame, new, old), taken, loop)
    loop, motors = rate_loop_step(loop, measured, profile, dt)
    return loop, (motors, loop)


@jax.jit
def _compiled(loop, inputs, profile, dt):
    return jax.lax.scan(lambda loop, now: _one(loop, now, profile, dt), loop, inputs)[1]


def _stepped(loop, inputs, profile, dt):
    """Return the same as `_compiled`: for a few passes compiling takes longer than running."""
    rows = []
    for i in range(len(inputs[1])):
        loop, row = _one(loop, jax.tree.map(lambda part, i=i: part[i], inputs), profile, dt)
        rows.append(row)
    return jax.tree.map(lambda *parts: jnp.stack(parts), *rows)


def run(profile, passes, setpoint=(0, 0, 0), throttle=0.5, gyro=(0, 0, 0), rotors=0.0):
    """Run a loop at LOOP_HZ with receiver frames at FRAMES_HZ.

    Args:
        profile: profile of the loop.
        passes: number of passes.
        setpoint: (3,) or (passes, 3) rad/s.
        throttle: 0 to 1, a number or (passes,).
        gyro: (3,) or (passes, 3) rad/s.
        rotors: rad/s, a number, (4,) or (passes, 4).

    Returns:
        (motor commands (passes, 4), the loop's memory after each pass).
    """
    wide = lambda value, width: np.broadcast_to(np.asarray(value, float), (passes, width))  # noqa: E731
    along = np.broadcast_to(np.asarray(throttle, float), (passes,))
    is_frame = np.arange(passes) % max(1, round(LOOP_HZ / FRAMES_HZ)) == 0
    inputs = (LoopInput(wide(setpoint, 3), along, wide(gyro, 3), wide(rotors, 4)), is_frame)
    loop = initial_loop_state(jnp.zeros(3), profile)
    fly = _stepped if passes <= FEW_PASSES else _compiled
    motors, memory = fly(loop, jax.tree.map(jnp.asarray, inputs), profile, 1.0 / LOOP_HZ)
    return np.asarray(motors), jax.tree.map(np.asarray, memory)
