"""One tick of the flying vehicle: rate loop and physics together.

The bridge runs one vehicle, training runs batches of them. No ROS.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_ros.errors import UsageError
from swift_sim_bridge.flight_controller.rate_loop.loop import (
    LoopInput,
    RateLoopState,
    initial_loop_state,
    take_frame,
    take_voltage,
)
from swift_sim_bridge.flight_controller.rate_loop.profile import RateLoopProfile
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.flight_controller.rate_loop.substeps import mean_motor_command, steps_of_old_frame
from swift_sim_bridge.physics import contact
from swift_sim_bridge.physics.integrators import INTEGRATORS, pushed_attitude, step_unstacked
from swift_sim_bridge.physics.state import Parameters, State, stacked, state_at_rest, unstacked
from swift_sim_bridge.physics.terms import command_path
from swift_sim_bridge.physics.terms.vectors import Vector, parts, rotate_inverse, stack, subtract
from swift_sim_bridge.physics.trace import Trace


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Flight:
    """What changes during a flight.

    Attributes:
        state: the vehicle's state.
        loop: memory of the rate loop.
        command_queue: commands that have not reached the flight controller yet; None where none can be late.
    """

    state: State
    loop: RateLoopState
    command_queue: command_path.CommandQueue | None = None


class FlightModel(NamedTuple):
    """What does not change during a flight: the vehicle, its rate loop and its surroundings.

    Attributes:
        parameters: physical parameters of the vehicle.
        profile: profile of the rate loop.
        world: podium, ground and gates; None to fly without obstacles.
        gyro_gain: (..., 3, 3), factor from true rates to what the rate loop's gyro measures; None for the identity.
    """

    parameters: Parameters
    profile: RateLoopProfile
    world: contact.World | None = None
    gyro_gain: jax.Array | None = None


class Stepping(NamedTuple):
    """Time steps of a tick, as plain numbers that are fixed when the tick is compiled.

    Attributes:
        substeps: physics steps in a tick.
        dt: s of one physics step.
        integrator: a name of `integrators.INTEGRATORS`.
    """

    substeps: int = 5
    dt: float = 0.002
    integrator: str = "semi_implicit_euler"


TICK_STEPPING = Stepping()  # one control tick of 10 ms


def initial_flight(p_world, q_world_body, rotors: int = 4, profile=None, parameters=None, key=None) -> Flight:
    """Return the flight of a vehicle at rest with a full battery.

    Args:
        p_world: (..., 3) m.
        q_world_body: (..., 4), x y z w.
        rotors: number of rotors.
        profile: profile of the rate loop; None for a loop without optional terms.
        parameters: parameters of the vehicle; needed when its terms have memory (gusts, a slung load, late commands).
        key: JAX random key of the terms' random numbers.
    """
    state = state_at_rest(p_world, q_world_body, rotors, parameters, key)
    queue = command_path.start({} if parameters is None else parameters.terms, state.charge, key)
    return Flight(state, initial_loop_state(state.omega_body, profile), queue)


def _substep(flight: Flight, step_input, frame: ReceiverFrame, model: FlightModel, stepping: Stepping):
    """Return (flight, Trace) one sub-step later; the flight's state is by components.

    `step_input` is (gyro noise (..., 3) rad/s or None, s since the start of the tick or None).
    """
    gyro_noise, time = step_input
    setpoint_omega_body, throttle = frame.setpoint_omega_body, frame.throttle
    if flight.command_queue is not None:
        *rates, throttle = command_path.received(flight.command_queue, time)
        setpoint_omega_body = stack(rates)
    before, dt = flight.state, stepping.dt
    omega_body = stack(before.omega_body)
    gyro = omega_body if model.gyro_gain is None else jnp.sum(model.gyro_gain * omega_body[..., None, :], axis=-1)
    gyro = gyro if gyro_noise is None else gyro + gyro_noise
    measured = LoopInput(setpoint_omega_body, throttle, gyro, stack(before.rotor_speed))
    loop, motor_command = mean_motor_command(flight.loop, measured, omega_body, model.profile, dt)
    motor_command = jnp.where(frame.armed[..., None], motor_command, 0.0)
    integrator = INTEGRATORS[stepping.integrator]
    state, trace = move(before, motor_command, model.parameters, model.world, dt, integrator)
    return Flight(state, take_voltage(loop, trace.voltage, model.profile, dt), flight.command_queue), trace


def move(before, motor_command, parameters, world, dt, integrator):
    """Run one step of physics.

    Args:
        before: state by components (see `physics.terms.vectors`).
        motor_command: (..., n), 0 to 1.
        parameters: parameters of the vehicle.
        world: `contact.World`; None to fly without obstacles.
        dt: s.
        integrator: a function of `integrators.INTEGRATORS`.

    Returns:
        (state by components, Trace).
    """
    state, voltage, current = step_unstacked(before, parts(motor_command), parameters, dt, integrator)
    if world is None:
        touched = contact.no_contact(state.charge)
    else:
        state, touched = contact.resolve(state, parameters, world, dt)
    after = stacked(state)
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
    flight: Flight, frame: ReceiverFrame, model: FlightModel, stepping: Stepping = TICK_STEPPING, gyro_noise=None
) -> tuple[Flight, Trace]:
    """Fly one tick: sub-steps of one run of the rate loop and one step of physics each.

    Call it inside a compiled function, with plain numbers in `stepping`.

    Args:
        flight: the flight before the tick.
        frame: command of the tick.
        model: vehicle, rate loop and surroundings.
        stepping: number and length of the sub-steps.
        gyro_noise: (substeps, ..., 3) rad/s added to what the rate loop measures; None for none.

    Returns:
        (flight, Trace with a leading axis of sub-steps).

    Raises:
        UsageError: the vehicle's terms need memory with which the flight was not made.
    """
    frame, queue = _frame_in_force(frame._replace(armed=jnp.asarray(frame.armed)), flight, model, stepping)
    before, substeps = flight.state, stepping.substeps
    times = None if queue is None else stepping.dt * jnp.arange(substeps, dtype=before.charge.dtype)

    def fly_substeps(flight, frame, begin, end):
        step_inputs = jax.tree.map(lambda rows: rows[begin:end], (gyro_noise, times))
        substep = partial(_substep, frame=frame, model=model, stepping=stepping)
        return jax.lax.scan(substep, flight, step_inputs, length=end - begin)

    old_steps, traces = steps_of_old_frame(model.profile, stepping.dt, substeps), []
    flight = Flight(unstacked(before), flight.loop, queue)
    if old_steps:
        held = flight.loop.terms["held_setpoint"], flight.loop.terms["held_throttle"]
        flight, trace = fly_substeps(flight, ReceiverFrame(*held, frame.armed), 0, old_steps)
        traces.append(trace)
    flight = Flight(flight.state, take_frame(flight.loop, frame, model.profile), queue)
    flight, trace = fly_substeps(flight, frame, old_steps, substeps)
    queue = None if queue is None else command_path.hold(queue, (substeps - 1) * stepping.dt)
    flight = Flight(stacked(flight.state), flight.loop, queue)
    return flight, jax.tree.map(lambda *rows: jnp.concatenate(rows), *traces, trace) if traces else trace


def _frame_in_force(frame: ReceiverFrame, flight: Flight, model: FlightModel, stepping: Stepping):
    """Return (frame that acts at the start of the tick, queue with this tick's command)."""
    terms = model.parameters.terms
    setpoint_omega_body, throttle = command_path.distort(frame.setpoint_omega_body, frame.throttle, terms)
    queue = _sent(flight.command_queue, setpoint_omega_body, throttle, terms, stepping.substeps * stepping.dt)
    if queue is not None:
        *rates, throttle = command_path.received(queue, 0.0)
        setpoint_omega_body = stack(rates)
    return frame._replace(setpoint_omega_body=setpoint_omega_body, throttle=throttle), queue


def _sent(queue, setpoint_omega_body, throttle, terms: dict, tick_s: float):
    """Return the queue with one more command, None where no command can be late.

    Raises UsageError when the terms need a queue and the flight was made without one.
    """
    if not set(command_path.QUEUED) & set(terms):
        return None
    if queue is None:
        raise UsageError("a flight without a command queue cannot fly late commands; make it with the parameters given")
    return command_path.send(queue, setpoint_omega_body, throttle, terms, tick_s)
