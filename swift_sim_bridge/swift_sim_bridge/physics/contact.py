"""Contact of the hull, a thin disc, with ground, podium and gate frames; a contact never adds energy.

Ground and podium stop the hull's lowest point and act by friction; the side of the podium stops the hull. A gate's
frame removes the closing velocity and most of the sliding velocity, so that a hull in contact is still in contact when
the next pose is published. `Contact` reports contacts of the physics; the judge (`swift_ros.race.judge`) decides about
the race.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.race import rules
from swift_ros.track import Track
from swift_sim_bridge.physics.rigid_body import apply
from swift_sim_bridge.physics.state import stacked, unstacked
from swift_sim_bridge.physics.terms import vectors
from swift_sim_bridge.physics.terms.vectors import (
    Quaternion,
    Vector,
    add,
    rotate,
    rotate_inverse,
    scale,
    stack,
    subtract,
)

FRICTION = 0.6  # coefficient of rubber feet and carbon on a floor
LEVEL_TILT = 0.03  # rad; below it a hull stands on its whole rim, above it on its lowest point
RATE_DECAY_S = 0.02  # s, time constant of the body rates while the hull rests on something: ten steps of physics
FRAME_SPEED_SHARE = 0.2  # of sliding velocity and body rates after a hit of a frame: small, so that the contact lasts
CRASH_M_S = 1.5  # m/s, closing speed on ground or podium above which a landing is a crash: a fall from 0.11 m
SIDE_DEPTH_M = 0.02  # of a hull in the podium's top, above which it has flown into its side: 10 m/s of descent a step
CONTACT_DISTANCE_M = 1e-3  # m, below which hull and frame are in contact
PROJECTIONS = 24  # iterations of the nearest point: 99 % of random hulls near a frame are exact to 1.5 mm, all to 6 mm


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Frames:
    """Frames of the gates, in m.

    Attributes:
        position: (g, 3) in the map.
        rotation: (g, 3, 3), R_map_gate.
        bar_low: (g, 4, 3), one corner of each of the four bars of a frame, in the gate's frame.
        bar_high: (g, 4, 3), the opposite corner.
    """

    position: jax.Array
    rotation: jax.Array
    bar_low: jax.Array
    bar_high: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class World:
    """Obstacles, in m.

    Attributes:
        ground_z: height of the ground.
        podium: (3,) centre of the podium's top.
        frames: of the gates; None where the physics need not stop a hull at them.
    """

    ground_z: jax.Array
    podium: jax.Array
    frames: Frames | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contact:
    """Contacts of a step.

    Attributes:
        supported: (...) bool, whether the hull rests on ground or podium.
        impact: (...) m/s, closing speed of the contact.
        gate: (...) index of the gate whose frame was hit, or -1.
    """

    supported: jax.Array
    impact: jax.Array
    gate: jax.Array

    @property
    def crashed(self):
        """(...) bool: hit a gate's frame, or came down on ground or podium faster than CRASH_M_S."""
        return (self.gate >= 0) | (self.impact > CRASH_M_S)


def world_from_track(track: Track, hull_height: float, dtype=None) -> World:
    """Return the world of a track: ground at z = 0 and a podium on which the hull stands at `track.start`."""
    sides = zip(track.inner_sides, track.outer_sides, strict=True)
    bars = np.array([_bars(inner, outer, track.half_depth) for inner, outer in sides])
    values = (track.positions, track.rotations, bars[:, :, 0], bars[:, :, 1])
    frames = Frames(*(jnp.asarray(value, dtype or jnp.result_type(float)) for value in values))
    return replace(supports_of_track(track, hull_height, dtype), frames=frames)


def supports_of_track(track: Track, hull_height: float, dtype=None) -> World:
    """Return the world of a track without its gates: what a vehicle can stand on."""
    podium = np.array(track.start) - [0, 0, 0.5 * hull_height]
    dtype = dtype or jnp.result_type(float)
    return World(jnp.asarray(0.0, dtype), jnp.asarray(podium, dtype))


def _bars(inner_side: float, outer_side: float, half_depth: float) -> list[list[tuple[float, float, float]]]:
    """Return two opposite corners of each of the four bars of a frame, in the gate's frame."""
    inner, outer = 0.5 * inner_side, 0.5 * outer_side
    spans = [(inner, outer, -outer, outer), (-outer, -inner, -outer, outer)]
    spans += [(-outer, outer, inner, outer), (-outer, outer, -outer, -inner)]
    return [[(-half_depth, y0, z0), (half_depth, y1, z1)] for y0, y1, z0, z1 in spans]


def no_contact(like) -> Contact:
    """Return the Contact (...) of free flight for values shaped as `like` (...)."""
    zero = jnp.zeros_like(like)
    return Contact(zero > 0, zero, jnp.full(zero.shape, -1, dtype=jnp.int32))


def _on_support(state, parameters, world, dt):
    """Return (state, supported, closing speed) after resting on, or hitting, the ground or the podium.

    The hull's lowest point takes an inelastic push upwards, which also turns the hull: a vehicle that tilts before its
    thrust lifts it is pressed flat by its weight. States are by components (see `physics.terms.vectors`).
    """
    position, velocity, omega_body = state.p_world, state.v_world, state.omega_body
    reach, push_moment = _support(state.q_world_body, parameters)
    over_podium = rules.above_podium(world.podium, stack(position)) & (position.z > world.podium[2])
    ground_z = jnp.where(over_podium, world.podium[2], world.ground_z)
    floor = ground_z + reach
    supported = position.z < floor
    from_side = over_podium & (position.z < floor - SIDE_DEPTH_M)
    turned = vectors.apply(parameters.inertia_inverse, push_moment)
    falling = -velocity.z - vectors.dot(push_moment, omega_body)  # of the lowest point
    mobility = 1.0 / parameters.mass + vectors.dot(push_moment, turned)
    push = jnp.where(supported, jnp.maximum(falling, 0.0), 0.0) / mobility  # N s
    slide = jnp.sqrt(velocity.x * velocity.x + velocity.y * velocity.y + 1e-12)
    left = jnp.maximum(1.0 - FRICTION * push / (parameters.mass * slide), 0.0)
    after = Vector(left * velocity.x, left * velocity.y, velocity.z + push / parameters.mass)
    decay = jnp.where(supported, jnp.exp(-dt / RATE_DECAY_S), 1.0)
    rates = scale(decay, add(omega_body, scale(push, turned)))
    # As in the integrator, the attitude is the integral of the new rate. With that before the contact the hull turned
    # by a seventh more than a gyro says.
    attitude = vectors.turned(state.q_world_body, subtract(rates, omega_body), dt)
    reach, _ = _support(attitude, parameters)
    stands = supported & ~from_side
    moved = replace(
        state,
        p_world=position._replace(z=jnp.where(stands, jnp.maximum(position.z, ground_z + reach), position.z)),
        v_world=Vector(*(jnp.where(from_side, 0.0, value) for value in after)),
        q_world_body=attitude,
        omega_body=rates,
    )
    closing = jnp.where(supported, jnp.maximum(-velocity.z, 0.0), 0.0)
    return moved, supported, jnp.where(from_side, jnp.maximum(slide, closing), closing)


def _support(attitude: Quaternion, parameters):
    """Return (reach (...) m below the hull's centre, moment of a unit push there, m, body, by components).

    The push is at the lowest point; for a hull that is almost level it moves into its middle, and the reach with it.
    """
    x, y, level = rotate(attitude, Vector(0.0, 0.0, 1.0))
    across = jnp.sqrt(x * x + y * y + LEVEL_TILT**2)
    radius, half_height = parameters.hull_radius, 0.5 * parameters.hull_height
    lever = radius * level / across - half_height * jnp.sign(level)  # of the lowest point, along the slope
    reach = radius * (across - LEVEL_TILT) + half_height * jnp.abs(level)
    return reach, rotate_inverse(attitude, Vector(lever * y, -lever * x, 0.0))


def frame_distance(p_world, q_world_body, parameters, frames: Frames):
    """Return (distance (..., g) m, point (..., g, 3)) from the hull to each gate's frame and the frame's nearest point.

    Hull and bar are convex, so alternating projections converge to their nearest points; Nesterov's extrapolation makes
    them fast where hull and bar are almost parallel.
    """
    to_gate = jnp.swapaxes(frames.rotation, -1, -2)
    centre = apply(to_gate, p_world[..., None, :] - frames.position)[..., None, :]
    axis_world = geometry.rotate(q_world_body, jnp.zeros_like(p_world).at[..., 2].set(1.0))
    axis = apply(to_gate, axis_world[..., None, :])[..., None, :]
    radius = parameters.hull_radius[..., None, None, None]
    half_height = 0.5 * parameters.hull_height[..., None, None, None]

    def into_hull(point):
        offset = point - centre
        along = jnp.sum(offset * axis, axis=-1, keepdims=True)
        across = offset - along * axis
        length = jnp.sqrt(jnp.sum(across * across, axis=-1, keepdims=True) + 1e-12)
        return centre + jnp.clip(along, -half_height, half_height) * axis + across * jnp.minimum(1.0, radius / length)

    def alternate(k, points):
        bar, before = points
        ahead = bar + k / (k + 3.0) * (bar - before)
        return jnp.clip(into_hull(ahead), frames.bar_low, frames.bar_high), bar

    start = jnp.clip(centre, frames.bar_low, frames.bar_high)
    bar, _ = jax.lax.fori_loop(0, PROJECTIONS, alternate, (start, start))
    distance = jnp.sqrt(jnp.sum((into_hull(bar) - bar) ** 2, axis=-1))
    nearest = jnp.argmin(distance, axis=-1)[..., None]
    bar = jnp.take_along_axis(bar, nearest[..., None], axis=-2)[..., 0, :]
    point = frames.position + apply(frames.rotation, bar)
    return jnp.take_along_axis(distance, nearest, axis=-1)[..., 0], point


def _on_frame(state, parameters, frames: Frames):
    """Return (state, gate hit or -1, closing speed) after contact with a gate's frame."""
    distance, point = frame_distance(state.p_world, state.q_world_body, parameters, frames)
    gate = jnp.argmin(distance, axis=-1)
    touched = jnp.take_along_axis(distance, gate[..., None], axis=-1)[..., 0] < CONTACT_DISTANCE_M
    point = jnp.take_along_axis(point, gate[..., None, None], axis=-2)[..., 0, :]
    normal = geometry.normalize(state.p_world - point)
    closing = jnp.maximum(-jnp.sum(normal * state.v_world, axis=-1), 0.0)
    closing = jnp.where(touched, closing, 0.0)
    kept = jnp.where(closing > 0, FRAME_SPEED_SHARE, 1.0)[..., None]
    v_world = kept * (state.v_world + closing[..., None] * normal)
    moved = replace(state, v_world=v_world, omega_body=kept * state.omega_body)
    return moved, jnp.where(touched, gate, -1), closing


def resolve(state, parameters, world: World, dt):
    """Return (state, Contact) after the contacts of a step of `dt` s; states by components."""
    state, supported, closing = _on_support(state, parameters, world, dt)
    free = (state, jnp.full(closing.shape, -1, dtype=jnp.int32), jnp.zeros_like(closing))
    if (frames := world.frames) is None:
        return state, Contact(supported, closing, free[1])
    reach = jnp.sqrt(jnp.sum(frames.bar_high.max(axis=(0, 1)) ** 2)) + parameters.hull_radius + parameters.hull_height
    apart = stack(state.p_world)[..., None, :] - frames.position
    near = jnp.any(jnp.sum(apart * apart, axis=-1) < reach[..., None] ** 2)

    def with_contact():
        moved, gate, frame_closing = _on_frame(stacked(state), parameters, frames)
        return unstacked(moved), gate.astype(jnp.int32), frame_closing

    state, gate, frame_closing = jax.lax.cond(near, with_contact, lambda: free)
    return state, Contact(supported, jnp.maximum(closing, frame_closing), gate)
