"""The physics with measured inputs, for many variants of a vehicle at once. Call it in double precision."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.motor_record import MotorRecord
from swift_sim_bridge.gap.residuals import pack_replay
from swift_sim_bridge.physics import motors, rigid_body
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.motion import Motion, instant_of
from swift_sim_bridge.physics.terms.vectors import stack, vector

BLOCK = 1024  # number of rows is padded to a multiple, so that flights of other lengths are rarely compiled anew
SMALL_BATCH, LARGE_BATCH = 8, 16  # variants per call, so that other numbers of variants are not compiled anew


@dataclass(frozen=True)
class MeasuredMotion:
    """Measured inputs of the physics.

    Each is one array for all variants, as below, or (b, n, ...) with one for each of b variants.

    Attributes:
        p_world: (n, 3) m.
        q_world_body: (n, 4).
        v_world: (n, 3) m/s.
        omega_body: (n, 3) rad/s.
        rotor_speed: (n, r) rad/s.
        rotor_acceleration: (n, r) rad/s^2.
    """

    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray
    rotor_speed: np.ndarray
    rotor_acceleration: np.ndarray


def stack_parameters(vehicles: list[Vehicle]) -> Parameters:
    """Return the parameters of vehicles with the same terms, stacked (b, ...), with the terms that act in flight."""
    built = [
        jax.tree.map(np.asarray, registry.with_flight_terms(parameters_from_vehicle(vehicle, np.float64, np.asarray)))
        for vehicle in vehicles
    ]
    return jax.tree.map(lambda *rows: np.stack(rows), *built)


def forces(parameters: Parameters, measured: MeasuredMotion) -> tuple[np.ndarray, np.ndarray]:
    """Return specific force (b, n, 3) m/s^2 and angular acceleration (b, n, 3) rad/s^2 of each variant, body frame.

    The variants are computed one after the other: the arrays of many together exceed the cache and take twice as long.

    Args:
        parameters: of b variants, or of one vehicle whose motion was measured in b ways.
        measured: the motion, in one way for all variants or in b ways.
    """
    count, parts = measured.p_world.shape[-2], {name: _padded(part) for name, part in vars(measured).items()}
    own = {name: part for name, part in parts.items() if part.ndim == 3}
    shared = {name: part for name, part in parts.items() if part.ndim == 2}
    batch = max(len(parameters.mass), *(len(part) for part in own.values()), 1)
    if len(parameters.mass) < batch:
        parameters = jax.tree.map(lambda leaf: np.repeat(leaf, batch, axis=0), parameters)
    force, turn = np.empty((2, batch, count, 3))
    for number, variants in enumerate(_batches((parameters, own), LARGE_BATCH)):
        begin, end = number * LARGE_BATCH, min((number + 1) * LARGE_BATCH, batch)
        found = _forces(end - begin, *variants, shared)
        force[begin:end], turn[begin:end] = (np.asarray(part)[: end - begin, :count] for part in found)
    return force, turn


def _padded(rows) -> np.ndarray:
    """Return rows (..., n, k) with the last one repeated up to a multiple of BLOCK."""
    return np.concatenate([rows, np.repeat(rows[..., -1:, :], -rows.shape[-2] % BLOCK, axis=-2)], axis=-2)


@jax.jit
def _forces(count, parameters: Parameters, own: dict, shared: dict):
    """Return `specific_force_and_turn` (LARGE_BATCH, n, 3) of the first `count` variants, zero of the others."""
    rows = (own | shared)["p_world"].shape[-2]

    def one(i, found):
        variant, motion = jax.tree.map(lambda leaf: leaf[i], (parameters, own))
        motion = MeasuredMotion(**motion, **shared)
        computed = specific_force_and_turn(variant, tuple(vars(motion).values()))
        return tuple(part.at[i].set(values) for part, values in zip(found, computed, strict=True))

    return jax.lax.fori_loop(0, count, one, (jnp.zeros((LARGE_BATCH, rows, 3)),) * 2)


def specific_force_and_turn(parameters: Parameters, measured):
    """Return specific force (n, 3) m/s^2 and angular acceleration (n, 3) rad/s^2 of one vehicle, body frame.

    Args:
        parameters: of one vehicle.
        measured: the fields of `MeasuredMotion`, in their order.
    """
    p_world, q, v_world, omega_body, speed, acceleration = measured
    air = stack(registry.air_velocity(vector(p_world), {}, parameters), like=p_world[..., 0])
    v_body = geometry.rotate_inverse(q, v_world - air)
    instant = instant_of(Motion(p_world, q, v_body, omega_body, speed, acceleration), parameters)
    force, moment = registry.wrench_at(instant, parameters)
    turn = rigid_body.turn_acceleration(instant.omega_body, moment, parameters)
    like = instant.collective
    return stack(force, like=like) / parameters.mass, stack(turn, like=like)


def rotor_speeds(parameters: Parameters, record: MotorRecord) -> np.ndarray:
    """Return the rotor speeds (b, n, r) rad/s that the motors of each variant reach with the recorded commands.

    Without a voltage in the record, each variant's battery supplies its motors, full at the start.
    """
    replayed = _rotor_speeds
    inputs = _steps(record, record.step_command)
    if record.voltage is None:
        replayed, inputs = _supplied_rotor_speeds, inputs[:2]
    count = len(parameters.mass)
    size = 1 if count == 1 else SMALL_BATCH if count <= SMALL_BATCH else LARGE_BATCH
    found = [
        _at_rows(record, np.asarray(replayed(batch, record.rotor_speed[0], inputs)))
        for batch in _batches(parameters, size)
    ]
    return np.concatenate(found)[:count] if len(found) > 1 else found[0][:count]


def _supplied_rotor_speeds(parameters: Parameters, first, inputs) -> np.ndarray:
    """Return the speeds (n, b, r) rad/s after each step, where each vehicle has its own battery."""
    duration, command = (np.concatenate([part, part[-1:]]) for part in inputs)
    return np.asarray(pack_replay.driven_from_full(parameters, first, (duration, command)))[1:]


def rotor_speeds_under(parameters: Parameters, record: MotorRecord, commands: list[np.ndarray]) -> np.ndarray:
    """Return the rotor speeds (b, n, r) rad/s of one vehicle, parameters (1, ...), under b commands (k, r)."""
    same = jax.tree.map(lambda leaf: np.repeat(leaf, len(commands), axis=0), parameters)
    inputs = _steps(record, np.stack(commands, axis=1))
    return _at_rows(record, np.asarray(_rotor_speeds(same, record.rotor_speed[0], inputs)))


def _steps(record: MotorRecord, command) -> tuple[np.ndarray, ...]:
    """Return duration, command and voltage of the steps of a replay, in blocks."""
    voltage = np.zeros(len(record.t)) if record.voltage is None else record.voltage
    inputs = (np.diff(record.step_t), command, np.repeat(voltage[:-1], record.steps))
    more = -len(inputs[0]) % BLOCK
    return tuple(np.concatenate([part, np.repeat(part[-1:], more, axis=0)]) for part in inputs)


def _at_rows(record: MotorRecord, speed) -> np.ndarray:
    """Return the speeds (b, n, r) at the record's times from those (k, b, r) after each step."""
    speed = speed[record.steps - 1 : record.steps * (len(record.t) - 1) : record.steps]
    first = np.broadcast_to(record.rotor_speed[0], (1, *speed.shape[1:]))
    return np.moveaxis(np.concatenate([first, speed]), 0, 1)


def _batches(variants, size: int) -> list:
    """Return arrays (b, ...) of a pytree in batches of `size` variants; the last variant fills the last batch."""
    count = len(jax.tree.leaves(variants)[0])
    filled = jax.tree.map(lambda leaf: np.concatenate([leaf, np.repeat(leaf[-1:], -count % size, axis=0)]), variants)
    return [
        jax.tree.map(lambda leaf, begin=begin: leaf[begin : begin + size], filled) for begin in range(0, count, size)
    ]


@jax.jit
def _rotor_speeds(parameters: Parameters, first, inputs):
    """Return the speeds (n, b, r) rad/s after each step."""
    count = first.shape[-1]
    factor = jnp.ones_like(parameters.mass)[:, None]
    for factors in registry.motor_factors({}, parameters):
        factor = factor * stack(factors)

    def step(speed, now):
        dt, command, voltage = now
        voltage = jnp.broadcast_to(voltage, parameters.mass.shape)
        target = factor * motors.steady_speed(command, voltage, parameters.motors)
        present = tuple(speed[:, i] for i in range(count))
        added = registry.added_speeds(present, tuple(command[..., i] for i in range(count)), voltage, parameters)
        target = target + stack(added, like=voltage)
        after_lag = motors.lag(present, tuple(target[:, i] for i in range(count)), dt, parameters.motors)
        speed = stack(after_lag)
        return speed, speed

    return jax.lax.scan(step, jnp.broadcast_to(first, (parameters.mass.shape[0], count)), inputs)[1]
