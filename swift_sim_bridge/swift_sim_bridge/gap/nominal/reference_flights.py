"""Nominal twins: the vehicle as its file has it, flown along the recording's own path and measured by its instruments.

What the pipeline finds in them it invents. An outer loop of the tool's own flies any vehicle, whatever flew the
recording: it tracks the recorded path, slightly bent anew for each twin, with the recorded rates ahead.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from swift_ros import geometry
from swift_ros.recording.flight_channels import CHANNELS
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.recording.rate_pid import rate_pid_from_vehicle
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.physics.integrators import rk4, step
from swift_sim_bridge.physics.rigid_body import apply
from swift_sim_bridge.physics.state import parameters_from_vehicle, state_at_rest
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.motion import Motion
from swift_sim_bridge.physics.terms.vectors import stack, vector
from swift_sim_bridge.physics.trace import Trace
from swift_sim_bridge.sensors.recording import record

BENT_M, BENT_SHARE = 0.4, 0.08  # by which a twin's path is bent: so far, or this share of how far the path reaches
STRAIGHT_S = 2.0  # from the start, in which it leaves the recorded path: a jolt would be none of the recording's
PATH_S = 0.06  # over which the recorded path is smoothed
EDGE = 5.0  # times that, by which a twin's flight begins later and ends earlier: there the smoothing jolts
SLOWEST_STEP_S = 0.005
POSITION, VELOCITY = 5.0, 3.5  # gains, 1/s^2 and 1/s
ATTITUDE, RATE = np.array([9.0, 9.0, 3.0]), np.array([22.0, 22.0, 8.0])  # gains by axis, 1/s: yaw is weak; the rate
# gains where the vehicle file has none
LEAST_COMMAND = 0.02
NO_PROCESS_NOISE = np.zeros(6)
FEWEST = 20  # samples that tell of their noise
UNREST_HZ = 10.0  # up to which a vehicle is pushed by chance
SHEET = {
    "p_world": "position_m",
    "v_world": "velocity_m_s",
    "q_world_body": "attitude_rad",
    "gyro_body": "gyro_rad_s",
    "specific_force_body": "accel_m_s2",
    "rotor_speed": "rotor_relative",
    "voltage": "vbat_v",
    "current": "ibat_a",
}
DOUBT = 2.0  # the recording's noise may be so many times what the sheet says, or so much less


@dataclass(frozen=True)
class FlightPath:
    """What to fly: t (n,) s, and (n, b, ...) position, velocity, acceleration in the world, attitude, body rates."""

    t: np.ndarray
    p_world: np.ndarray
    v_world: np.ndarray
    a_world: np.ndarray
    q_world_body: np.ndarray
    omega_body: np.ndarray


def motion_along(p_world, yaw, step_s: float, shake=None) -> tuple[np.ndarray, ...]:
    """Return position, velocity, acceleration, attitude and body rates (n, ...) of a flight along p_world (n, 3) m.

    A row every step_s s, the thrust along the body's z axis; yaw (n,) rad; shake (n, 3) rad: a turn of the body on top.
    """
    v = np.gradient(p_world, step_s, axis=0)
    a = np.gradient(v, step_s, axis=0)
    up = geometry.normalize(a + [0.0, 0.0, GRAVITY])
    left = geometry.normalize(np.cross(up, np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)))
    q = geometry.quaternion_from_matrix(np.stack([np.cross(left, up), left, up], axis=2))
    if shake is not None:
        q = geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(shake))
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(q[:-1]), q[1:])
    omega = geometry.rotation_vector_from_quaternion(turn) / step_s
    return p_world, v, a, q, np.concatenate([omega, omega[-1:]])


def reference_path(recording: Recording, step_s: float, count: int, seed: int) -> FlightPath:
    """Return the recording's path every step_s s for `count` vehicles, each bent in its own way."""
    t = np.arange(recording.t[0] + EDGE * PATH_S, recording.t[-1] - EDGE * PATH_S, step_s)
    rng = np.random.default_rng([seed, 11])

    def at(values):
        smooth = gaussian_filter1d(values, PATH_S / recording.dt, axis=0, mode="nearest")
        return np.stack([np.interp(t, recording.t, column) for column in smooth.T], axis=-1)

    p = at(recording.p_world)[:, None]
    hz, phase = rng.uniform(0.1, 0.4, (count, 3)), rng.uniform(0, 2 * np.pi, (count, 3))
    share = np.clip((t - t[0]) / STRAIGHT_S, 0.0, 1.0)[:, None, None]
    bent = min(BENT_M, BENT_SHARE * float(np.sqrt(np.sum(np.var(p, axis=0)))))
    away = share**2 * (3.0 - 2.0 * share) * bent * rng.uniform(0.3, 1.0, (count, 3))
    p = p + away * np.sin(2 * np.pi * hz * t[:, None, None] + phase)
    v = np.gradient(p, step_s, axis=0)
    a = np.gradient(v, step_s, axis=0)
    q, omega = (
        np.broadcast_to(at(values)[:, None], (len(t), count, values.shape[1]))
        for values in (_continuous(recording.q_world_body), recording.gyro_body)
    )
    return FlightPath(t, p, v, a, geometry.normalize(q), omega)


def _continuous(q):
    flips = np.cumsum(np.concatenate([[False], np.sum(q[1:] * q[:-1], axis=1) < 0])) % 2
    return q * np.where(flips, -1.0, 1.0)[:, None]


def fly(
    vehicle: Vehicle, path: FlightPath, gyro_noise: float = 0.0, seed: int = 0, unrest=NO_PROCESS_NOISE
) -> list[Trace]:
    """Return what happens (n, ...) to each vehicle that tracks the path; its loop's gyro has this noise, rad/s.

    unrest (6,): standard deviations of what pushes, m/s^2, and turns it, rad/s^2, about its axes by chance.
    """
    count, rotors = path.p_world.shape[1], len(vehicle.rotors)
    parameters = registry.with_flight_terms(parameters_from_vehicle(vehicle))
    state = state_at_rest(
        jnp.asarray(path.p_world[0]), jnp.asarray(path.q_world_body[0]), rotors, parameters, jax.random.key(seed)
    )
    hover = np.sqrt(vehicle.mass * GRAVITY / (rotors * vehicle.thrust_coefficient))
    state = replace(
        state,
        v_world=jnp.asarray(path.v_world[0]),
        omega_body=jnp.asarray(path.omega_body[0]),
        rotor_speed=jnp.full((count, rotors), hover, state.charge.dtype),
    )
    noise = gyro_noise_samples(path, gyro_noise, seed)
    pushed = unrest * np.moveaxis(unit_process_noise((count, 6, len(path.t)), path.t[1] - path.t[0], seed), -1, 0)
    rows = (path.p_world, path.v_world, path.a_world, path.q_world_body, path.omega_body, noise, pushed)
    rows = tuple(np.asarray(row, dtype=state.charge.dtype) for row in rows)
    loop = rate_pid_from_vehicle(vehicle)
    gains = jnp.asarray(RATE if loop is None else loop.kp, state.charge.dtype)
    flown = _fly(state, rows, parameters, jnp.asarray(_allocation(vehicle)), gains, float(path.t[1] - path.t[0]))
    flown = [np.asarray(part, dtype=float) for part in flown]
    return [Trace(*(part[:, i] for part in flown)) for i in range(count)]


def gyro_noise_samples(path: FlightPath, gyro_noise: float, seed: int) -> np.ndarray:
    """Return the noise (n, b, 3) rad/s of the gyros by which vehicles fly along a path."""
    return gyro_noise * np.random.default_rng([seed, 12]).standard_normal((len(path.t), path.p_world.shape[1], 3))


def measure(path: FlightPath, trace: Trace, noise, vehicle: Vehicle, rng) -> FlightTable:
    """Return what instruments write of a flight along a path. noise (n, 3): of the gyro that the loop read, which is
    the one that is recorded: the loop answers to its noise, and where little else moves that answer looks like
    physics."""
    quiet = replace(vehicle, sensors={key: size for key, size in vehicle.sensors.items() if key != "gyro_rad_s"})
    table = record(path.t, trace, quiet, rng)
    gyro = table["gyro_body"]
    return replace(table, channels={**table.channels, "gyro_body": Samples(gyro.t, gyro.values + noise)})


def unit_process_noise(shape, dt: float, seed: int) -> np.ndarray:
    """Return noise of variance 1 along the last axis of `shape`, first-order low-passed at UNREST_HZ."""
    keep = np.exp(-2 * np.pi * UNREST_HZ * dt)
    white = np.random.default_rng([seed, 15]).standard_normal(shape)
    white[..., 1:] *= np.sqrt(1.0 - keep**2)
    return lfilter([1.0], [1.0, -keep], white)


def _allocation(vehicle: Vehicle) -> np.ndarray:
    """Return the matrix (n, 4) from thrust and moments to the rotors' squared speeds."""
    position, spin = (np.array([getattr(rotor, key) for rotor in vehicle.rotors]) for key in ("position", "spin"))
    lift, torque = vehicle.thrust_coefficient, vehicle.torque_coefficient
    effect = np.stack([np.full(len(spin), lift), lift * position[:, 1], -lift * position[:, 0], -torque * spin])
    return np.linalg.pinv(effect)


@partial(jax.jit, static_argnames="dt")
def _fly(state, rows, parameters, allocation, gains, dt):
    def one(carried, row):
        (state, voltage), (*row, pushed) = carried, row
        command = _command(state, voltage, row, parameters, allocation, gains)
        state, voltage, current = step(state, command, parameters, dt, rk4)
        push, twist = pushed[..., :3], pushed[..., 3:]
        state = replace(
            state,
            v_world=state.v_world + dt * geometry.rotate(state.q_world_body, push),
            omega_body=state.omega_body + dt * twist,
        )
        *seen, force, spun = _seen(state, parameters)
        return (state, voltage), (*seen, force + push, spun, command, voltage, current)

    full = jnp.broadcast_to(parameters.battery.open_circuit_full, state.charge.shape)
    return jax.lax.scan(one, (state, full), rows)[1]


def _seen(state, parameters):
    """Return pose, velocity, rates, specific force at this instant, and rotor speeds."""
    air = registry.air_velocity(vector(state.p_world), state.memory, parameters)
    v_body = geometry.rotate_inverse(state.q_world_body, state.v_world - stack(air, like=state.charge))
    still = jnp.zeros_like(state.rotor_speed)
    motion = Motion(state.p_world, state.q_world_body, v_body, state.omega_body, state.rotor_speed, still)
    force, _ = registry.wrench(motion, parameters, state.memory)
    return (
        state.p_world,
        state.q_world_body,
        state.v_world,
        state.omega_body,
        force / parameters.mass[..., None],
        state.rotor_speed,
    )


def _command(state, voltage, row, parameters, allocation, gains):
    """Return motor commands (b, n) that take the vehicle along the path; gains (3,) of the rate loop, 1/s."""
    p, v, a, q, omega, noise = row
    up = jnp.array([0.0, 0.0, 1.0], p.dtype)
    wanted = a + POSITION * (p - state.p_world) + VELOCITY * (v - state.v_world) + GRAVITY * up
    ups = jnp.broadcast_to(up, p.shape)
    wanted_up = geometry.normalize(wanted)
    recorded_up = geometry.rotate(q, ups)
    axis = geometry.cross(recorded_up, wanted_up)
    turn = jnp.concatenate([axis, 1.0 + jnp.sum(recorded_up * wanted_up, axis=-1, keepdims=True)], axis=-1)
    q_wanted = geometry.quaternion_multiply(geometry.normalize(turn), q)
    apart = geometry.quaternion_multiply(geometry.quaternion_conjugate(state.q_world_body), q_wanted)
    apart = apart * jnp.where(apart[..., 3:] < 0, -1.0, 1.0)
    rates = omega + 2.0 * ATTITUDE.astype(p.dtype) * apart[..., :3]
    now = state.omega_body
    momentum = apply(parameters.inertia, now)
    moment = apply(parameters.inertia, gains * (rates - now - noise)) + geometry.cross(now, momentum)
    collective = parameters.mass * jnp.sum(wanted * geometry.rotate(state.q_world_body, ups), axis=-1, keepdims=True)
    collective = jnp.maximum(collective, 0.1 * parameters.mass * GRAVITY)
    squared = apply(allocation, jnp.concatenate([collective, moment], axis=-1))
    low, high = parameters.motors.min_speed, parameters.motors.max_speed
    speed = jnp.sqrt(jnp.clip(squared, low * low, high * high))
    c0, c1, c2, c3, c4 = parameters.motors.map_coefficients
    volts = voltage[..., None]
    half, rest = 0.5 * (c2 + c4 * volts), jnp.maximum(speed - c0 - c1 * volts, 0.0)
    root = rest / (half + jnp.sqrt(half * half + c3 * rest))
    return jnp.clip(root * root, LEAST_COMMAND, 1.0)


def estimate_noise_sheet(table: FlightTable, vehicle: Vehicle) -> dict:
    """Return the noise sheet of the recording: its own noise, told by sixth differences, within what the file's sheet
    leaves in doubt."""
    sheet = dict(vehicle.sensors)
    sheet.pop("vibration_m_s2", None)
    for channel, key in SHEET.items():
        if channel not in table:
            sheet.pop(key, None)
            continue
        values = table[channel].values.reshape(len(table[channel].t), -1)
        if len(values) < FEWEST:
            continue
        if channel == "rotor_speed":  # whose noise goes with the speed
            values = np.log(np.maximum(values, 1.0))
        rough = np.diff(values, 6, axis=0) / np.sqrt(924.0)
        sigma = float(np.median([1.4826 * np.median(np.abs(column)) for column in rough.T]))
        if channel == "q_world_body":
            sigma *= 2.0 * np.sqrt(4.0 / 3.0)  # three angles, halved, over four components
        known = vehicle.sensors.get(key)
        if channel == "specific_force_body" and known is not None:
            known = float(np.hypot(known, vehicle.sensors.get("vibration_m_s2", 0.0)))
        sheet[key] = float(np.clip(sigma, known / DOUBT, known * DOUBT)) if known else sigma
    return sheet


def reference_tables(
    traces: list[Trace], path: FlightPath, table: FlightTable, vehicle: Vehicle, seed: int, noisy: bool = True
) -> list[FlightTable]:
    """Return what the recording's instruments would have written of flights along a path: its channels at its rates.
    noisy: with their noise."""
    sheet = estimate_noise_sheet(table, vehicle) if noisy else {}
    measuring, noise = replace(vehicle, sensors=sheet), gyro_noise_samples(path, sheet.get("gyro_rad_s", 0.0), seed)
    found = []
    for i, trace in enumerate(traces):
        whole = measure(path, trace, noise[:, i], measuring, np.random.default_rng([seed, 13, i]))
        channels = {}
        for name in (name for name in CHANNELS if name in table and name in whole):
            stride = max(1, round(whole[name].rate_hz / table[name].rate_hz))
            values = whole[name].values[::stride]
            if name == "rotor_speed" and np.all(table[name].values == table[name].values[:, :1]):
                values = np.broadcast_to(np.sqrt(np.mean(values**2, axis=1, keepdims=True)), values.shape)
            channels[name] = Samples(whole[name].t[::stride], values)
        found.append(FlightTable(f"twin {i + 1} of {table.name}", channels, skips_commands=table.skips_commands))
    return found


def time_step(table: FlightTable) -> float:
    """Return the time step s at which to fly: the recording's densest, at most 5 ms, a whole part of it."""
    densest = 1.0 / max(samples.rate_hz for samples in table.channels.values())
    return densest / int(np.ceil(densest / SLOWEST_STEP_S - 0.01))
