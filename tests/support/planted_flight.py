"""Recorded flights of a simulated vehicle whose every coefficient is known, for the tests of what is found in them.

A controller that knows the true state follows a point whose path is a sum of sines; the recording is what the vehicle's
sensors measured.
"""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import yaml
from free_flight import profile

from swift_ros import geometry
from swift_ros.configuration import configuration_folder, load, read_yaml
from swift_ros.recording.flight_checks import checked_table
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.simulation import simulator

TICK_S, SUBSTEPS = 0.01, 5
TICKS = 3000  # of every flight: compiling costs more than flying
IDLE = 0.055
NOISE = {
    "p_world": 0.001,
    "v_world": 0.01,
    "gyro_body": 0.02,
    "specific_force_body": 0.3,
    "rotor_speed": 5.0,
    "voltage": 0.02,
    "current": 0.5,
}


@cache
def plain_file() -> Path:
    """Return a file of the shipped vehicle with drags and one branch of its pack only; tests plant other terms."""
    content = read_yaml(configuration_folder() / "drone.yaml")
    content["terms"] = {name: content["terms"][name] for name in ("rotor_drag", "body_drag")}
    content["battery"] = {key: value for key, value in content["battery"].items() if not key.startswith("rc2_")}
    file = Path(tempfile.mkdtemp()) / "drone.yaml"
    file.write_text(yaml.safe_dump(content))
    return file


@cache
def shipped() -> Vehicle:
    return load(Vehicle, plain_file())


def planted(**changes) -> Vehicle:
    """Return the shipped vehicle with changes; a dict changes the entries of a section."""
    vehicle = shipped()
    for name, value in changes.items():
        old = getattr(vehicle, name)
        if isinstance(value, dict):
            value = {**old, **value} if isinstance(old, dict) else replace(old, **value)
        vehicle = replace(vehicle, **{name: value})
    return vehicle


def target(t, size):
    """Return position, velocity and acceleration (3,) of the point to follow at time t, which reaches some 10 m/s."""

    def position(t):
        ease = 1.0 - jnp.exp(-0.5 * t)
        x = 7.0 * jnp.sin(0.9 * t) + 1.5 * jnp.sin(2.7 * t + 1.0)
        y = 7.0 * jnp.sin(0.7 * t + 0.5) + 1.5 * jnp.sin(2.3 * t)
        z = 2.5 * jnp.sin(0.8 * t) + 1.0 * jnp.sin(2.1 * t + 2.0) + 0.3 * jnp.sin(5.0 * t)
        return size * ease * jnp.stack([x, y, z]) + jnp.array([0.0, 0.0, 50.0])

    velocity = jax.jacfwd(position)
    return position(t), velocity(t), jax.jacfwd(velocity)(t)


def pilot(state, t, parameters, size):
    """Return body rates (3,) rad/s and throttle that follow the target."""
    p, v, a = target(t, size)
    wanted = a + 6.0 * (p - state.p_world) + 4.0 * (v - state.v_world) + jnp.array([0.0, 0.0, GRAVITY])
    wanted_body = geometry.rotate_inverse(state.q_world_body, wanted)
    error = geometry.cross(jnp.array([0.0, 0.0, 1.0]), geometry.normalize(wanted_body))
    yaw_rate = size * (2.0 * jnp.sin(1.1 * t) + 1.5 * jnp.sin(6.0 * t))
    rates = jnp.clip(12.0 * error, -8.0, 8.0).at[2].set(yaw_rate)
    thrust = parameters.mass * jnp.clip(wanted_body[2], 1.0, 38.0)
    speed = jnp.sqrt(thrust / jnp.sum(parameters.rotors.thrust_coefficient))
    c0, c1, c2, c3, c4 = parameters.motors.map_coefficients
    half, rest = 0.5 * (c2 + c4 * 15.5), speed - c0 - c1 * 15.5
    command = ((-half + jnp.sqrt(half * half + c3 * rest)) / c3) ** 2
    return rates, jnp.clip((command - IDLE) / (1.0 - IDLE), 0.0, 1.0)


@jax.jit
def _fly(parameters, loop_profile, size):
    start = simulator.initial_flight(jnp.array([0.0, 0.0, 50.0]), jnp.array([0.0, 0.0, 0.0, 1.0]))
    start = replace(start, state=replace(start.state, rotor_speed=jnp.full(4, 1300.0)))

    def tick(flight, k):
        rates, throttle = pilot(flight.state, k * TICK_S, parameters, size)
        model = simulator.FlightModel(parameters, loop_profile)
        stepping = simulator.Stepping(SUBSTEPS, integrator="rk4")
        return simulator.advance(flight, ReceiverFrame(rates, throttle, True), model, stepping)

    return jax.lax.scan(tick, start, jnp.arange(TICKS))[1]


def record(vehicle: Vehicle, seconds=30.0, noise=1.0, size=1.0, seed=1, name="flight") -> FlightTable:
    """Return the table of the first seconds of a flight at 500 Hz.

    Args:
        vehicle: the vehicle that flies.
        seconds: s, 30 at most.
        noise: share of NOISE.
        size: of the target's path as a share of the whole one; 0 is a hover.
        seed: of the noise.
        name: of the flight.
    """
    with jax.enable_x64(True):
        trace = _fly(parameters_from_vehicle(vehicle), profile(), size)
    flat = {
        key: np.asarray(getattr(trace, key)).reshape(-1, *np.shape(getattr(trace, key))[2:])
        for key in (
            "p_world",
            "v_world",
            "q_world_body",
            "omega_body",
            "rotor_speed",
            "motor_command",
            "voltage",
            "current",
        )
    }
    flat["gyro_body"] = flat.pop("omega_body")
    dt = TICK_S / SUBSTEPS
    acceleration = np.gradient(flat["v_world"], dt, axis=0) + [0.0, 0.0, GRAVITY]
    flat["specific_force_body"] = geometry.rotate_inverse(flat["q_world_body"], acceleration)
    for key in ("motor_command", "voltage", "current"):  # what is set at a sample's time acts until the next
        flat[key] = np.roll(flat[key], -1, axis=0)
    rng = np.random.default_rng(seed)
    rows, channels = slice(1, round(seconds / dt) - 1), {}
    t = np.arange(len(acceleration)) * dt
    for key, values in flat.items():
        measured = values + noise * NOISE.get(key, 0.0) * rng.standard_normal(values.shape)
        channels[key] = Samples(t[rows], np.maximum(measured, 0.0)[rows] if key == "rotor_speed" else measured[rows])
    return checked_table(name, channels)
