"""The race's rules in training: passage, miss, touch and bounds from true states, one verdict a control tick.

The hull is a disc (radius, height) that tilts with the vehicle. The motion of a tick is a straight segment: at 20 m/s
it is 0.2 m long. The judge of the graph (`swift_ros.race.judge`) tests every physics step; this one is slightly
stricter instead.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.race import rules
from swift_ros.track import Track, to_gate_frame
from swift_ros.vehicle import Vehicle

# Sideways motion across a frame's depth that is counted, m per m along the passage: up to an angle of 63 degrees. It
# bounds the counted extent of a vehicle that crosses the plane nearly along it.
MAX_SLOPE = 2.0
FAR_M = 1e3  # m, to a frame that is not there


class Gates(NamedTuple):
    """The track and the hull as arrays; lengths in m.

    Attributes:
        positions: (g, 3), centres of the openings in the map.
        rotations: (g, 3, 3), R_map_gate.
        yaws: (g,) rad, directions of passage.
        inner_sides, outer_sides: (g,), of the frames.
        depth: of a frame.
        bounds_min, bounds_max: (3,), corners of the flight volume.
        start: (3,), position of a vehicle on the podium.
        hull_radius, hull_height: of the disc that encloses the vehicle.
    """

    positions: jnp.ndarray
    rotations: jnp.ndarray
    yaws: jnp.ndarray
    inner_sides: jnp.ndarray
    outer_sides: jnp.ndarray
    depth: float
    bounds_min: jnp.ndarray
    bounds_max: jnp.ndarray
    start: jnp.ndarray
    hull_radius: float
    hull_height: float


class Verdict(NamedTuple):
    """What happened in one tick, all (n,).

    Attributes:
        passed: the next gate was passed.
        missed: the plane of the next gate was crossed beside its opening.
        touched: the hull touched a frame.
        in_podium: the hull touches the podium or is above it and lower than its top. It may, while it takes off.
        outside: the vehicle touched the ground or left the flight volume.
        margin: m, hull to inner edge, meaningful where passed; below 0 where missed.
        height: m, lowest point of the hull above the ground.
        beside: m, from the hull to the nearest frame but those of the next gate and the last one, along the axes of the
            gate; negative within a frame.
    """

    passed: jnp.ndarray
    missed: jnp.ndarray
    touched: jnp.ndarray
    in_podium: jnp.ndarray
    outside: jnp.ndarray
    margin: jnp.ndarray
    height: jnp.ndarray
    beside: jnp.ndarray


def make_gates(track: Track, vehicle: Vehicle) -> Gates:
    """Return the gates of a track and the hull of a vehicle; arrays are float32."""

    def single(values):
        return jnp.asarray(np.asarray(values), jnp.float32)

    return Gates(
        positions=single(track.positions),
        rotations=single(track.rotations),
        yaws=single(track.yaws),
        inner_sides=single(track.inner_sides),
        outer_sides=single(track.outer_sides),
        depth=track.depth,
        bounds_min=single(track.bounds_min),
        bounds_max=single(track.bounds_max),
        start=single(track.start),
        hull_radius=vehicle.hull_radius,
        hull_height=vehicle.hull_height,
    )


def judge(gates: Gates, next_gate, p_before, state, missed_window_m: float) -> Verdict:
    """Return the verdict on the motion of one tick.

    Args:
        gates: of the track.
        next_gate: (n,), index of the gate to pass.
        p_before: (n, 3) m, position before the tick.
        state: true state after the tick.
        missed_window_m: a crossing beside the opening, but nearer than this to its centre in y and z, is a miss.
    """
    positions, rotations = gates.positions, gates.rotations
    before = to_gate_frame(positions, rotations, p_before[:, None])  # (n, g, 3)
    after = to_gate_frame(positions, rotations, state.p_world[:, None])
    up_world = geometry.rotate(state.q_world_body, jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), state.p_world.shape))
    up_gate = to_gate_frame(0.0, rotations, up_world[:, None])
    hull = rules.hull_reach(gates.hull_radius, gates.hull_height, up_gate)  # (n, g, 3), along the gate's axes

    forwards, backwards = rules.crossing_directions(before, after)
    crossed = forwards | backwards
    crossing = rules.crossing_point(before, after, crossed)
    offset = jnp.abs(crossing.offset)
    # On an oblique passage the centre moves sideways while it crosses the frame's depth.
    slant = jnp.minimum(jnp.abs(crossing.slope), MAX_SLOPE) * 0.5 * gates.depth
    extent = hull[..., 1:] + slant

    inner, outer = 0.5 * gates.inner_sides[:, None], 0.5 * gates.outer_sides[:, None]
    margin = rules.edge_margin(inner, crossing.offset, extent)
    within_outer = jnp.all(offset - extent < outer, axis=-1)
    grazed = crossed & (margin < 0) & within_outer
    # The hull may also touch a frame without crossing its plane.
    side = jnp.abs(after[..., 1:])
    in_ring = jnp.any(side > inner, axis=-1) & jnp.all(side < outer, axis=-1)
    scraped = in_ring & (jnp.abs(after[..., 0]) < 0.5 * gates.depth + hull[..., 0])

    numbers = jnp.arange(positions.shape[0])
    is_next, is_last = numbers == next_gate[:, None], numbers == (next_gate[:, None] - 1) % positions.shape[0]
    near = jnp.max(offset, axis=-1) < missed_window_m
    passed = jnp.any(is_next & forwards & (margin >= 0), axis=-1)
    missed = jnp.any(is_next & forwards & (margin < 0) & near, axis=-1)
    reach = rules.hull_reach(gates.hull_radius, gates.hull_height, up_world)
    low = state.p_world - jnp.array([0.0, 0.0, 1.0]) * reach
    outside = rules.outside_volume(gates.bounds_min, gates.bounds_max, low, state.p_world)
    in_podium = rules.above_podium(gates.start, state.p_world, gates.hull_radius)
    in_podium &= low[..., 2] < gates.start[2] - 0.5 * gates.hull_height
    touched = jnp.any(grazed | scraped, axis=-1)
    margin, height = jnp.sum(jnp.where(is_next, margin, 0.0), axis=-1), low[..., 2] - gates.bounds_min[2]
    frames = jnp.where(is_next | is_last, FAR_M, distance_to_frame(0.5 * gates.depth, inner, outer, after, hull))
    # Chosen by its index: the slope of a minimum looks for an equal value, which a rounding of its repetition removes.
    beside = jnp.take_along_axis(frames, jnp.argmin(frames, axis=-1, keepdims=True), axis=-1)[..., 0]
    return Verdict(passed, missed, touched, in_podium, outside, margin, height, beside)


def distance_to_frame(half_depth: float, inner, outer, p_gate, hull):
    """Return how far (...) m the hull's box must move along one axis of the gate to touch its frame.

    It is negative where they overlap: then the box is clear neither along the passage, nor around the frame, nor in its
    opening.

    Args:
        half_depth: m, of the frame.
        inner, outer: (..., 1) m, half the sides of the frame.
        p_gate: (..., 3) m, centre of the hull in the gate's frame.
        hull: (..., 3) m, reach of the hull along its axes.
    """
    along = jnp.abs(p_gate[..., 0]) - hull[..., 0] - half_depth
    around = -rules.edge_margin(outer, p_gate[..., 1:], -hull[..., 1:])
    in_opening = rules.edge_margin(inner, p_gate[..., 1:], hull[..., 1:])
    return jnp.maximum(jnp.maximum(along, around), in_opening)
