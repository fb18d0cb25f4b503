"""Motors: steady speed from voltage and command, and the first-order lag towards it (Methods, eqs 4 and 6)."""

import jax.numpy as jnp


def steady_speed(motor_command, voltage, motors):
    """Return Omega_ss (..., n) rad/s for commands (..., n) in 0..1 at `voltage` (...) V; a command of 0 is a stop."""
    return _steady(motor_command, voltage[..., None], motors, lambda leaf: leaf[..., None])


def steady_speeds(motor_commands, voltage, motors) -> tuple:
    """Return the same by components: n of (...) for n commands (...)."""
    return tuple(_steady(command, voltage, motors, lambda leaf: leaf) for command in motor_commands)


def _steady(motor_command, voltage, motors, widen):
    c0, c1, c2, c3, c4 = (widen(motors.map_coefficients[..., i]) for i in range(5))
    root = jnp.sqrt(motor_command)
    speed = c0 + c1 * voltage + c3 * motor_command + (c2 + c4 * voltage) * root
    speed = jnp.clip(speed, widen(motors.min_speed), widen(motors.max_speed))
    return jnp.where(motor_command > 0, speed, 0.0)


def lag(rotor_speeds, targets, dt, motors) -> tuple:
    """Return n rotor speeds (...) after `dt` s towards constant targets: the exact solution of the first-order lag.

    Stable and right at any step. The sign of the difference cannot change within one, so one of the two time constants
    holds throughout.
    """
    keep_up, keep_down = (jnp.exp(-dt / time) for time in (motors.time_constant_up, motors.time_constant_down))

    def moved(speed, target):
        return target + jnp.where(target > speed, keep_up, keep_down) * (speed - target)

    return tuple(map(moved, rotor_speeds, targets))


def accelerations(rotor_speeds, targets, motors) -> tuple:
    """Return n of dOmega/dt (...) rad/s^2 of the lag."""
    up, down = motors.time_constant_up, motors.time_constant_down

    def slope(speed, target):
        return (target - speed) / jnp.where(target > speed, up, down)

    return tuple(map(slope, rotor_speeds, targets))
