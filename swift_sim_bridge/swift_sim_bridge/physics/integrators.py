"""One step of the whole vehicle. Rotors and battery move by their exact solutions, the body by a chosen integrator.

Supply voltage, motor commands and the memory of the terms (such as gusts) are constant during a step; the rotors' speed
within it is known exactly. The order of an integrator is therefore that of the body: 1 for `semi_implicit_euler`, 2 for
`exponential`, 4 for `rk4`. Attitudes are quaternions, so no attitude is singular.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics import battery, motors, rigid_body
from swift_sim_bridge.physics.state import BATTERY, Parameters, stacked, unstacked
from swift_sim_bridge.physics.terms import registry, vectors
from swift_sim_bridge.physics.terms.motion import CompletedStep, Instant, hubs_of
from swift_sim_bridge.physics.terms.quantities import Load
from swift_sim_bridge.physics.terms.vectors import Quaternion, Vector, add, kept, parts, rotate_inverse, scale, subtract


class Body(NamedTuple):
    """The rigid body's part of `State` by components, or its time derivative."""

    p_world: Vector
    q_world_body: Quaternion
    v_world: Vector
    omega_body: Vector


class Evaluation(NamedTuple):
    """The first evaluation of the forces in a step.

    Attributes:
        instant: at which the forces were evaluated.
        specific_force_world: m/s^2, of all forces but gravity and attached loads.
    """

    instant: Instant
    specific_force_world: Vector


class Drive(NamedTuple):
    """Inputs of the rigid body during a step.

    Attributes:
        speeds: function of the time s into the step that returns the n rotor speeds.
        targets: n steady rotor speeds.
        parameters: of the vehicle.
        memory: of the terms.
    """

    speeds: Callable
    targets: tuple
    parameters: Parameters
    memory: dict

    def at(self, body: Body, time) -> Instant:
        """Return the instant `time` s into the step."""
        air = registry.air_velocity(body.p_world, self.memory, self.parameters)
        v_body = kept(rotate_inverse(body.q_world_body, subtract(body.v_world, air)), self.parameters)
        speed = kept(self.speeds(time), self.parameters)
        acceleration = motors.accelerations(speed, self.targets, self.parameters.motors)
        turning = (speed, acceleration, hubs_of(self.parameters.rotors))
        return Instant(body.p_world, body.q_world_body, v_body, body.omega_body, *turning, self.memory)

    def rates(self, body: Body, time, coasting: bool = True):
        """Return (dv_world/dt, domega_body/dt, Evaluation); `coasting`: see `rigid_body.turn_acceleration`."""
        instant = self.at(body, time)
        force_body, moment = registry.wrench_at(instant, self.parameters)
        specific_force = rigid_body.specific_force(force_body, instant.q_world_body, self.parameters)
        specific_force, moment = kept((specific_force, moment), self.parameters)
        x, y, z = add(specific_force, registry.tow_acceleration(specific_force, self.memory, self.parameters))
        turning = rigid_body.turn_acceleration(body.omega_body, moment, self.parameters, coasting)
        return Vector(x, y, z - self.parameters.gravity), turning, Evaluation(instant, specific_force)


def semi_implicit_euler(body: Body, drive: Drive, dt) -> tuple[Body, Evaluation]:
    """Return (body after `dt` s, first Evaluation): new velocities, then the pose with the new velocities.

    The attitude advances by the exponential map.
    """
    v_rate, omega_rate, evaluation = drive.rates(body, 0.5 * dt)
    v_world = add(body.v_world, scale(dt, v_rate))
    omega_body = add(body.omega_body, scale(dt, omega_rate))
    q_world_body = vectors.turned(body.q_world_body, omega_body, dt)
    return Body(add(body.p_world, scale(dt, v_world)), q_world_body, v_world, omega_body), evaluation


def rk4(body: Body, drive: Drive, dt) -> tuple[Body, Evaluation]:
    """Return (body after `dt` s, first Evaluation) by the classical Runge-Kutta method, the quaternion normalised."""

    def rate(at: Body, time):
        v_rate, omega_rate, evaluation = drive.rates(at, time)
        turn = Quaternion(*at.omega_body, jnp.zeros_like(at.omega_body.x))
        q_rate = Quaternion(*(0.5 * value for value in vectors.multiply(at.q_world_body, turn)))
        return Body(at.v_world, q_rate, v_rate, omega_rate), evaluation

    def moved(by: Body, time):
        return jax.tree.map(lambda value, slope: value + time * slope, body, by)

    k1, first = rate(body, 0.0)
    k2, _ = rate(moved(k1, 0.5 * dt), 0.5 * dt)
    k3, _ = rate(moved(k2, 0.5 * dt), 0.5 * dt)
    k4, _ = rate(moved(k3, dt), dt)
    mean = jax.tree.map(lambda a, b, c, d: (a + 2.0 * b + 2.0 * c + d) / 6.0, k1, k2, k3, k4)
    body = moved(mean, dt)
    return body._replace(q_world_body=vectors.normalize(body.q_world_body)), first


def exponential(body: Body, drive: Drive, dt) -> tuple[Body, Evaluation]:
    """Return (body after `dt` s, first Evaluation): half a step of free motion, a kick by all forces, the other half.

    Free motion rotates by the exponential map and conserves the angular momentum in the world to rounding, at any
    inertia; the kick is a midpoint step, because drag depends on velocity. Strang splitting, of order 2; without
    velocity-dependent forces it is symmetric in time, so that energy does not drift.
    """
    body = _coast(body, 0.5 * dt, drive.parameters)

    def kicked(by, time):
        v_world, omega_body = add(body.v_world, scale(time, by[0])), add(body.omega_body, scale(time, by[1]))
        return body._replace(v_world=v_world, omega_body=kept(omega_body, drive.parameters))

    *early, first = drive.rates(body, 0.5 * dt, coasting=False)
    *middle, _ = drive.rates(kicked(early, 0.5 * dt), 0.5 * dt, coasting=False)
    return _coast(kicked(middle, dt), 0.5 * dt, drive.parameters), first


def _coast(body: Body, dt, parameters) -> Body:
    """Return the body after `dt` s without forces: constant velocity, constant angular momentum in the world.

    The rotation uses the rates at the middle, which are those of the momentum rotated half way: found by iteration.
    """
    momentum = vectors.apply(parameters.inertia, body.omega_body)
    middle = body.omega_body
    for _ in range(3):
        half_turn = vectors.exponential(scale(0.5 * dt, middle))
        middle = kept(vectors.apply(parameters.inertia_inverse, rotate_inverse(half_turn, momentum)), parameters)
    half_turn = kept(vectors.exponential(scale(0.5 * dt, middle)), parameters)
    turned = rotate_inverse(half_turn, rotate_inverse(half_turn, momentum))
    omega_body = kept(vectors.apply(parameters.inertia_inverse, turned), parameters)
    q_world_body = vectors.normalize(vectors.multiply(vectors.multiply(body.q_world_body, half_turn), half_turn))
    return Body(add(body.p_world, scale(dt, body.v_world)), q_world_body, body.v_world, omega_body)


INTEGRATORS = {"semi_implicit_euler": semi_implicit_euler, "exponential": exponential, "rk4": rk4}


def pushed_attitude(before: Quaternion, after: Quaternion, integrator) -> Quaternion:
    """Return the attitude at which the mean force of a step acted.

    For semi-implicit Euler this is the attitude at the start; for the others the one halfway, to second order.
    """
    if integrator is semi_implicit_euler:
        return before
    return vectors.normalize(Quaternion(*(p + q for p, q in zip(before, after, strict=True))))


def step(state, motor_command, parameters, dt, integrator=semi_implicit_euler):
    """Return (state after `dt` s, voltage (...) V, current (...) A) under motor commands (..., n) in 0..1."""
    state, voltage, current = step_unstacked(unstacked(state), parts(motor_command), parameters, dt, integrator)
    return stacked(state), voltage, current


def step_unstacked(state, motor_commands, parameters, dt, integrator=semi_implicit_euler):
    """Return the same for a state by components (see `state.unstacked`) and n motor commands (...).

    Raises UsageError when the state lacks the memory of a term.
    """
    memory = state.memory
    registry.check_memory(memory, parameters)
    torque, pack = parts(parameters.rotors.torque_coefficient), memory.get(BATTERY)
    power_w = battery.power_of(state.rotor_speed, torque, parameters.battery)
    voltage, current = battery.voltage_and_current(power_w, state.charge, state.rc_voltage, parameters.battery, pack)
    added = registry.supply_voltage(Load(current, state.charge, state.rotor_speed), parameters)
    voltage, current = battery.with_added_voltage(voltage, current, power_w, added)
    charge, rc_voltage = battery.discharge(state.charge, state.rc_voltage, current, dt, parameters.battery)
    motor_commands, voltage = kept((motor_commands, voltage), parameters)
    targets = motors.steady_speeds(motor_commands, voltage, parameters.motors)
    for factors in registry.motor_factors(memory, parameters):
        targets = tuple(factor * target for factor, target in zip(factors, targets, strict=True))
    targets = tuple(
        map(vectors.plus, targets, registry.added_speeds(state.rotor_speed, motor_commands, voltage, parameters))
    )
    targets = kept(targets, parameters)

    def speeds(time):
        return motors.lag(state.rotor_speed, targets, time, parameters.motors)

    drive = Drive(speeds, targets, parameters, memory)
    body = Body(state.p_world, state.q_world_body, state.v_world, state.omega_body)
    body, first = integrator(body, drive, dt)
    if memory:
        completed = CompletedStep(first.instant, first.specific_force_world, dt, power_w)
        memory = registry.advance_memory(memory, completed, parameters)
        if pack:
            memory[BATTERY] = battery.advance_memory(pack, power_w, current, dt, parameters.battery)
    moved = replace(
        state,
        **body._asdict(),
        rotor_speed=speeds(dt),
        charge=charge,
        rc_voltage=rc_voltage,
        memory=memory,
    )
    return moved, voltage, current
