"""Reference flights: the vehicle as its file describes it, flown along the recorded path and measured like it.

What the pipeline finds in them is its own bias, because nothing is missing from the model. Each of them flies a
slightly different path, and a controller of the gap tool flies any vehicle, with the recorded rates as feed-forward.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from swift_ros import geometry
from swift_ros.recording.flight_channels import CHANNELS
from swift_ros.recording.flight_table import FlightTable, RowSampling, Samples
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.nominal.noise_sheet import estimate_noise_sheet
from swift_sim_bridge.gap.nominal.tracking_controller import Setpoint, controller_for, tracking_command
from swift_sim_bridge.gap.recording.command_rows import command_rows_of, loop_interval_s
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.parallel import run_in_threads
from swift_sim_bridge.physics.integrators import rk4, step
from swift_sim_bridge.physics.state import parameters_from_vehicle, state_at_rest
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.motion import Motion
from swift_sim_bridge.physics.terms.vectors import stack, vector
from swift_sim_bridge.physics.trace import Trace
from swift_sim_bridge.sensors.recording import record

DEVIATION_M, DEVIATION_SHARE = 0.4, 0.08  # largest deviation from the path: metres, and share of the path's extent
DEVIATION_HZ = 0.1, 0.4  # frequencies of the deviation, slow against the manoeuvres
BLEND_S = 2.0  # time in which the deviation begins, so that it adds no jerk
SMOOTHING_S = 0.06  # standard deviation of the Gaussian filter on the recorded path
MARGIN = 5.0  # times SMOOTHING_S at each end of the recording that are not flown: there the filter distorts the path
MAX_STEP_S = 0.005  # longest time step of the simulation
MIN_STEP_S = 0.002  # shortest, unless the recording's rows are denser; bounds the computing time
NO_PROCESS_NOISE = np.zeros(6)
BLOCK = 512  # number of time steps is padded to a multiple, so that flights of other lengths are rarely compiled anew
PROCESS_NOISE_HZ = 10.0  # bandwidth of the random force and moment, near that of the residuals' filter, 12 Hz


@dataclass(frozen=True)
class FlightPath:
    """The paths of b vehicles.

    Attributes:
        t: (n,) s, uniform.
        p_world: (n, b, 3) m.
        v_world: (n, b, 3) m/s.
        a_world: (n, b, 3) m/s^2.
        q_world_body: (n, b, 4).
        omega_body: (n, b, 3) rad/s.
    """

    t: np.ndarray
    p_world: np.ndarray
    v_world: np.ndarray
    a_world: np.ndarray
    q_world_body: np.ndarray
    omega_body: np.ndarray


def motion_along(p_world, yaw, step_s: float, rotation=None) -> tuple[np.ndarray, ...]:
    """Return position, velocity, acceleration, attitude and body rates (n, ...) of a flight with thrust along body z.

    Args:
        p_world: (n, 3) m.
        yaw: (n,) rad.
        step_s: time between two rows.
        rotation: (n, 3) rad, rotation vector of an additional rotation of the body.
    """
    v = np.gradient(p_world, step_s, axis=0)
    a = np.gradient(v, step_s, axis=0)
    up = geometry.normalize(a + [0.0, 0.0, GRAVITY])
    left = geometry.normalize(np.cross(up, np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)))
    q = geometry.quaternion_from_matrix(np.stack([np.cross(left, up), left, up], axis=2))
    if rotation is not None:
        q = geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(rotation))
    turn = geometry.quaternion_multiply(geometry.quaternion_conjugate(q[:-1]), q[1:])
    omega = geometry.rotation_vector_from_quaternion(turn) / step_s
    return p_world, v, a, q, np.concatenate([omega, omega[-1:]])


def reference_path(recording: Recording, step_s: float, count: int, seed: int) -> FlightPath:
    """Return the recorded path every step_s s for `count` vehicles, each with its own random deviation."""
    margin_s = MARGIN * SMOOTHING_S
    t = np.arange(recording.t[0] + margin_s, recording.t[-1] - margin_s, step_s)
    rng = np.random.default_rng([seed, 11])

    def at(values):
        # A spline: straight lines between the rows have jerks at each row, which the motors would have to follow.
        smooth = gaussian_filter1d(values, SMOOTHING_S / recording.dt, axis=0, mode="nearest")
        return CubicSpline(recording.t, smooth)(t)

    p = at(recording.p_world)[:, None]
    hz, phase = rng.uniform(*DEVIATION_HZ, (count, 3)), rng.uniform(0, 2 * np.pi, (count, 3))
    share = np.clip((t - t[0]) / BLEND_S, 0.0, 1.0)[:, None, None]
    size = min(DEVIATION_M, DEVIATION_SHARE * float(np.sqrt(np.sum(np.var(p, axis=0)))))
    amplitude = share**2 * (3.0 - 2.0 * share) * size * rng.uniform(0.3, 1.0, (count, 3))
    p = p + amplitude * np.sin(2 * np.pi * hz * t[:, None, None] + phase)
    v = np.gradient(p, step_s, axis=0)
    a = np.gradient(v, step_s, axis=0)
    q, omega = (
        np.broadcast_to(at(values)[:, None], (len(t), count, values.shape[1]))
        for values in (_without_sign_flips(recording.q_world_body), recording.gyro_body)
    )
    return FlightPath(t, p, v, a, geometry.normalize(q), omega)


def _without_sign_flips(q):
    """Return quaternions (n, 4) without jumps between q and -q."""
    flips = np.cumsum(np.concatenate([[False], np.sum(q[1:] * q[:-1], axis=1) < 0])) % 2
    return q * np.where(flips, -1.0, 1.0)[:, None]


def fly(
    vehicle: Vehicle, path: FlightPath, gyro_noise: float = 0.0, seed: int = 0, process_noise_std=NO_PROCESS_NOISE
) -> list[Trace]:
    """Return the motion (n, ...) of each vehicle that tracks the path.

    Args:
        vehicle: the vehicle.
        path: path of each of b vehicles.
        gyro_noise: standard deviation of the gyro that the rate loop reads, rad/s.
        seed: seed of gyro noise and process noise.
        process_noise_std: (6,) standard deviations of the random force, m/s^2, and moment, rad/s^2, in the body frame.
    """
    count, rotors = path.p_world.shape[1], len(vehicle.rotors)
    parameters = registry.with_flight_terms(parameters_from_vehicle(vehicle))
    state = state_at_rest(
        jnp.asarray(path.p_world[0]), jnp.asarray(path.q_world_body[0]), rotors, parameters, jax.random.key(seed)
    )
    dtype, hover = state.charge.dtype, np.sqrt(vehicle.mass * GRAVITY / (rotors * vehicle.thrust_coefficient))
    state = replace(
        state,
        v_world=jnp.asarray(path.v_world[0]),
        omega_body=jnp.asarray(path.omega_body[0]),
        rotor_speed=jnp.full((count, rotors), hover, dtype),
    )
    noise, dt = gyro_noise_samples(path, gyro_noise, seed), path.t[1] - path.t[0]
    disturbance = np.zeros((len(path.t), count, 6))
    if np.any(process_noise_std):
        disturbance = process_noise_std * np.moveaxis(unit_process_noise((count, 6, len(path.t)), dt, seed), -1, 0)
    rows = (path.p_world, path.v_world, path.a_world, path.q_world_body, path.omega_body, noise, disturbance)
    more = -len(path.t) % BLOCK
    rows = tuple(np.concatenate([row, np.repeat(row[-1:], more, axis=0)]).astype(dtype) for row in rows)
    flown = [
        np.asarray(part, dtype=float)[: len(path.t)]
        for part in _fly(state, rows, parameters, controller_for(vehicle, dtype), float(dt))
    ]
    return [Trace(*(part[:, i] for part in flown)) for i in range(count)]


def gyro_noise_samples(path: FlightPath, gyro_noise: float, seed: int) -> np.ndarray:
    """Return the noise (n, b, 3) rad/s of the gyros that the vehicles' rate loops read."""
    return gyro_noise * np.random.default_rng([seed, 12]).standard_normal((len(path.t), path.p_world.shape[1], 3))


def measure(path: FlightPath, trace: Trace, noise, vehicle: Vehicle, rng) -> FlightTable:
    """Return the flight table of a flight along a path.

    The recorded gyro is the one that the rate loop read: the loop reacts to its noise, and in a quiet flight an
    independent noise would make that reaction look like physics.

    Args:
        path: gives the times.
        trace: motion of the vehicle.
        noise: (n, 3) rad/s, see `gyro_noise_samples`.
        vehicle: gives the other sensors' errors.
        rng: random generator.
    """
    noise_free_gyro = replace(
        vehicle, sensors={key: sigma for key, sigma in vehicle.sensors.items() if key != "gyro_rad_s"}
    )
    table = record(path.t, trace, noise_free_gyro, rng)
    gyro = table["gyro_body"]
    return replace(table, channels={**table.channels, "gyro_body": Samples(gyro.t, gyro.values + noise)})


def unit_process_noise(shape, dt: float, seed: int) -> np.ndarray:
    """Return noise of variance 1 along the last axis of `shape`, first-order low-passed at PROCESS_NOISE_HZ."""
    keep = np.exp(-2 * np.pi * PROCESS_NOISE_HZ * dt)
    white = np.random.default_rng([seed, 15]).standard_normal(shape)
    white[..., 1:] *= np.sqrt(1.0 - keep**2)
    return lfilter([1.0], [1.0, -keep], white)


@partial(jax.jit, static_argnames="dt")
def _fly(state, rows, parameters, controller, dt):
    """Return the fields of `Trace`, (n, b, ...)."""

    def one(carried, row):
        (state, voltage), (*setpoint, disturbance) = carried, row
        command = tracking_command(state, voltage, Setpoint(*setpoint), parameters, controller)
        state, voltage, current = step(state, command, parameters, dt, rk4)
        force, moment = disturbance[..., :3], disturbance[..., 3:]
        state = replace(
            state,
            v_world=state.v_world + dt * geometry.rotate(state.q_world_body, force),
            omega_body=state.omega_body + dt * moment,
        )
        *motion, specific_force, rotor_speed = _sensed(state, parameters)
        return (state, voltage), (*motion, specific_force + force, rotor_speed, command, voltage, current)

    full = jnp.broadcast_to(parameters.battery.open_circuit_full, state.charge.shape)
    return jax.lax.scan(one, (state, full), rows)[1]


def _sensed(state, parameters):
    """Return position, attitude, velocity, body rates, specific force and rotor speeds (b, ...) of a state."""
    air = registry.air_velocity(vector(state.p_world), state.memory, parameters)
    v_body = geometry.rotate_inverse(state.q_world_body, state.v_world - stack(air, like=state.charge))
    no_acceleration = jnp.zeros_like(state.rotor_speed)
    motion = Motion(state.p_world, state.q_world_body, v_body, state.omega_body, state.rotor_speed, no_acceleration)
    force, _ = registry.wrench(motion, parameters, state.memory)
    return (
        state.p_world,
        state.q_world_body,
        state.v_world,
        state.omega_body,
        force / parameters.mass[..., None],
        state.rotor_speed,
    )


def reference_tables(
    traces: list[Trace], path: FlightPath, table: FlightTable, vehicle: Vehicle, seed: int, noisy: bool = True
) -> list[FlightTable]:
    """Return flights along a path as the sensors of a recording measure them: its channels at its rates.

    Args:
        traces: motion of each vehicle.
        path: path of each vehicle.
        table: the recording.
        vehicle: the vehicle as its file describes it.
        seed: seed of the noise.
        noisy: whether the sensors have noise.
    """
    sheet = estimate_noise_sheet(table, vehicle) if noisy else {}
    measuring = replace(vehicle, sensors=sheet)
    noise = gyro_noise_samples(path, sheet.get("gyro_rad_s", 0.0), seed)

    def measured(i, trace):
        dense = measure(path, trace, noise[:, i], measuring, np.random.default_rng([seed, 13, i]))
        channels = {}
        for name in (name for name in CHANNELS if name in table and name in dense):
            stride = max(1, round(dense[name].rate_hz / table[name].rate_hz))
            values = dense[name].values[::stride]
            if name == "rotor_speed" and np.all(table[name].values == table[name].values[:, :1]):
                values = np.broadcast_to(np.sqrt(np.mean(values**2, axis=1, keepdims=True)), values.shape)
            channels[name] = Samples(dense[name].t[::stride], values)
        name = f"reference flight {i + 1} of {table.name}"
        loop = {"motor_command": RowSampling("held", loop_hz=1.0 / (path.t[1] - path.t[0]))}
        return FlightTable(name, channels, skips_commands=table.skips_commands, sampling=loop)

    return run_in_threads(*(partial(measured, i, trace) for i, trace in enumerate(traces)))


def time_step(table: FlightTable, vehicle: Vehicle) -> float:
    """Return the time step s of the simulation: a whole part of the recording's smallest.

    It is below MAX_STEP_S, and where motor commands have slower rows than the loop, near that of the loop: commands
    between the rows are then simulated, and lost, as in the recording.
    """
    densest, longest = 1.0 / max(samples.rate_hz for samples in table.channels.values()), MAX_STEP_S
    if "motor_command" in table and command_rows_of(table["motor_command"], None, loop_interval_s(vehicle)):
        longest = max(loop_interval_s(vehicle) or MAX_STEP_S, MIN_STEP_S)
    return densest / int(np.ceil(densest / longest - 0.01))
