"""Flights simulated on from measured states for a second, under the motors that the recorded commands drive."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter1d

from swift_ros import geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.sensor_correction import correct
from swift_sim_bridge.residual_models import gaussian_process, nearest_neighbors
from swift_sim_bridge.sensors.terms import sensor_terms

EVERY_S = 0.5
START_S = 0.005  # over which the measured state is averaged from which a rollout starts


class BlackBox(NamedTuple):
    """A black box on (v_body, omega_body, collective thrust per mass): see `residuals`; `nearest`: 1 or 0."""

    inputs: np.ndarray
    scale: np.ndarray
    targets: np.ndarray
    nearest: float


class Start(NamedTuple):
    """w rollouts: p_world, q_world_body, v_world, omega_body (w, ...), rotor_speed (s + 1, w, n) rad/s at each step."""

    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray
    rotor_speed: np.ndarray


def black_box_inputs(v_body, omega_body, rotor_speed, vehicle: Vehicle) -> np.ndarray:
    """Return what a black box hears (n, 7)."""
    collective = vehicle.thrust_coefficient * np.sum(rotor_speed**2, axis=-1, keepdims=True) / vehicle.mass
    return np.concatenate([v_body, omega_body, collective], axis=-1)


def answered(box: BlackBox, heard):
    """Return what a black box adds to the specific force (m, 3) m/s^2, by what it hears (m, 7): see `boxed_inputs`."""
    apart = (heard / box.scale)[:, None, :] - box.inputs
    squared = jnp.sum(apart * apart, axis=-1)
    weights = jnp.where(box.nearest > 0, nearest_neighbors.weights(squared), gaussian_process.weights(squared))
    return jnp.sum(weights[..., None] * box.targets, axis=1)


class Trajectories(NamedTuple):
    """Rollouts of v vehicles from w states: the recorded positions and the flown ones (v, s + 1, w, 3) m, at the start
    and after each of s steps. What was recorded differs where the vehicles' sensors do."""

    recorded: np.ndarray
    flown: np.ndarray

    def errors(self, steps) -> np.ndarray:
        """Return the distance (v, w, h) m between the two after so many steps (h,)."""
        return np.moveaxis(np.linalg.norm(self.flown[:, steps] - self.recorded[:, steps], axis=-1), 1, 2)


def trajectories(
    residual_model: ResidualModel,
    vehicles: list[Vehicle],
    boxes: list[BlackBox],
    begin_s: float,
    seconds: float,
    start_s: float = START_S,
) -> Trajectories:
    """Return where each vehicle with its box would have come to within `seconds` after each of w starts later than
    begin_s. The vehicles have the same terms. start_s: over which states that are measured, with noise, are averaged;
    0 for true ones, of which a mean only cuts the corners."""
    recording = residual_model.recording
    steps = int(round(seconds / recording.dt))
    first = np.searchsorted(recording.t, begin_s)
    rows = np.arange(first, len(recording.t) - steps - 1, max(1, round(EVERY_S / recording.dt)))
    whole = recording.good
    if recording.motor_record is not None:
        whole = whole & ~recording.in_gap("motor_command", "voltage")
    rows = np.array([row for row in rows if whole[row : row + steps + 1].all()], dtype=int)
    if not len(rows):
        none = np.empty((len(vehicles), steps + 1, 0, 3))
        return Trajectories(none, none)
    parameters = physics_replay.stack_parameters(vehicles)
    speeds = _speeds(recording, parameters)
    starts, there = [], []
    for vehicle, speed in zip(vehicles, speeds, strict=True):
        corrected = correct(recording, sensor_terms(vehicle))
        p, q, v, _ = corrected.moving
        q, v, omega = (
            gaussian_filter1d(part, start_s / recording.dt, axis=0) if start_s else part
            for part in (q, v, corrected.gyro_body)
        )
        starts.append(
            Start(
                p[rows], geometry.normalize(q)[rows], v[rows], omega[rows], speed[rows + np.arange(steps + 1)[:, None]]
            )
        )
        there.append(p[rows + np.arange(steps + 1)[:, None]])
    start = Start(*(np.stack(parts) for parts in zip(*starts, strict=True)))
    box = BlackBox(*(np.stack(parts) for parts in zip(*boxes, strict=True)))
    flown = np.asarray(_flown(parameters, start, box, recording.dt))
    return Trajectories(np.stack(there), np.concatenate([start.p_world[:, None], flown], axis=1))


def _speeds(recording, parameters) -> np.ndarray:
    """Return rotor speeds (v, n, r) on the recording's grid: as the commands drive them, else as measured."""
    if recording.motor_record is None:
        return np.broadcast_to(recording.rotor_speed, (len(parameters.mass), *recording.rotor_speed.shape))
    replayed = physics_replay.rotor_speeds(parameters, recording.motor_record)
    return np.stack(
        [
            np.stack([np.interp(recording.t, recording.motor_record.t, rotor) for rotor in one.T], axis=-1)
            for one in replayed
        ]
    )


@jax.jit
def _flown(parameters, start: Start, box: BlackBox, dt):
    """Return the positions (v, s, w, 3) after each step."""
    return jax.vmap(_flown_by_one, in_axes=(0, 0, 0, None))(parameters, start, box, dt)


def _flown_by_one(parameters, start: Start, box: BlackBox, dt):
    def rates(p, q, v_world, omega, speed, spin_up):
        inputs = (p, q, v_world, omega, speed, spin_up)
        force, turn = physics_replay.specific_force_and_turn(parameters, inputs)
        v_body = geometry.rotate_inverse(q, v_world)
        collective = jnp.sum(parameters.rotors.thrust_coefficient * speed * speed, axis=-1, keepdims=True)
        force = force + answered(box, jnp.concatenate([v_body, omega, collective / parameters.mass], axis=-1))
        gravity = jnp.array([0.0, 0.0, 1.0]) * parameters.gravity
        return geometry.rotate(q, force) - gravity, turn

    def step(body, speeds):
        p, q, v, omega = body
        before, after = speeds
        spin_up = (after - before) / dt
        a, turn = rates(p, q, v, omega, before, spin_up)
        middle_omega = omega + 0.5 * dt * turn
        middle_q = _turned(q, omega, 0.5 * dt)
        middle_speed = 0.5 * (before + after)
        a, turn = rates(p + 0.5 * dt * v, middle_q, v + 0.5 * dt * a, middle_omega, middle_speed, spin_up)
        body = (p + dt * v + 0.5 * dt * dt * a, _turned(q, middle_omega, dt), v + dt * a, omega + dt * turn)
        return body, body[0]

    pairs = (start.rotor_speed[:-1], start.rotor_speed[1:])
    return jax.lax.scan(step, (start.p_world, start.q_world_body, start.v_world, start.omega_body), pairs)[1]


def _turned(q, omega, dt):
    return geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(dt * omega))
