"""The reward as a sum of terms, each weighted by `rewards` in config/training.yaml.

Progress, perception, rates, smoothness and crash are the paper's (Methods, "Policy training"). Added are a bonus for
each gate, with which an untrained policy finds its first laps, two costs of coming close to a frame, and with a guide
three more: costs of leaving its line and of another direction of the thrust, and progress in its time. Yaw is priced
apart from the other rates.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

PERCEPTION_DECAY = -10.0  # lambda_3 of the paper, with the angle in rad
SUFFICIENT_MARGIN_M = 0.4  # hull to inner edge; a larger one is not rewarded. In the middle of a gate it is 0.57 m
RISK_MARGIN_M = 0.02  # nearer by so much, a touch is e times as probable; flights differ by it at a gate
RISK_DEEPEST = 10.0  # times RISK_MARGIN_M inside; beyond, a fall through the ground would outweigh all other races


class Moment(NamedTuple):
    """What one control tick did, all with leading (n,).

    Attributes:
        distance_before, distance_after: m, to the opening of the next gate.
        gate_angle: rad, between the optical axis and the centre of the next gate.
        omega_command: (n, 3) rad/s.
        action, previous_action: (n, 4).
        crashed: the episode ended as crashed, missed or stuck.
        passed, missed: the next gate was passed, or its plane crossed beside the opening.
        margin: m, hull to inner edge, meaningful where passed; below 0 where missed.
        height: m, lowest point of the hull above the ground.
        beside: m, from the hull to the nearest frame of a gate that is neither the next nor the last one.
        off_guide: m, distance from the guide beyond what is free; 0 without a guide.
        guide_time: s, time that the guide takes from the place before the tick to the one after it; 0 without a guide.
        thrust_cosine: of the angle between the thrust and that of the guide at this place; 1 without a guide.
    """

    distance_before: jnp.ndarray
    distance_after: jnp.ndarray
    gate_angle: jnp.ndarray
    omega_command: jnp.ndarray
    action: jnp.ndarray
    previous_action: jnp.ndarray
    crashed: jnp.ndarray
    passed: jnp.ndarray
    missed: jnp.ndarray
    margin: jnp.ndarray
    height: jnp.ndarray
    beside: jnp.ndarray
    off_guide: jnp.ndarray
    guide_time: jnp.ndarray
    thrust_cosine: jnp.ndarray


def progress(moment):
    """Distance gained towards the opening of the next gate, m."""
    return moment.distance_before - moment.distance_after


def perception(moment):
    """One while the camera points at the next gate."""
    return jnp.exp(PERCEPTION_DECAY * moment.gate_angle**4)


def rates(moment):
    """Cost of body rates, rad/s."""
    return -jnp.linalg.norm(moment.omega_command, axis=-1)


def smoothness(moment):
    """Cost of changes of the action."""
    return -jnp.sum((moment.action - moment.previous_action) ** 2, axis=-1)


def crash(moment):
    """Cost of a failed episode."""
    return -1.0 * moment.crashed


def passage(moment):
    """Bonus for a gate passed."""
    return 1.0 * moment.passed


def margin(moment):
    """Cost of the margin that is missing at a passage, m."""
    return -jnp.where(moment.passed, jnp.maximum(SUFFICIENT_MARGIN_M - moment.margin, 0.0), 0.0)


def risk(moment):
    """Cost of a probable touch: of the next gate's frame at its plane, of other frames and of the ground in each tick.

    It is 1 at a frame and at the ground, e times less for each `RISK_MARGIN_M` away from them, and grows linearly
    inside, down to `RISK_DEEPEST` times that: a race that fails has a slope, too.
    """

    def touch(way):
        ways = way / RISK_MARGIN_M
        return jnp.exp(-jnp.maximum(ways, 0.0)) - jnp.clip(ways, -RISK_DEEPEST, 0.0)

    at_gate = jnp.where(moment.passed | moment.missed, touch(moment.margin), 0.0)
    return -at_gate - touch(moment.beside) - touch(moment.height)


def guide(moment):
    """Cost of the distance from the time-optimal lap, m."""
    return -moment.off_guide


def pace(moment):
    """Progress in the time of the guide, s: a slow part of the way counts for as long as the guide takes there."""
    return moment.guide_time


def thrust_direction(moment):
    """Cost of a thrust that does not point where that of the guide points at this place."""
    return moment.thrust_cosine - 1.0


def yaw(moment):
    """Cost of the squared yaw rate, rad^2/s^2: the mixer takes thrust for it, and more for a fast turn."""
    return -(moment.omega_command[..., 2] ** 2)


_TERMS = (progress, perception, rates, smoothness, crash, passage, margin, risk, guide, pace, thrust_direction, yaw)
TERMS = {term.__name__: term for term in _TERMS}
NEED_GUIDE = (pace.__name__, thrust_direction.__name__)  # without one they reward nothing, and the training misses them


def weighted(moment: Moment, scales: dict) -> dict[str, Any]:
    """Return the terms (n,) named in `scales`, each times its scale; their sum is the reward."""
    return {name: scale * TERMS[name](moment) for name, scale in scales.items()}


def distance_to_opening(p_gate, half_width: float):
    """Return the distance (...) m from points in a gate's frame to a square around the centre of its opening.

    Progress towards the square instead of the centre allows shorter paths through the gates.

    Args:
        p_gate: (..., 3) m.
        half_width: m, half the side of the square.
    """
    beside = jnp.maximum(jnp.abs(p_gate[..., 1:]) - half_width, 0.0)
    return jnp.sqrt(p_gate[..., 0] ** 2 + jnp.sum(beside**2, axis=-1) + 1e-9)
