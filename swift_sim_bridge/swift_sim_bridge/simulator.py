"""One tick of the flying vehicle, rate loop and physics together: what the bridge runs once and training in batches."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from swift_ros import geometry
from swift_sim_bridge.flight_controller.rate_loop import RateLoopState, initial_loop_state, rate_loop_step
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


def initial_flight(p_world, q_world_body, rotors: int = 4) -> Flight:
    """Return the flight of a vehicle at rest at p_world (..., 3), q_world_body (..., 4), its pack full."""
    state = state_at_rest(p_world, q_world_body, rotors)
    return Flight(state, initial_loop_state(state.omega_body))


def _substep(flight, gyro_noise, command, parameters, profile, world, dt, integrator, gyro_gain):
    setpoint_omega_body, throttle, armed = command
    before = flight.state
    gyro = before.omega_body if gyro_gain is None else jnp.sum(gyro_gain * before.omega_body[..., None, :], axis=-1)
    gyro = gyro if gyro_noise is None else gyro + gyro_noise
    loop, motor_command = rate_loop_step(flight.loop, setpoint_omega_body, throttle, gyro, profile, dt)
    motor_command = jnp.where(armed[..., None], motor_command, 0.0)
    state, voltage, current = step(before, motor_command, parameters, dt, integrator)
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
):
    """Return (flight, Trace) after one tick of `substeps` passes of the rate loop, each followed by `dt` s of physics.

    setpoint_omega_body (..., 3) rad/s; throttle (...) 0..1, 0 = closed; armed (...) bool: disarmed motors stop;
    world: `contact.World`, or None to fly where nothing can be hit; gyro_noise: None or (substeps, ..., 3) rad/s added
    to what the loop measures; integrator: a name of `integrators.INTEGRATORS`; gyro_gain: None or (..., 3, 3), what the
    loop's gyro reads of the true rates. Pure: jit it with substeps, dt and integrator static.
    """
    command = (setpoint_omega_body, throttle, jnp.asarray(armed))
    one = partial(
        _substep,
        command=command,
        parameters=parameters,
        profile=profile,
        world=world,
        dt=dt,
        integrator=INTEGRATORS[integrator],
        gyro_gain=gyro_gain,
    )
    return jax.lax.scan(one, flight, gyro_noise, length=substeps)
