"""The pilot of the referee's quadrotor: position, velocity and attitude loops at 100 Hz, and a rate loop below them.

The rate loop is the vehicle file's `rate_pid`, with nominal values and at the reference voltage:

    torque = J (kp e + ki sum(e) dt - kd d) + gyro x J gyro,   e = commanded rate - gyro,   d = low-passed d(gyro)/dt
    d += (gyro's change / dt - d) dt / (dt + 1 / (2 pi d_cutoff_hz))
    (T_1 .. T_n) = A^-1 (m c, torque), where A holds the hubs' positions, and c_d / c_l for yaw

Torque has priority: the thrust differences are scaled down to the rotors' range of thrust, then the collective is
changed until all thrusts are in range. Omega_i = sqrt(T_i / c_l), and u_i from the motor map, between `idle` and 1.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.referee.simulator.plant import GRAVITY, State
from swift_sim_bridge.referee.simulator.vectors import (
    add,
    cross,
    dot,
    parts,
    rotate,
    rotate_back,
    scale,
    subtract,
    times,
)

MIN_UPWARD = 0.3 * GRAVITY  # commanded upward specific force; above zero, so that the vehicle never turns over to sink


class Aim(NamedTuple):
    """Reference of the path.

    Attributes:
        p, v, a: position m, velocity m/s and acceleration m/s^2, world.
        yaw: heading, rad.
        yaw_rate: rad/s.
        shake: rates, rad/s, body, that are added to the commanded rates to excite all axes.
    """

    p: tuple
    v: tuple
    a: tuple
    yaw: object
    yaw_rate: object
    shake: tuple


class Loop(NamedTuple):
    """Memory of the rate loop.

    Attributes:
        integral: integral of the rate error, rad.
        derivative: low-passed derivative of the gyro, rad/s^2.
        gyro: last gyro sample, rad/s.
    """

    integral: tuple
    derivative: tuple
    gyro: tuple


def controls_of(content: dict) -> dict:
    """Return the parameters of pilot and rate loop for a vehicle file's content: arrays by name."""
    given, count = content["controller"], len(content["rotors"])
    inertia = np.asarray(content["inertia"], dtype=float)
    position = np.array([rotor["position"] for rotor in content["rotors"]], dtype=float)
    turn_way = np.array([rotor["spin"] for rotor in content["rotors"]], dtype=float)
    lift, voltage = content["thrust_coefficient"], content["battery"]["reference_voltage"]
    mixer = np.stack(
        [np.ones(count), position[:, 1], -position[:, 0], -turn_way * content["torque_coefficient"] / lift]
    )
    c = content["motor"]["map"]["coefficients"]
    floor = c[0] + c[1] * voltage
    speeds = [
        np.clip(floor + (c[2] + c[4] * voltage) * np.sqrt(u) + c[3] * u, *content["rotor_speed_range"])
        for u in (given["idle"], 1.0)
    ]
    return {
        "mass": content["mass"],
        "inertia": np.diag(inertia) if inertia.ndim == 1 else inertia,
        "allocation": np.linalg.pinv(mixer),
        "lift": lift,
        "thrust": np.array([lift * speed**2 for speed in speeds]),
        "top": count * lift * speeds[1] ** 2 / content["mass"],
        "map": np.array([floor, c[2] + c[4] * voltage, c[3]]),
        "idle": given["idle"],
        **{name: np.asarray(given[name], dtype=float) for name in ("rate_kp", "rate_ki", "rate_kd", "d_cutoff_hz")},
        **{name: given[name] for name in ("position_kp", "velocity_kp", "attitude_kp", "max_thrust")},
        "rates": np.asarray(content["rates"]["max"], dtype=float),
    }


def command(state: State, aim: Aim, controls: dict):
    """Return the commanded rates (rad/s, body) and collective thrust (m/s^2)."""
    toward = limited(scale(controls["position_kp"] / controls["velocity_kp"], subtract(aim.p, state.p)), 6.0)
    wanted = add(aim.a, limited(scale(controls["velocity_kp"], subtract(add(aim.v, toward), state.v)), 20.0))
    upwards = jnp.maximum(wanted[2] + GRAVITY, MIN_UPWARD)
    wanted = rotate_back(state.q, (wanted[0], wanted[1], upwards))
    across = jnp.sqrt(wanted[0] ** 2 + wanted[1] ** 2 + 1e-12)
    gain = controls["attitude_kp"] * jnp.arctan2(across, wanted[2]) / across
    ahead, up = rotate(state.q, (1.0, 0.0, 0.0)), rotate(state.q, (0.0, 0.0, 1.0))
    off = jnp.cos(aim.yaw) * ahead[1] - jnp.sin(aim.yaw) * ahead[0]  # sine of the heading's error, small when steep
    yaw = (aim.yaw_rate - 3.0 * off) * jnp.maximum(up[2], 0.0)
    rates = add((-gain * wanted[1], gain * wanted[0], yaw), aim.shake)
    rates = tuple(jnp.clip(rate, -limit, limit) for rate, limit in zip(rates, parts(controls["rates"]), strict=True))
    return rates, jnp.clip(wanted[2], 0.15 * GRAVITY, controls["max_thrust"])


def limited(a, longest):
    """Return a vector, scaled down to a length of at most `longest`."""
    return scale(jnp.minimum(1.0, longest / jnp.sqrt(dot(a, a) + 1e-12)), a)


def distorted_command(rates, thrust, controls: dict, terms: dict):
    """Return the command as the rate loop receives it: with the terms `rate_scale` and `throttle_curve`."""
    error = terms["rate_scale"]
    rates = tuple(
        error["scale"][i] * rates[i] + error["offset"][i] + error["cubic"][i] * rates[i] ** 3 for i in range(3)
    )
    throttle, curve = thrust / controls["top"], terms["throttle_curve"]
    throttle = (1.0 + curve["gain"]) * throttle + curve["curve"] * throttle * (1.0 - throttle)
    return rates, controls["top"] * jnp.clip(throttle, 0.0, 1.0)


def motor_commands(loop: Loop, gyro, rates, thrust, controls: dict, dt: float) -> tuple[Loop, tuple]:
    """Run one pass of the rate loop: return its memory and the motor commands (n values, 0 to 1)."""
    error = subtract(rates, gyro)
    integral = add(loop.integral, scale(dt, error))
    keep = dt / (dt + 1.0 / (2.0 * jnp.pi * controls["d_cutoff_hz"]))
    raw = scale(1.0 / dt, subtract(gyro, loop.gyro))
    derivative = add(loop.derivative, scale(keep, subtract(raw, loop.derivative)))
    turning = tuple(
        controls["rate_kp"][i] * error[i]
        + controls["rate_ki"][i] * integral[i]
        - controls["rate_kd"][i] * derivative[i]
        for i in range(3)
    )
    torque = add(times(controls["inertia"], turning), cross(gyro, times(controls["inertia"], gyro)))
    u = tuple(command_of(one, controls) for one in thrusts(controls["mass"] * thrust, torque, controls))
    return Loop(integral, derivative, gyro), u


def thrusts(collective, torque, controls: dict) -> tuple:
    """Return the rotors' thrusts (N) for a collective (N) and a torque (N m); the torque has priority."""
    low, high = controls["thrust"]
    count = range(len(controls["allocation"]))
    apart = [sum(controls["allocation"][i][1 + j] * torque[j] for j in range(3)) for i in count]
    mean = [controls["allocation"][i][0] * collective for i in count]
    span = largest(apart) + largest([-one for one in apart])
    fit = jnp.minimum(1.0, (high - low) / jnp.maximum(span, 1e-9))
    apart = [fit * one for one in apart]
    both = [a + b for a, b in zip(apart, mean, strict=True)]
    lift = jnp.maximum(low + largest([-one for one in both]), 0.0)
    lift = lift - jnp.maximum(largest(both) - high, 0.0)
    return tuple(one + lift for one in both)


def largest(values):
    """Return the element-wise maximum of several arrays."""
    top = values[0]
    for value in values[1:]:
        top = jnp.maximum(top, value)
    return top


def command_of(thrust, controls: dict):
    """Return the motor command whose steady speed, at the reference voltage, gives this thrust (N)."""
    speed = jnp.sqrt(jnp.maximum(thrust, 0.0) / controls["lift"])
    floor, root, linear = controls["map"]
    missing = jnp.maximum(speed - floor, 0.0)
    # the larger root of linear r^2 + root r = missing, in the form that also holds where linear is 0
    r = 2.0 * missing / jnp.maximum(root + jnp.sqrt(root**2 + 4.0 * linear * missing), 1e-9)
    return jnp.clip(r**2, controls["idle"], 1.0)
