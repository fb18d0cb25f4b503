"""What training draws anew for every episode, and the error of the pilot's state estimate while it flies.

The paper randomises nothing. Ours must survive the node graph, whose estimate is off by a decimetre and whose commands
arrive late, so each range below is what the graph is expected to do, with some room.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_ros import geometry
from swift_sim_bridge.physics.state import Parameters

TICK = 0.01  # s, one control step
ERROR_SIZE = 12


class Episode(NamedTuple):
    """Drawn once an episode, all with leading (n,). `*_factor`: multiply the nominal parameter; charge_share: of the
    pack's capacity, used before; voltage_error: V of the reading; delay_ticks: of commands; error_scale, error_decay
    (n, 12): standard deviation of the estimate's errors and the share of them left after a tick."""

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


def draw_episode(key, n: int, difficulty) -> Episode:
    """Return `n` draws; every range shrinks linearly to its middle as difficulty (scalar in 0..1) goes to zero."""
    uniform = jax.random.uniform(key, (n, 10), minval=-1.0, maxval=1.0) * difficulty
    positive = 0.5 * (uniform + difficulty)  # 0..difficulty
    # A race has one level of trouble, so all errors grow together: 0.5-1 times the values below, which are position
    # (a fast and a slow part), velocity, roll and pitch, and yaw. The graph's estimate is off by 0.05 m an axis.
    level = 0.75 * difficulty + 0.25 * uniform[:, 0]
    deviation = jnp.array([0.07] * 3 + [0.05] * 3 + [0.15] * 3 + [0.010, 0.010, 0.015])  # m, m, m/s, rad
    memory = jnp.array([0.4] * 3 + [2.0] * 3 + [0.4] * 3 + [1.0, 1.0, 4.0])  # s
    stretch = 2.0 ** (0.7 * uniform[:, 1])  # how long errors last is known within a factor of 1.6
    return Episode(
        mass_factor=1 + 0.02 * uniform[:, 2],  # the scales, and what is strapped on: 2 %
        thrust_factor=1 + 0.05 * uniform[:, 3],  # propellers and air density: 5 %
        rotor_drag_factor=1 + 0.3 * uniform[:, 4],  # never identified in flight: 30 %
        body_drag_factor=1 + 0.3 * uniform[:, 5],  # likewise
        motor_time_factor=1 + 0.1 * uniform[:, 6],  # motors and propellers differ: 10 %
        charge_share=0.15 * positive[:, 7],  # a pack is not always quite full
        voltage_error=0.1 * uniform[:, 8],  # V, calibration of the reading
        delay_ticks=1.5 * positive[:, 9],  # 0-15 ms: serial line, receiver task, a late node
        error_scale=level[:, None] * deviation,
        error_decay=jnp.exp(-TICK / (memory * stretch[:, None])),
    )


def parameters_of(episode: Episode, nominal: Parameters) -> Parameters:
    """Return the physics of the episodes: what was drawn is batched (n, ...), the rest is not."""
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


def first_error(key, episode: Episode):
    """Return errors (n, 12) drawn from the stationary distribution: position, fast and slow (m, map), velocity (m/s,
    body), roll and pitch (rad, body), yaw (rad, map)."""
    return episode.error_scale * jax.random.normal(key, episode.error_scale.shape)


def next_error(key, error, episode: Episode):
    """Return the errors (n, 12) one tick later: each column an Ornstein-Uhlenbeck process of its own."""
    fresh = jnp.sqrt(1.0 - episode.error_decay**2) * episode.error_scale
    return episode.error_decay * error + fresh * jax.random.normal(key, error.shape)


def estimate(error, p_world, q_world_body, v_world):
    """Return (p, q, v) as the pilot's estimator would report the true ones, all (n, ...)."""
    tilt = jnp.concatenate([error[:, 9:11], jnp.zeros_like(error[:, :1])], axis=-1)
    q_tilted = geometry.quaternion_multiply(q_world_body, geometry.quaternion_from_rotation_vector(tilt))
    q_seen = geometry.quaternion_multiply(geometry.quaternion_from_yaw(error[:, 11]), q_tilted)
    v_seen = v_world + geometry.rotate(q_world_body, error[:, 6:9])
    return p_world + error[:, 0:3] + error[:, 3:6], q_seen, v_seen
