"""One step of the whole vehicle. Rotors and battery move by their exact solutions, the body by a chosen integrator.

The supply voltage and the motor command are held through a step; the rotors' speed within it is known exactly, so an
integrator's order is that of the body alone: 1 for `semi_implicit_euler`, 4 for `rk4`.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_ros import geometry
from swift_sim_bridge.physics import battery, motors, rigid_body, terms


class Body(NamedTuple):
    """The rigid body's part of `State`, or its time derivative."""

    p_world: jax.Array
    q_world_body: jax.Array
    v_world: jax.Array
    omega_body: jax.Array


def _accelerations(body: Body, rotor_speed, target, parameters):
    motion = terms.Motion(
        body.p_world,
        body.q_world_body,
        geometry.rotate_inverse(body.q_world_body, body.v_world),
        body.omega_body,
        rotor_speed,
        motors.acceleration(rotor_speed, target, parameters.motors),
    )
    force, moment = terms.wrench(motion, parameters)
    return rigid_body.accelerations(body.q_world_body, body.omega_body, force, moment, parameters)


def semi_implicit_euler(body: Body, rotor_speed_at, target, dt, parameters) -> Body:
    """Return the body after `dt` s: velocities, then with the new ones the pose, attitude by the exponential map."""
    v_rate, omega_rate = _accelerations(body, rotor_speed_at(0.5 * dt), target, parameters)
    v_world = body.v_world + dt * v_rate
    omega_body = body.omega_body + dt * omega_rate
    q_world_body = geometry.integrate_quaternion(body.q_world_body, omega_body, dt)
    return Body(body.p_world + dt * v_world, q_world_body, v_world, omega_body)


def rk4(body: Body, rotor_speed_at, target, dt, parameters) -> Body:
    """Return the body after `dt` s by the classical Runge-Kutta method, the quaternion normalised at the end."""

    def rate(at: Body, time):
        v_rate, omega_rate = _accelerations(at, rotor_speed_at(time), target, parameters)
        omega_quaternion = jnp.concatenate([at.omega_body, jnp.zeros_like(at.omega_body[..., :1])], axis=-1)
        q_rate = 0.5 * geometry.quaternion_multiply(at.q_world_body, omega_quaternion)
        return Body(at.v_world, q_rate, v_rate, omega_rate)

    def moved(by: Body, time):
        return jax.tree.map(lambda value, slope: value + time * slope, body, by)

    k1 = rate(body, 0.0)
    k2 = rate(moved(k1, 0.5 * dt), 0.5 * dt)
    k3 = rate(moved(k2, 0.5 * dt), 0.5 * dt)
    k4 = rate(moved(k3, dt), dt)
    mean = jax.tree.map(lambda a, b, c, d: (a + 2.0 * b + 2.0 * c + d) / 6.0, k1, k2, k3, k4)
    body = moved(mean, dt)
    return body._replace(q_world_body=geometry.normalize(body.q_world_body))


INTEGRATORS = {"semi_implicit_euler": semi_implicit_euler, "rk4": rk4}


def step(state, motor_command, parameters, dt, integrator=semi_implicit_euler):
    """Return (state after `dt` s, voltage (...) V, current (...) A) under motor commands (..., n) in 0..1."""
    power_w = battery.power(state.rotor_speed, parameters.rotors.torque_coefficient, parameters.battery)
    voltage, current = battery.voltage_and_current(power_w, state.charge, state.rc_voltage, parameters.battery)
    charge, rc_voltage = battery.discharge(state.charge, state.rc_voltage, current, dt, parameters.battery)
    target = motors.steady_speed(motor_command, voltage, parameters.motors)

    def rotor_speed_at(time):
        return motors.lag(state.rotor_speed, target, time, parameters.motors)

    body = Body(state.p_world, state.q_world_body, state.v_world, state.omega_body)
    body = integrator(body, rotor_speed_at, target, dt, parameters)
    moved = replace(state, **body._asdict(), rotor_speed=rotor_speed_at(dt), charge=charge, rc_voltage=rc_voltage)
    return moved, voltage, current
