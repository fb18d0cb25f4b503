"""Where episodes start: on the podium, or around a state of the bank.

The bank holds, for each gate, states in which earlier flights had just passed it: an array (g, size, k).
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.pilot.episodes.time_optimal import Guide
from swift_sim_bridge.pilot.episodes.world import World
from swift_sim_bridge.simulation.simulator import Flight, initial_flight

# The first states of the bank: straight flights through a gate, evenly spread from slow and level to fast and pitched.
BANK_DISTANCE_M = 0.3  # behind the gate's plane, clear of its frame
BANK_SPEED_M_S = (3.0, 12.0)  # slowest and fastest
BANK_PITCH_RAD = 0.7  # nose down, of the fastest
GOLDEN_SHARE = 0.618034  # whose multiples, without their whole parts, cover 0 to 1 evenly in any number


def pack(flight: Flight):
    """Return a flight (n, ...) as rows (n, k), so that a bank of them is one array."""
    leaves = jax.tree.leaves(flight)
    return jnp.concatenate([jnp.reshape(leaf, (leaf.shape[0], -1)) for leaf in leaves], axis=-1)


def unpack(rows, like: Flight) -> Flight:
    """Return the flight of rows (n, k), the inverse of `pack`; `like` (m, ...) gives the shapes."""
    leaves, structure = jax.tree.flatten(like)
    sizes = [int(np.prod(leaf.shape[1:], dtype=int)) for leaf in leaves]
    parts = jnp.split(rows, np.cumsum(sizes)[:-1], axis=-1)
    shaped = [
        jnp.reshape(part, (rows.shape[0], *leaf.shape[1:])).astype(leaf.dtype)
        for part, leaf in zip(parts, leaves, strict=True)
    ]
    return jax.tree.unflatten(structure, shaped)


def choose(condition, if_true, if_false):
    """Return a pytree with the rows of `if_true` where `condition` (n,) holds, else of `if_false`."""

    def pick(a, b):
        return jnp.where(jnp.reshape(condition, condition.shape + (1,) * (a.ndim - 1)), a, b)

    return jax.tree.map(pick, if_true, if_false)


def first_bank(world: World):
    """Return the first bank (g, size, k): states behind each gate that move along its axis.

    The first `bank_fixed` states of a gate are never replaced. Those of a guide are on its lap, at different speeds.
    Without one they go from slow and level to fast and pitched: they keep showing a policy that leaves gates at an
    angle what leaving straight is worth. The others are slow and level, and flown states replace them.
    """
    g, settings, vehicle = world.gates.positions.shape[0], world.settings, world.vehicle
    share = np.zeros(settings.bank_size, np.float32)
    share[: settings.bank_fixed] = np.linspace(0.0, 1.0, settings.bank_fixed)
    share = jnp.tile(jnp.asarray(share), g)[:, None]
    forward = jnp.repeat(world.gates.rotations[:, :, 0], settings.bank_size, axis=0)
    position = jnp.repeat(world.gates.positions, settings.bank_size, axis=0)
    yaw = geometry.quaternion_from_yaw(jnp.repeat(world.gates.yaws, settings.bank_size))
    pitch = geometry.quaternion_from_rotation_vector(share * jnp.array([0.0, BANK_PITCH_RAD, 0.0]))
    flight = still_flight(world, position + BANK_DISTANCE_M * forward, geometry.quaternion_multiply(yaw, pitch))
    hover_speed = (0.25 * vehicle.mass * GRAVITY / vehicle.thrust_coefficient) ** 0.5
    state = replace(
        flight.state,
        v_world=(BANK_SPEED_M_S[0] + share * (BANK_SPEED_M_S[1] - BANK_SPEED_M_S[0])) * forward,
        rotor_speed=jnp.full_like(flight.state.rotor_speed, hover_speed),
    )
    bank = jnp.reshape(pack(replace(flight, state=state)), (g, settings.bank_size, -1))
    return bank if world.guide is None else bank.at[:, : settings.bank_fixed].set(_guide_bank(world, world.guide))


def _guide_bank(world: World, guide: Guide):
    """Return states (g, bank_fixed, k) on the lap of a guide: the speeds of neighbours differ over the whole range."""
    settings = world.settings
    slowest, fastest = settings.guide_speed
    shares = slowest + (fastest - slowest) * np.modf(GOLDEN_SHARE * np.arange(settings.bank_fixed))[0]
    factor = np.tile(shares, len(guide.points))[:, None]
    flat = {
        name: jnp.asarray(values.reshape(-1, values.shape[-1]), jnp.float32) for name, values in guide.states.items()
    }
    flat |= {name: factor.astype(np.float32) * flat[name] for name in ("v_world", "omega_body")}
    flight = still_flight(world, flat["p_world"], flat["q_world_body"])
    rows = pack(replace(flight, state=replace(flight.state, **flat)))
    return jnp.reshape(rows, (len(guide.points), settings.bank_fixed, -1))


def still_flight(world: World, p_world, q_world_body) -> Flight:
    """Return flights (n,) at rest with idling rotors."""
    flight = initial_flight(p_world, q_world_body, profile=world.profile, parameters=world.parameters)
    idling = jnp.full_like(flight.state.rotor_speed, world.idle_speed)
    return replace(flight, state=replace(flight.state, rotor_speed=idling))


def podium(world: World, key, n: int) -> Flight:
    """Return `n` flights at rest on the podium, each with a random offset."""
    settings = world.settings
    noise = jax.random.uniform(key, (n, 3), minval=-1.0, maxval=1.0)
    position = (world.start[0] + settings.podium_position_m * noise).at[:, 2].set(world.start[0][2])
    yaw = world.start[1] + settings.podium_yaw_rad * noise[:, 2]
    return still_flight(world, position, geometry.quaternion_from_yaw(yaw))


def from_bank(world: World, bank, key, n: int):
    """Return (flights, gate just passed (n,)): states of the bank with random offsets."""
    gate_key, row_key, noise_key = jax.random.split(key, 3)
    settings = world.settings
    gate = jax.random.randint(gate_key, (n,), 0, bank.shape[0])
    row = jax.random.randint(row_key, (n,), 0, bank.shape[1])
    flight = unpack(bank[gate, row], podium_like(world))
    noise = jax.random.uniform(noise_key, (n, 12), minval=-1.0, maxval=1.0)
    turn = geometry.quaternion_from_rotation_vector(settings.perturb_attitude_rad * noise[:, 3:6])
    state = replace(
        flight.state,
        p_world=flight.state.p_world + settings.perturb_position_m * noise[:, :3],
        q_world_body=geometry.normalize(geometry.quaternion_multiply(flight.state.q_world_body, turn)),
        v_world=flight.state.v_world + settings.perturb_velocity_m_s * noise[:, 6:9],
        omega_body=flight.state.omega_body + settings.perturb_omega_rad_s * noise[:, 9:12],
    )
    return replace(flight, state=state), gate


def podium_like(world: World) -> Flight:
    """Return one flight (1, ...), for its shapes."""
    return still_flight(world, world.start[0][None], jnp.array([[0.0, 0.0, 0.0, 1.0]], jnp.float32))


class Earned(NamedTuple):
    """States that may enter the bank, one of each flight: a row (n, k), and the gate (n,) that was passed there.

    A state is earned only when its flight has passed the next gate too; otherwise the bank fills with states from which
    a crash cannot be avoided. The gate is the number of gates where nothing was earned.
    """

    row: jnp.ndarray
    gate: jnp.ndarray


def nothing_earned(bank, n: int) -> Earned:
    """Return the `Earned` of `n` flights before they pass a gate."""
    return Earned(jnp.zeros((n, bank.shape[2])), jnp.full((n,), bank.shape[0], jnp.int32))


def store(bank, earned: Earned, key, fixed: int):
    """Return the bank (g, size, k) with the earned states.

    Args:
        bank: before.
        earned: of n flights.
        key: of the random slots.
        fixed: first states of each gate that are never replaced.
    """
    slot = jax.random.randint(key, earned.gate.shape, fixed, bank.shape[1])
    return bank.at[earned.gate, slot].set(earned.row, mode="drop")  # what was not earned is out of range
