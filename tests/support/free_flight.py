"""Flights for the physics tests: the shipped vehicle, and two compiled loops that all tests share.

Compiling takes longer than flying, so every test uses `coast` (physics under constant motor commands) or `fly` (rate
loop and physics, in stretches of STRETCH ticks).
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.configuration import configuration_folder, load
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.physics import contact, integrators
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.simulation import simulator

LEVEL = (0.0, 0.0, 0.0, 1.0)
STRETCH = 25  # ticks of one compiled call


@cache
def vehicle() -> Vehicle:
    """Return the shipped vehicle with drag and zero gyroscopic moment only; other terms have their own tests."""
    shipped = load(Vehicle, configuration_folder() / "drone.yaml")
    terms = {name: shipped.terms[name] for name in ("rotor_drag", "body_drag")}
    one_branch = replace(shipped.battery, rc2_resistance=0.0, rc2_time=0.0)
    return replace(shipped, terms={**terms, "rotor_gyroscopic": {"inertia": 0.0}}, battery=one_branch)


@cache
def track() -> Track:
    """Return the shipped track."""
    return load(Track, configuration_folder() / "track.yaml")


def parameters(dtype=None, **changes):
    """Return the vehicle's parameters with `changes`, which may be dicts for rotors, motors, battery and terms."""
    built = parameters_from_vehicle(vehicle(), dtype)
    for name, value in changes.items():
        if isinstance(value, dict):
            inner = built.terms[name] if name in built.terms else getattr(built, name)
            value = replace(inner, **{key: jnp.asarray(entry, dtype=built.mass.dtype) for key, entry in value.items()})
        else:
            value = jnp.asarray(value, dtype=built.mass.dtype)
        if name in built.terms:
            built = replace(built, terms={**built.terms, name: value})
        else:
            built = replace(built, **{name: value})
    return built


def in_vacuum(**changes):
    """Return the parameters without drag and without battery sag."""
    stiff = {"open_circuit_slope": 0.0, "resistance": 0.0, "rc_resistance": 0.0}
    return parameters(**{"rotor_drag": {"k_d": 0.0}, "body_drag": {"c": np.zeros(3)}, "battery": stiff, **changes})


def profile(dtype=None, **changes):
    """Return the vehicle's firmware profile with `changes` to its entries."""
    return replace(profile_from_vehicle(vehicle(), dtype), **changes)


def world(dtype=None):
    """Return what the vehicle can collide with on the shipped track."""
    return contact.world_from_track(track(), vehicle().hull_height, dtype)


def at(p_world=(0.0, 0.0, 50.0), q_world_body=LEVEL, dtype=None, **changes):
    """Return a State at rest with `changes` to its entries."""
    state = simulator.initial_flight(jnp.asarray(p_world, dtype=dtype), jnp.asarray(q_world_body, dtype=dtype)).state
    return replace(state, **{name: jnp.asarray(value, dtype=dtype) for name, value in changes.items()})


@partial(jax.jit, static_argnames="integrator")
def _coast(state, motor_command, parameters, dt, steps, integrator):
    def step(_, carry):
        return integrators.step(carry[0], motor_command, parameters, dt, integrators.INTEGRATORS[integrator])

    zero = jnp.zeros_like(state.charge)
    return jax.lax.fori_loop(0, steps, step, (state, zero, zero))


def coast(state, motor_command, parameters, dt, steps, integrator="rk4"):
    """Return (state, voltage, current) after `steps` steps under fixed motor commands (4,)."""
    dtype = parameters.mass.dtype
    # One array type and dtype: otherwise NumPy, JAX and plain numbers would each compile the loop again.
    state, motor_command = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), dtype), (state, motor_command))
    return _coast(state, motor_command, parameters, dt, steps, integrator)


@jax.jit
def _stretch(flight, setpoints, throttles, armed, model):
    def tick(flight, command):
        return simulator.advance(flight, ReceiverFrame(command[0], command[1], armed), model)

    return jax.lax.scan(tick, flight, (setpoints, throttles))


def fly(flight, setpoints, throttles, model: simulator.FlightModel, armed=True):
    """Return (flight, trace) after a sequence of commands.

    Args:
        flight: Flight or State (...) at the start.
        setpoints: (ticks, ..., 3) rad/s.
        throttles: (ticks, ...), 0..1.
        model: parameters, firmware profile and world.
        armed: the flight controller is armed.

    Returns:
        The flight at the end, and the trace with leading axes (ticks, substeps).
    """
    if isinstance(flight, simulator.State):
        flight = simulator.Flight(flight, simulator.initial_loop_state(flight.omega_body))
    dtype = flight.state.p_world.dtype
    setpoints, throttles = jnp.asarray(setpoints, dtype=dtype), jnp.asarray(throttles, dtype=dtype)
    setpoints, throttles = jnp.broadcast_arrays(setpoints, throttles[..., None])
    throttles, traces = throttles[..., 0], []
    for start in range(0, len(throttles), STRETCH):
        piece = slice(start, start + STRETCH)
        flight, trace = _stretch(flight, setpoints[piece], throttles[piece], armed, model)
        traces.append(jax.tree.map(np.asarray, trace))
    return flight, jax.tree.map(lambda *pieces: np.concatenate(pieces), *traces)


def steady(setpoint, throttle, ticks):
    """Return the commands of `ticks` ticks with one rate setpoint (3,) and throttle."""
    return np.broadcast_to(np.asarray(setpoint, dtype=float), (ticks, 3)), np.full(ticks, float(throttle))


def thrust_of(rotor_speed):
    """Return the collective thrust (...) N of the shipped rotors at (..., 4) rad/s."""
    return vehicle().thrust_coefficient * np.sum(np.asarray(rotor_speed) ** 2, axis=-1)
