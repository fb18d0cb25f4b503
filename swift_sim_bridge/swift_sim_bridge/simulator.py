"""One tick of the flying vehicle, rate loop and physics together: what the bridge runs once and training in batches."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from swift_ros import geometry
from swift_sim_bridge.flight_controller.rate_loop import RateLoopState, hear_voltage, initial_loop_state, take_frame
from swift_sim_bridge.flight_controller.substeps import motor_command as loop_command
from swift_sim_bridge.flight_controller.substeps import steps_of_old_frame
from swift_sim_bridge.physics import contact
from swift_sim_bridge.physics.integrators import INTEGRATORS, step
from swift_sim_bridge.physics.state import State, state_at_rest


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Flight:
    """The vehicle's state and its rate loop's memory."""

    state: State
    loop: RateLoopState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trace:
    """The sub-steps of a tick, each value with a leading axis of `substeps`, taken at the end of the sub-step.

    p_world, v_world, omega_body, specific_force_body (..., 3): what an ideal accelerometer at the centre of mass reads
    (m/s^2, +9.81 on z at rest); q_world_body (..., 4); rotor_speed, motor_command (..., 4); voltage (...) V,
    current (...) A; contact.
    """

    p_world: jax.Array
    q_world_body: jax.Array
    v_world: jax.Array
    omega_body: jax.Array
    specific_force_body: jax.Array
    rotor_speed: jax.Array
    motor_command: jax.Array
    voltage: jax.Array
    current: jax.Array
    contact: contact.Contact


def initial_flight(p_world, q_world_body, rotors: int = 4, profile=None) -> Flight:
    """Return the flight of a vehicle at rest at p_world (..., 3), q_world_body (..., 4), its pack full.

    profile: of the rate loop that will fly it, or None where it is a plain one, as a vehicle file's own keys describe.
    """
    state = state_at_rest(p_world, q_world_body, rotors)
    return Flight(state, initial_loop_state(state.omega_body, profile))


def _substep(flight, gyro_noise, command, parameters, profile, world, dt, integrator, gyro_gain):
    setpoint_omega_body, throttle, armed = command
    before = flight.state
    gyro = before.omega_body if gyro_gain is None else jnp.sum(gyro_gain * before.omega_body[..., None, :], axis=-1)
    gyro = gyro if gyro_noise is None else gyro + gyro_noise
    loop, motor_command = loop_command(
        flight.loop, setpoint_omega_body, throttle, gyro, before.omega_body, profile, dt, before.rotor_speed
    )
    motor_command = jnp.where(armed[..., None], motor_command, 0.0)
    state, voltage, current = step(before, motor_command, parameters, dt, integrator)
    loop = hear_voltage(loop, voltage, profile, dt)
    if world is None:
        touched = contact.no_contact(state.p_world)
    else:
        state, touched = contact.resolve(state, parameters, world, dt)
    acceleration = (state.v_world - before.v_world) / dt
    up = jnp.asarray([0.0, 0.0, 1.0], dtype=acceleration.dtype) * parameters.gravity[..., None]
    trace = Trace(
        p_world=state.p_world,
        q_world_body=state.q_world_body,
        v_world=state.v_world,
        omega_body=state.omega_body,
        specific_force_body=geometry.rotate_inverse(state.q_world_body, acceleration + up),
        rotor_speed=state.rotor_speed,
        motor_command=motor_command,
        voltage=voltage,
        current=current,
        contact=touched,
    )
    return Flight(state, loop), trace


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
    armed = jnp.asarray(armed)
    one = partial(
        _substep,
        parameters=parameters,
        profile=profile,
        world=world,
        dt=dt,
        integrator=INTEGRATORS[integrator],
        gyro_gain=gyro_gain,
    )
    held, kept = steps_of_old_frame(profile, dt, substeps), []
    if held:
        old = (flight.loop.terms["held_setpoint"], flight.loop.terms["held_throttle"], armed)
        noise = None if gyro_noise is None else gyro_noise[:held]
        flight, trace = jax.lax.scan(partial(one, command=old), flight, noise, length=held)
        kept.append(trace)
    new = (setpoint_omega_body, throttle, armed)
    flight = Flight(flight.state, take_frame(flight.loop, *new, profile, sticks))
    noise = None if gyro_noise is None else gyro_noise[held:]
    flight, trace = jax.lax.scan(partial(one, command=new), flight, noise, length=substeps - held)
    return flight, jax.tree.map(lambda *parts: jnp.concatenate(parts), *kept, trace) if kept else trace
