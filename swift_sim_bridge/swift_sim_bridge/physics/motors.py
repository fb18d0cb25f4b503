"""Motors: steady speed from voltage and command, and the first-order lag towards it (Methods, eqs 4 and 6)."""

import jax.numpy as jnp


def steady_speed(motor_command, voltage, motors):
    """Return Omega_ss (..., n) rad/s for commands (..., n) in 0..1 at `voltage` (...) V; a command of 0 is a stop."""
    c0, c1, c2, c3, c4 = (motors.map_coefficients[..., i, None] for i in range(5))
    root = jnp.sqrt(motor_command)
    voltage = voltage[..., None]
    speed = c0 + c1 * voltage + c3 * motor_command + (c2 + c4 * voltage) * root
    speed = jnp.clip(speed, motors.min_speed[..., None], motors.max_speed[..., None])
    return jnp.where(motor_command > 0, speed, 0.0)


def lag(rotor_speed, target, dt, motors):
    """Return rotor speeds (..., n) after `dt` s towards a constant `target`: the exact solution of the first-order lag.

    The sign of the difference cannot change within a step, so one of the two time constants holds throughout.
    """
    keep_up = jnp.exp(-dt / motors.time_constant_up)[..., None]
    keep_down = jnp.exp(-dt / motors.time_constant_down)[..., None]
    keep = jnp.where(target > rotor_speed, keep_up, keep_down)
    return target + keep * (rotor_speed - target)


def acceleration(rotor_speed, target, motors):
    """Return dOmega/dt (..., n) rad/s^2 of the lag."""
    up, down = motors.time_constant_up[..., None], motors.time_constant_down[..., None]
    return (target - rotor_speed) / jnp.where(target > rotor_speed, up, down)
