"""Domain randomisation: what is drawn for each episode, and the errors of the state estimate during it.

The paper randomises nothing. Here the policy must fly in the node graph, whose estimate has errors of a decimetre and
whose commands arrive late. Each range below is what is expected of the graph, with a reserve.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.configuration import within
from swift_sim_bridge.physics.state import Parameters

TICK = 0.01  # s, one control tick
# Relative to what was measured. One flight differs from the next, and the races of a pilot from those of another.
LEVEL_SPREAD, MEMORY_SPREAD = 0.3, 1.6


@dataclass(frozen=True)
class EstimateErrors:
    """Section `policy.estimate_errors` of config/training.yaml: errors of the state estimate in flight.

    Each is a standard deviation an axis, and the time after which exp(-1) of an error remains.
    `swiftros evaluate estimate` measures them in recorded races.

    Attributes:
        position_m, position_s: in the map.
        velocity_m_s, velocity_s: in the body frame.
        tilt_rad, tilt_s: roll and pitch.
        yaw_rad, yaw_s: in the map.
    """

    position_m: float = within(0.0, 10.0)
    position_s: float = within(0.001, 1000.0)
    velocity_m_s: float = within(0.0, 10.0)
    velocity_s: float = within(0.001, 1000.0)
    tilt_rad: float = within(0.0, 1.0)
    tilt_s: float = within(0.001, 1000.0)
    yaw_rad: float = within(0.0, 1.0)
    yaw_s: float = within(0.001, 1000.0)


ERRORS = 9  # entries of the error of an estimate, see `initial_error`


class Episode(NamedTuple):
    """What is drawn once an episode, all with leading (n,).

    Attributes:
        mass_factor, thrust_factor, rotor_drag_factor, body_drag_factor, motor_time_factor: multiply the nominal
            parameter.
        charge_share: of the battery's capacity, used before the start.
        voltage_error: V, of the reading.
        delay_ticks: of commands.
        error_scale: (n, 9), standard deviations of the errors of the estimate, see `initial_error`.
        error_decay: (n, 9), share of an error that is left after a tick.
    """

    mass_factor: jnp.ndarray
    thrust_factor: jnp.ndarray
    rotor_drag_factor: jnp.ndarray
    body_drag_factor: jnp.ndarray
    motor_time_factor: jnp.ndarray
    charge_share: jnp.ndarray
    voltage_error: jnp.ndarray
    delay_ticks: jnp.ndarray
    error_scale: jnp.ndarray
    error_decay: jnp.ndarray


def draw_episode(key, n: int, difficulty, errors: EstimateErrors, settings) -> Episode:
    """Return `n` episodes; each range shrinks linearly to its middle as difficulty (0..1) goes to zero.

    Args:
        key: of the random numbers.
        n: number of episodes.
        difficulty: 0..1; without difficulty the estimate has no error, too.
        errors: of the estimate.
        settings: of the environment; its `command_delay_s`, `vehicle_spread` and `used_charge`.
    """
    uniform = jax.random.uniform(key, (n, 10), minval=-1.0, maxval=1.0) * difficulty
    vehicle = settings.vehicle_spread * uniform
    positive = 0.5 * (uniform + difficulty)  # 0..difficulty
    level = difficulty + LEVEL_SPREAD * uniform[:, 0]  # common to all errors of an episode
    deviation = jnp.array(
        [errors.position_m] * 3 + [errors.velocity_m_s] * 3 + [errors.tilt_rad] * 2 + [errors.yaw_rad]
    )
    memory = jnp.array([errors.position_s] * 3 + [errors.velocity_s] * 3 + [errors.tilt_s] * 2 + [errors.yaw_s])
    stretch = MEMORY_SPREAD ** uniform[:, 1]
    return Episode(
        mass_factor=1 + 0.02 * vehicle[:, 2],  # error of the scales, and payload: 2 %
        thrust_factor=1 + 0.05 * vehicle[:, 3],  # propellers and air density: 5 %
        rotor_drag_factor=1 + 0.3 * vehicle[:, 4],  # not identified in flight: 30 %
        body_drag_factor=1 + 0.3 * vehicle[:, 5],  # likewise
        motor_time_factor=1 + 0.1 * vehicle[:, 6],  # motors and propellers differ: 10 %
        charge_share=settings.used_charge * positive[:, 7],
        voltage_error=0.1 * vehicle[:, 8],  # V, calibration of the voltmeter
        delay_ticks=settings.command_delay_s / TICK * positive[:, 9],
        error_scale=level[:, None] * deviation,
        error_decay=jnp.exp(-TICK / (memory * stretch[:, None])),
    )


class Disturbance(NamedTuple):
    """What differs from what a policy was trained for, of all episodes, beyond what is drawn for each.

    Attributes:
        mass, thrust, drag, error: factors; `error` of the state estimate's errors.
        delay_s: of commands, s.
        used_share: of the battery's capacity, used before the start.
    """

    mass: float = 1.0
    thrust: float = 1.0
    drag: float = 1.0
    error: float = 1.0
    delay_s: float = 0.0
    used_share: float = 0.0


UNDISTURBED = Disturbance(*map(np.float32, Disturbance()))  # of the type of all others


def disturbed(episode: Episode, by: Disturbance) -> Episode:
    """Return episodes with a disturbance."""
    return episode._replace(
        mass_factor=episode.mass_factor * by.mass,
        thrust_factor=episode.thrust_factor * by.thrust,
        rotor_drag_factor=episode.rotor_drag_factor * by.drag,
        body_drag_factor=episode.body_drag_factor * by.drag,
        charge_share=episode.charge_share + by.used_share,
        delay_ticks=episode.delay_ticks + by.delay_s / TICK,
        error_scale=episode.error_scale * by.error,
    )


def parameters_of(episode: Episode, nominal: Parameters) -> Parameters:
    """Return the physics parameters of the episodes: (n, ...) where they were drawn, else as in `nominal`."""
    rotors, motors, drags = nominal.rotors, nominal.motors, dict(nominal.terms)
    if "rotor_drag" in drags:
        k_d = drags["rotor_drag"].k_d * episode.rotor_drag_factor
        drags["rotor_drag"] = replace(drags["rotor_drag"], k_d=k_d)
    if "body_drag" in drags:
        c = drags["body_drag"].c * episode.body_drag_factor[:, None]
        drags["body_drag"] = replace(drags["body_drag"], c=c)
    return replace(
        nominal,
        mass=nominal.mass * episode.mass_factor,
        rotors=replace(rotors, thrust_coefficient=rotors.thrust_coefficient * episode.thrust_factor[:, None]),
        motors=replace(
            motors,
            time_constant_up=motors.time_constant_up * episode.motor_time_factor,
            time_constant_down=motors.time_constant_down * episode.motor_time_factor,
        ),
        terms=drags,
    )


def initial_error(key, episode: Episode):
    """Return errors (n, 9) drawn from their stationary distribution.

    Columns: position (3), m in the map; velocity (3), m/s in the body frame; roll and pitch, rad in the body frame;
    yaw, rad in the map.
    """
    return episode.error_scale * jax.random.normal(key, episode.error_scale.shape)


def next_error(innovation, error, episode: Episode):
    """Return the errors (n, 9) one tick later; each column is an independent Ornstein-Uhlenbeck process.

    Args:
        innovation: (n, 9), standard normal numbers.
        error: (n, 9), before the tick.
        episode: what was drawn for the episodes.
    """
    scale = jnp.sqrt(1.0 - episode.error_decay**2) * episode.error_scale
    return episode.error_decay * error + scale * innovation


def estimate(error, p_world, q_world_body, v_world):
    """Return the estimates (p_world, q_world_body, v_world), all (n, ...), of true states and errors."""
    tilt = jnp.concatenate([error[:, 6:8], jnp.zeros_like(error[:, :1])], axis=-1)
    q_tilted = geometry.quaternion_multiply(q_world_body, geometry.quaternion_from_rotation_vector(tilt))
    q_estimate = geometry.quaternion_multiply(geometry.quaternion_from_yaw(error[:, 8]), q_tilted)
    v_estimate = v_world + geometry.rotate(q_world_body, error[:, 3:6])
    return p_world + error[:, 0:3], q_estimate, v_estimate
