"""Motors: steady speed by voltage and command, and the first-order lag towards it (Methods, eqs 4 and 6)."""

import jax.numpy as jnp

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import MOTOR_CHANNELS, Effect, NotIdentified, Parameter

MAP_UNITS = ("rad/s", "rad/s/V", "rad/s", "rad/s", "rad/s/V")  # of c0 to c4 of the motor map
ESTIMATED_MAP = (2, 3, 4)  # indices of the coefficients that the gap tool estimates: those of terms with the command u


def steady_speed(motor_command, voltage, motors):
    """Return Omega_ss (..., n) rad/s for commands (..., n) in 0..1 at `voltage` (...) V; 0 at a command of 0."""
    return _steady(motor_command, voltage[..., None], motors, lambda leaf: leaf[..., None])


def steady_speeds(motor_commands, voltage, motors) -> tuple:
    """Return the same by components: n of (...) for n commands (...)."""
    return tuple(_steady(command, voltage, motors, lambda leaf: leaf) for command in motor_commands)


def _steady(motor_command, voltage, motors, widen):
    """Return the steady speed; `widen` aligns parameters (...) with the commands."""
    c0, c1, c2, c3, c4 = (widen(motors.map_coefficients[..., i]) for i in range(5))
    root = jnp.sqrt(motor_command)
    speed = c0 + c1 * voltage + c3 * motor_command + (c2 + c4 * voltage) * root
    speed = jnp.clip(speed, widen(motors.min_speed), widen(motors.max_speed))
    return jnp.where(motor_command > 0, speed, 0.0)


def lag(rotor_speeds, targets, dt, motors) -> tuple:
    """Return n rotor speeds (...) after `dt` s towards constant targets: the exact solution of the first-order lag.

    Stable and exact at any step. The sign of the difference cannot change within a step, so one of the two time
    constants holds throughout.
    """
    keep_up, keep_down = (jnp.exp(-dt / time) for time in (motors.time_constant_up, motors.time_constant_down))

    def moved(speed, target):
        return target + jnp.where(target > speed, keep_up, keep_down) * (speed - target)

    return tuple(map(moved, rotor_speeds, targets))


def accelerations(rotor_speeds, targets, motors) -> tuple:
    """Return the n accelerations dOmega/dt (...) rad/s^2 of the lag."""
    up, down = motors.time_constant_up, motors.time_constant_down

    def slope(speed, target):
        return (target - speed) / jnp.where(target > speed, up, down)

    return tuple(map(slope, rotor_speeds, targets))


def effects(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return the effects of the motors' time constants and of the motor map."""
    up, down, lag = ("motor", "time_constant_up"), ("motor", "time_constant_down"), vehicle.motor.time_constant_up
    speed, volts = vehicle.rotor_speed_range[1], vehicle.battery.reference_voltage
    return (
        Effect(
            id="motor_time_constant",
            layer="motor",
            parameters=(Parameter("time_constant_up", "s", up, 0.01 * lag, 0.2 * lag, 5 * lag, tied=(down,)),),
            equation="tau dOmega/dt = Omega_ss - Omega",
            sentence="the motors lag by {time_constant_up:.4g} s",
            manoeuvre="throttle steps or a chirp of the throttle",
            channels=MOTOR_CHANNELS,
        ),
        Effect(
            id="motor_asymmetry",
            layer="motor",
            parameters=(Parameter("time_constant_down", "s", down, 0.01 * lag, 0.2 * lag, 5 * lag),),
            equation="tau_down dOmega/dt = Omega_ss - Omega where Omega > Omega_ss",
            sentence="the motors slow down with a lag of {time_constant_down:.4g} s, another than speeding up",
            manoeuvre="throttle steps up and down",
            channels=MOTOR_CHANNELS,
        ),
        Effect(
            id="motor_map",
            layer="motor",
            parameters=tuple(
                Parameter(
                    f"coefficients[{i}]",
                    MAP_UNITS[i],
                    ("motor", "map", "coefficients", i),
                    step=0.005 * (speed / volts if MAP_UNITS[i].endswith("/V") else speed),
                )
                for i in ESTIMATED_MAP
            ),
            equation="Omega_ss = c0 + c1 U + c2 sqrt(u) + c3 u + c4 U sqrt(u)",
            sentence="the motors' steady speed is another function of command and voltage",
            manoeuvre="a slow ramp of the throttle with a full and with a nearly empty pack",
            channels=MOTOR_CHANNELS,
        ),
    )


NOT_IDENTIFIED = {
    "motor_saturation": NotIdentified("the simulated flight controller limits its commands to the motors' range"),
}
