"""The reward as a sum of one-line terms, each weighted by `rewards` in config/training.yaml.

Progress, perception, command and crash are the paper's (Methods, "Policy training"); passage and margin are ours: a
bonus that draws the first laps out of a beginner, and a price on passing close to the frame.
"""

from typing import NamedTuple

import jax.numpy as jnp

PERCEPTION_DECAY = -10.0  # lambda_3 of the paper, with the angle in rad
COMFORTABLE_MARGIN = 0.4  # m from hull to inner edge, beyond which more is worth nothing


class Moment(NamedTuple):
    """What one control step did, all (n,): distances to the opening before and after (m), angle between the optical
    axis and the next gate (rad), commanded rates (n, 3) rad/s, actions (n, 4), what happened, margin (m) if passed."""

    distance_before: jnp.ndarray
    distance_after: jnp.ndarray
    gate_angle: jnp.ndarray
    omega_command: jnp.ndarray
    action: jnp.ndarray
    previous_action: jnp.ndarray
    crashed: jnp.ndarray
    passed: jnp.ndarray
    margin: jnp.ndarray


def progress(moment):
    return moment.distance_before - moment.distance_after


def perception(moment):
    return jnp.exp(PERCEPTION_DECAY * moment.gate_angle**4)


def rates(moment):
    return -jnp.linalg.norm(moment.omega_command, axis=-1)


def smoothness(moment):
    return -jnp.sum((moment.action - moment.previous_action) ** 2, axis=-1)


def crash(moment):
    return -1.0 * moment.crashed


def passage(moment):
    return 1.0 * moment.passed


def margin(moment):
    return -jnp.where(moment.passed, jnp.maximum(COMFORTABLE_MARGIN - moment.margin, 0.0), 0.0)


TERMS = {term.__name__: term for term in (progress, perception, rates, smoothness, crash, passage, margin)}


def total(moment: Moment, scales: dict):
    """Return the reward (n,): the terms named in `scales`, each times its scale."""
    return sum(scale * TERMS[name](moment) for name, scale in scales.items())


def distance_to_opening(p_gate, half_width: float):
    """Return the distance (...) m from points (..., 3) in a gate's frame to the square of +-half_width in its plane.

    Progress towards the opening instead of its centre lets the pilot cut corners through the gates.
    """
    beside = jnp.maximum(jnp.abs(p_gate[..., 1:]) - half_width, 0.0)
    return jnp.sqrt(p_gate[..., 0] ** 2 + jnp.sum(beside**2, axis=-1) + 1e-9)
