"""Rollouts: open-loop simulations from measured states, with the rotor speeds that the recorded commands give."""

from collections.abc import Sequence
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

INTERVAL_S = 0.5  # time between the starts of two rollouts
START_SMOOTHING_S = 0.005  # standard deviation of the Gaussian filter on the measured start states


class BlackBox(NamedTuple):
    """A data-driven model of the residual specific force, with v samples.

    Attributes:
        inputs: (v, 7) samples of the scaled inputs, see `black_box_inputs`.
        scale: (7,) of the inputs.
        lengths: (3,) length scale of a Gaussian process on each axis, in units of the scaled inputs.
        targets: (v, 3) values or coefficients of the samples, see `residual_models`.
        nearest: 1 for nearest neighbours, 0 for a Gaussian process.
    """

    inputs: np.ndarray
    scale: np.ndarray
    lengths: np.ndarray
    targets: np.ndarray
    nearest: float


class Start(NamedTuple):
    """Start states and inputs of w rollouts over s steps.

    Attributes:
        p_world: (w, 3) m.
        q_world_body: (w, 4).
        v_world: (w, 3) m/s.
        omega_body: (w, 3) rad/s.
        rotor_speed: (s + 1, w, r) rad/s.
    """

    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray
    rotor_speed: np.ndarray


def black_box_inputs(v_body, omega_body, rotor_speed, vehicle: Vehicle) -> np.ndarray:
    """Return the inputs (n, 7) of a black box: v_body m/s, omega_body rad/s, collective thrust m/s^2."""
    collective = vehicle.thrust_coefficient * np.sum(rotor_speed**2, axis=-1, keepdims=True) / vehicle.mass
    return np.concatenate([v_body, omega_body, collective], axis=-1)


def black_box_force(box: BlackBox, inputs):
    """Return the specific force (m, 3) m/s^2 that a black box adds for inputs (m, 7), see `black_box_inputs`."""
    difference = (inputs / box.scale)[:, None, :] - box.inputs
    squared = jnp.sum(difference * difference, axis=-1)
    nearest = nearest_neighbors.weights(squared)[..., None]
    weights = jnp.where(box.nearest > 0, nearest, gaussian_process.weights(squared, box.lengths))
    return jnp.sum(weights * box.targets, axis=1)


def _no_force(_, inputs):
    """Return the specific force (m, 3) m/s^2 of a black box without targets; the kernel would take most of the time."""
    return jnp.zeros((len(inputs), 3))


class Trajectories(NamedTuple):
    """Positions of v vehicles in w rollouts, at the start and after each of s steps.

    Attributes:
        recorded: (v, s + 1, w, 3) m; they differ where the vehicles' sensor terms do.
        flown: (v, s + 1, w, 3) m, simulated.
    """

    recorded: np.ndarray
    flown: np.ndarray

    def errors(self, steps) -> np.ndarray:
        """Return the distance (v, w, h) m between recorded and simulated position after these numbers of steps (h,)."""
        return np.moveaxis(np.linalg.norm(self.flown[:, steps] - self.recorded[:, steps], axis=-1), 1, 2)


def trajectories(
    residual_model: ResidualModel,
    vehicles: Sequence[Vehicle],
    boxes: Sequence[BlackBox],
    begin_s: float,
    seconds: float,
    start_s: float = START_SMOOTHING_S,
) -> Trajectories:
    """Return the positions of each vehicle with its black box in rollouts of a recording.

    Args:
        residual_model: gives the recording.
        vehicles: v vehicles with the same terms.
        boxes: black box of each vehicle.
        begin_s: time before which no rollout starts.
        seconds: duration of each rollout.
        start_s: standard deviation of the filter on the start states, s; 0 for states without noise.
    """
    recording = residual_model.recording
    steps = int(round(seconds / recording.dt))
    first = np.searchsorted(recording.t, begin_s)
    rows = np.arange(first, len(recording.t) - steps - 1, max(1, round(INTERVAL_S / recording.dt)))
    valid = recording.good
    if recording.motor_record is not None:
        valid = valid & ~recording.in_gap("motor_command", "voltage")
    rows = np.array([row for row in rows if valid[row : row + steps + 1].all()], dtype=int)
    if not len(rows):
        none = np.empty((len(vehicles), steps + 1, 0, 3))
        return Trajectories(none, none)
    parameters = physics_replay.stack_parameters(list(vehicles))
    speeds = _speeds(recording, parameters)
    starts, recorded = [], []
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
        recorded.append(p[rows + np.arange(steps + 1)[:, None]])
    start = Start(*(np.stack(parts) for parts in zip(*starts, strict=True)))
    box = BlackBox(*(np.stack(parts) for parts in zip(*boxes, strict=True)))
    flown = np.asarray(_simulated(parameters, start, box, recording.dt))
    return Trajectories(np.stack(recorded), np.concatenate([start.p_world[:, None], flown], axis=1))


def _speeds(recording, parameters) -> np.ndarray:
    """Return rotor speeds (v, n, r) rad/s on the recording's grid: from the motor commands, else as measured."""
    if recording.motor_record is None:
        return np.broadcast_to(recording.rotor_speed, (len(parameters.mass), *recording.rotor_speed.shape))
    record = recording.motor_record
    return np.stack(
        [
            np.stack([np.interp(recording.t, record.t, rotor) for rotor in of_vehicle.T], axis=-1)
            for of_vehicle in physics_replay.rotor_speeds(parameters, record)
        ]
    )


@jax.jit
def _simulated(parameters, start: Start, box: BlackBox, dt):
    """Return the positions (v, s, w, 3) m after each step."""
    return jax.lax.map(lambda one: _simulated_by_one(*one, dt), (parameters, start, box))


def _simulated_by_one(parameters, start: Start, box: BlackBox, dt):
    """Return the positions (s, w, 3) m of one vehicle after each step, by the midpoint rule."""

    def rates(p, q, v_world, omega, speed, rotor_acceleration):
        state = (p, q, v_world, omega, speed, rotor_acceleration)
        force, turn = physics_replay.specific_force_and_turn(parameters, state)
        v_body = geometry.rotate_inverse(q, v_world)
        collective = jnp.sum(parameters.rotors.thrust_coefficient * speed * speed, axis=-1, keepdims=True)
        inputs = jnp.concatenate([v_body, omega, collective / parameters.mass], axis=-1)
        force = force + jax.lax.cond(jnp.any(box.targets), black_box_force, _no_force, box, inputs)
        gravity = jnp.array([0.0, 0.0, 1.0]) * parameters.gravity
        return geometry.rotate(q, force) - gravity, turn

    def step(body, speeds):
        p, q, v, omega = body
        before, after = speeds
        rotor_acceleration = (after - before) / dt
        a, turn = rates(p, q, v, omega, before, rotor_acceleration)
        middle_omega = omega + 0.5 * dt * turn
        middle_q = _rotated(q, omega, 0.5 * dt)
        middle_speed = 0.5 * (before + after)
        a, turn = rates(p + 0.5 * dt * v, middle_q, v + 0.5 * dt * a, middle_omega, middle_speed, rotor_acceleration)
        body = (p + dt * v + 0.5 * dt * dt * a, _rotated(q, middle_omega, dt), v + dt * a, omega + dt * turn)
        return body, body[0]

    pairs = (start.rotor_speed[:-1], start.rotor_speed[1:])
    return jax.lax.scan(step, (start.p_world, start.q_world_body, start.v_world, start.omega_body), pairs)[1]


def _rotated(q, omega, dt):
    """Return attitudes (w, 4) after a rotation with constant body rates (w, 3) rad/s."""
    return geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(dt * omega))
