"""One tick of the flying vehicle, rate loop and physics together: what the bridge runs once and training in batches."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.rate_loop.loop import (
    RateLoopState,
    hear_voltage,
    initial_loop_state,
    take_frame,
)
from swift_sim_bridge.flight_controller.rate_loop.substeps import motor_command as loop_command
from swift_sim_bridge.flight_controller.rate_loop.substeps import steps_of_old_frame
from swift_sim_bridge.physics import contact
from swift_sim_bridge.physics.integrators import INTEGRATORS, pushed_attitude, step_unstacked
from swift_sim_bridge.physics.state import State, stacked, state_at_rest, unstacked
from swift_sim_bridge.physics.terms import command_path
from swift_sim_bridge.physics.terms.vectors import Vector, parts, rotate_inverse, stack, subtract
from swift_sim_bridge.physics.trace import Trace


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Flight:
    """The vehicle's state, its rate loop's memory, and the commands under way where they take time."""

    state: State
    loop: RateLoopState
    line: command_path.CommandQueue | None = None


def initial_flight(p_world, q_world_body, rotors: int = 4, profile=None, parameters=None, key=None) -> Flight:
    """Return the flight of a vehicle at rest at p_world (..., 3), q_world_body (..., 4), its pack full.

    profile: of the rate loop that will fly it, or None where it is a plain one, as a vehicle file's own keys describe;
    parameters: of the vehicle, needed where its terms remember (gusts, a slung load, late commands); key: of chance.
    """
    state = state_at_rest(p_world, q_world_body, rotors, parameters, key)
    line = command_path.start({} if parameters is None else parameters.terms, state.charge, key)
    return Flight(state, initial_loop_state(state.omega_body, profile), line)


def _substep(flight, now, command, parameters, profile, world, dt, integrator, gyro_gain):
    """Return (flight, Trace) a sub-step later; the flight's state is by components."""
    setpoint_omega_body, throttle, armed = command
    gyro_noise, time = now
    if flight.line is not None:
        *rates, throttle = command_path.received(flight.line, time)
        setpoint_omega_body = stack(rates)
    before = flight.state
    omega_body = stack(before.omega_body)
    gyro = omega_body if gyro_gain is None else jnp.sum(gyro_gain * omega_body[..., None, :], axis=-1)
    gyro = gyro if gyro_noise is None else gyro + gyro_noise
    loop, motor_command = loop_command(
        flight.loop, setpoint_omega_body, throttle, gyro, omega_body, profile, dt, stack(before.rotor_speed)
    )
    motor_command = jnp.where(armed[..., None], motor_command, 0.0)
    state, trace = move(before, motor_command, parameters, world, dt, integrator)
    return Flight(state, hear_voltage(loop, trace.voltage, profile, dt), flight.line), trace


def move(before, motor_command, parameters, world, dt, integrator):
    """Return (state, Trace) after `dt` s of physics under motor commands (..., n) in 0..1; states by components (see
    `physics.vectors`); world: None where nothing can be hit."""
    state, voltage, current = step_unstacked(before, parts(motor_command), parameters, dt, integrator)
    after = stacked(state)
    if world is None:
        touched = contact.no_contact(after.p_world)
    else:
        after, touched = contact.resolve(after, parameters, world, dt)
        state = unstacked(after)
    x, y, z = (change / dt for change in subtract(state.v_world, before.v_world))
    specific_force_world = Vector(x, y, z + parameters.gravity)
    pushed = pushed_attitude(before.q_world_body, state.q_world_body, integrator)
    trace = Trace(
        p_world=after.p_world,
        q_world_body=after.q_world_body,
        v_world=after.v_world,
        omega_body=after.omega_body,
        specific_force_body=stack(rotate_inverse(pushed, specific_force_world)),
        rotor_speed=after.rotor_speed,
        motor_command=motor_command,
        voltage=voltage,
        current=current,
        contact=touched,
    )
    return state, trace


def advance(
    flight: Flight,
    setpoint_omega_body,
    throttle,
    armed,
    parameters,
    profile,
    world=None,
    substeps: int = 5,
    dt: float = 0.002,
    gyro_noise=None,
    integrator: str = "semi_implicit_euler",
    gyro_gain=None,
    sticks=None,
):
    """Return (flight, Trace) after one tick of `substeps` passes of the rate loop, each followed by `dt` s of physics.

    setpoint_omega_body (..., 3) rad/s; throttle (...) 0..1, 0 = closed; armed (...) bool: disarmed motors stop;
    world: `contact.World`, or None to fly where nothing can be hit; gyro_noise: None or (substeps, ..., 3) rad/s added
    to what the loop measures; integrator: a name of `integrators.INTEGRATORS`; gyro_gain: None or (..., 3, 3), what the
    loop's gyro reads of the true rates; sticks: `stick_path.Sticks` of the setpoint, or None. Pure: jit it with
    substeps, dt and integrator static.
    """
    armed, before = jnp.asarray(armed), flight.state
    setpoint_omega_body, throttle = command_path.bend(setpoint_omega_body, throttle, parameters.terms)
    line = _sent(flight.line, setpoint_omega_body, throttle, parameters.terms, substeps * dt)
    if line is not None:
        *rates, throttle = command_path.received(line, 0.0)
        setpoint_omega_body = stack(rates)
    one = partial(
        _substep,
        parameters=parameters,
        profile=profile,
        world=world,
        dt=dt,
        integrator=INTEGRATORS[integrator],
        gyro_gain=gyro_gain,
    )

    times = None if line is None else dt * jnp.arange(substeps, dtype=before.charge.dtype)

    def stretch(flight, command, begin, end):
        now = jax.tree.map(lambda rows: rows[begin:end], (gyro_noise, times))
        return jax.lax.scan(partial(one, command=command), flight, now, length=end - begin)

    held, kept = steps_of_old_frame(profile, dt, substeps), []
    flight = Flight(unstacked(before), flight.loop, line)
    if held:
        old = (flight.loop.terms["held_setpoint"], flight.loop.terms["held_throttle"], armed)
        flight, trace = stretch(flight, old, 0, held)
        kept.append(trace)
    new = (setpoint_omega_body, throttle, armed)
    flight = Flight(flight.state, take_frame(flight.loop, *new, profile, sticks), line)
    flight, trace = stretch(flight, new, held, substeps)
    line = None if line is None else command_path.hold(line, (substeps - 1) * dt)
    flight = Flight(stacked(flight.state), flight.loop, line)
    return flight, jax.tree.map(lambda *parts: jnp.concatenate(parts), *kept, trace) if kept else trace


def _sent(line, setpoint_omega_body, throttle, terms: dict, tick_s: float):
    """Return the line with the command on it, None where no command can be late.

    Raises UsageError when the flight was made without the line that the terms need.
    """
    if not set(command_path.LATE) & set(terms):
        return None
    if line is None:
        raise UsageError("a flight without a command line cannot fly late commands; make it with the parameters given")
    return command_path.send(line, setpoint_omega_body, throttle, terms, tick_s)
