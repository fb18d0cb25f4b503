"""The race's rules in training: passage, miss, touch and bounds from true states, one verdict a control tick.

The hull is a disc (radius, height) that tilts with the vehicle. A tick's move is a straight segment: at 20 m/s it is
0.2 m long. The graph's own judge looks at every physics step; this one is a little stricter than it instead.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.track import Track, to_gate_frame
from swift_ros.vehicle import Vehicle


class Gates(NamedTuple):
    """The track and the hull as arrays: positions (g, 3), rotations (g, 3, 3), yaws (g,), and lengths in m."""

    positions: jnp.ndarray
    rotations: jnp.ndarray
    yaws: jnp.ndarray
    inner_side: float
    outer_side: float
    depth: float
    bounds_min: jnp.ndarray
    bounds_max: jnp.ndarray
    hull_radius: float
    hull_height: float


class Verdict(NamedTuple):
    """All (n,): passed, missed (the next gate's plane crossed beside its opening), touched (any frame), outside (the
    flight volume, or the ground), margin (m, hull to inner edge at a passage)."""

    passed: jnp.ndarray
    missed: jnp.ndarray
    touched: jnp.ndarray
    outside: jnp.ndarray
    margin: jnp.ndarray


def make_gates(track: Track, vehicle: Vehicle) -> Gates:
    def single(values):
        return jnp.asarray(np.asarray(values), jnp.float32)

    return Gates(
        single(track.positions),
        single(track.rotations),
        single(track.yaws),
        track.inner_side,
        track.outer_side,
        track.depth,
        single(track.bounds_min),
        single(track.bounds_max),
        vehicle.hull_radius,
        vehicle.hull_height,
    )


def reach(gates: Gates, axis_z):
    """Return how far the hull reaches from its centre along each axis (..., 3) of a frame in which its own upward
    axis is axis_z (..., 3)."""
    across = jnp.sqrt(jnp.maximum(1.0 - axis_z**2, 0.0))
    return gates.hull_radius * across + 0.5 * gates.hull_height * jnp.abs(axis_z)


def judge(gates: Gates, next_gate, p_before, state, missed_window_m: float) -> Verdict:
    """Return the verdict on a move from p_before (n, 3) to `state`, with `next_gate` (n,) to pass."""
    positions, rotations = gates.positions, gates.rotations
    before = to_gate_frame(positions, rotations, p_before[:, None])  # (n, g, 3)
    after = to_gate_frame(positions, rotations, state.p_world[:, None])
    up_world = geometry.rotate(state.q_world_body, jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), state.p_world.shape))
    hull = reach(gates, to_gate_frame(0.0, rotations, up_world[:, None]))

    forwards = (before[..., 0] < 0) & (after[..., 0] >= 0)
    backwards = (before[..., 0] >= 0) & (after[..., 0] < 0)
    crossed = forwards | backwards
    length = jnp.where(crossed, after[..., 0] - before[..., 0], 1.0)
    share = jnp.where(crossed, -before[..., 0] / length, 0.0)
    move = after[..., 1:] - before[..., 1:]
    offset = jnp.abs(before[..., 1:] + share[..., None] * move)
    # Flying through at a slant, the centre moves sideways while it crosses the frame's depth.
    slant = jnp.minimum(jnp.abs(move / length[..., None]), 2.0) * 0.5 * gates.depth
    extent = hull[..., 1:] + slant

    inner, outer = 0.5 * gates.inner_side, 0.5 * gates.outer_side
    margin = jnp.min(inner - offset - extent, axis=-1)
    beside = jnp.all(offset - extent < outer, axis=-1)
    grazed = crossed & (margin < 0) & beside
    # Along a frame without crossing its plane.
    side = jnp.abs(after[..., 1:])
    in_ring = jnp.any(side > inner, axis=-1) & jnp.all(side < outer, axis=-1)
    scraped = in_ring & (jnp.abs(after[..., 0]) < 0.5 * gates.depth + hull[..., 0])
    touched = jnp.any(grazed | scraped, axis=-1)

    mine = jnp.arange(positions.shape[0]) == next_gate[:, None]
    near = jnp.max(offset, axis=-1) < missed_window_m
    passed = jnp.any(mine & forwards & (margin >= 0), axis=-1)
    missed = jnp.any(mine & forwards & (margin < 0) & near, axis=-1)
    low = state.p_world - jnp.array([0.0, 0.0, 1.0]) * reach(gates, up_world)
    outside = jnp.any((low < gates.bounds_min) | (state.p_world > gates.bounds_max), axis=-1)
    return Verdict(passed, missed, touched, outside, jnp.sum(jnp.where(mine, margin, 0.0), axis=-1))
